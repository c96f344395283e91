"""Cross-validation of `broad`: each trial of a unit is fitted and tested on its other trials.

What to use when: `rotation_errors` for the errors of all ordered pairs, `factors` for the error
ratios of each pair, `summary` for the sentences about them. `bands` is for the trial whose gain
increases the errors of other trials: its fit uses only lower frequencies.

The intervals are from a bootstrap over blocks of `BLOCK_S`. A bootstrap over windows would give
intervals that are too narrow, because neighbouring windows share one motion.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import permutations

import numpy as np
from docs.markdown import number, table
from docs.measured.attitude_sets import SAME_UNIT, compute_rest_bias, read_fit
from docs.measured.sessions import LoadedRecording, MeasuredSets
from tests.support.rotation_error import window_rotation_error

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate import fit_attitude

WINDOW_S = 1.0
BLOCK_S = 10.0
BANDS_HZ = (1.0, 2.0, 5.0)
FAST, SLOW = "07", ("02", "05")
BOOTSTRAPS = 2000
PERCENT = (2.5, 97.5)
SEED = 20260131  # the same errors then give the same interval
DISTURBANCES = {"24": "tapping", "33": "magnet"}  # from the file names
RAW, OFFSET, GAIN, ALL, TESTED = (
    "raw gyro",
    "time offset only",
    "time offset and gain",
    "full calibration",
    "fit of the tested trial",
)
PARAMETER_SETS = (RAW, OFFSET, GAIN, ALL, TESTED)


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """Rotation errors on the tested trial, for each set of parameters."""

    train: str
    test: str
    angle_rad: dict[str, FloatArray]  # by parameter set, one value per window
    block: FloatArray  # (n,), number of the block of each window

    @property
    def title(self) -> str:
        """The two trials, as in `02 → 05`; a disturbed trial has its disturbance."""
        return " → ".join(_format_trial(name) for name in (self.train, self.test))

    def compute_rms_deg(self, parameter_set: str) -> tuple[float, float, float]:
        """Return the rms error and its 95 % interval."""
        whole = float(np.sqrt(np.mean(self.angle_rad[parameter_set] ** 2)))
        low, high = np.percentile(np.sqrt(self._draw_mean_squares(parameter_set)), PERCENT)
        return float(np.degrees(whole)), float(np.degrees(low)), float(np.degrees(high))

    def compute_ratio(self, before: str, after: str) -> tuple[float, float, float]:
        """Return the ratio of two rms errors and its 95 % interval, from the same blocks."""
        squares = [
            float(np.mean(self.angle_rad[parameter_set] ** 2)) for parameter_set in (before, after)
        ]
        ratios = np.sqrt(self._draw_mean_squares(before) / self._draw_mean_squares(after))
        low, high = np.percentile(ratios, PERCENT)
        return float(np.sqrt(squares[0] / squares[1])), float(low), float(high)

    def compute_closer_percent(self, before: str, after: str) -> float:
        """Return the share of windows in which `after` is closer to the reference."""
        return 100.0 * float(np.mean(self.angle_rad[after] < self.angle_rad[before]))

    def _draw_mean_squares(self, parameter_set: str) -> FloatArray:
        """Return the mean square of each bootstrap draw; every call draws the same blocks."""
        _, at = np.unique(self.block, return_inverse=True)
        sums = np.bincount(at, self.angle_rad[parameter_set] ** 2)
        counts = np.bincount(at)
        indices = np.random.default_rng(SEED).integers(0, sums.size, (BOOTSTRAPS, sums.size))
        return np.asarray(sums[indices].sum(axis=1) / counts[indices].sum(axis=1), np.float64)


def rotation_errors(measured: MeasuredSets) -> str:
    """Return the rotation error of every ordered pair, one column per set of parameters."""
    rows = []
    for pair in make_pairs(measured):
        cells = [
            _format_interval(*pair.compute_rms_deg(parameter_set), 3)
            for parameter_set in PARAMETER_SETS
        ]
        rows.append([pair.title, *cells, str(pair.block.size)])
    return table(
        [
            "fitted trial → tested trial",
            *(f"{parameter_set}, °" for parameter_set in PARAMETER_SETS),
            "windows",
        ],
        rows,
    )


def factors(measured: MeasuredSets) -> str:
    """Return the error ratios of each pair, relative to raw and to the time offset alone."""
    rows = []
    for pair in make_pairs(measured):
        rows.append(
            [
                pair.title,
                _format_interval(*pair.compute_ratio(RAW, ALL), 2),
                _format_interval(*pair.compute_ratio(OFFSET, ALL), 2),
                number(pair.compute_closer_percent(OFFSET, ALL), 0),
                _format_interval(*pair.compute_ratio(ALL, TESTED), 2),
                _judge_ratio(pair.compute_ratio(OFFSET, ALL)),
            ]
        )
    head = [
        "fitted trial → tested trial",
        "raw / full calibration",
        "time offset only / full calibration",
        "windows improved, %",
        "full calibration / fit of the tested trial",
        "calibration compared with the time offset only",
    ]
    return table(head, rows)


def summary(measured: MeasuredSets) -> str:
    """Return the number of pairs in which the calibration helps, and its factors."""
    all_pairs = make_pairs(measured)
    whole = [pair.compute_ratio(RAW, ALL) for pair in all_pairs]
    lines = [_count_pairs("Compared with the raw gyro,", whole, all_pairs)]
    with_offset = [pair.compute_ratio(OFFSET, ALL) for pair in all_pairs]
    lines.append(
        _count_pairs("Compared with a correction of the time offset alone,", with_offset, all_pairs)
    )
    return "\n".join(lines)


def _count_pairs(
    comparison: str, ratios: list[tuple[float, float, float]], all_pairs: tuple[Pair, ...]
) -> str:
    """Return one line of the summary."""
    verdicts = [_judge_ratio(ratio) for ratio in ratios]
    helped = [
        ratio[0] for ratio, verdict in zip(ratios, verdicts, strict=True) if verdict == "helps"
    ]
    count = f"{len(helped)} of {len(all_pairs)} pairs"
    line = f"- {comparison} the calibration reduces the error in {count}"
    if helped:
        line += f", by a factor of {number(min(helped), 2)} to {number(max(helped), 2)}"
    for verdict, statement in (
        (
            "no difference",
            "The change of the error is not significant in these pairs (error ratio):",
        ),
        ("harms", "The calibration increases the error in these pairs (error ratio):"),
    ):
        titles = [
            f"{pair.title} ({number(ratio[0], 2)})"
            for pair, ratio, pair_verdict in zip(all_pairs, ratios, verdicts, strict=True)
            if pair_verdict == verdict
        ]
        if titles:
            line += f". {statement} {', '.join(titles)}"
        elif verdict == "harms":
            line += ". The calibration increases the error in no pair"
    return f"{line}."


def _judge_ratio(ratio: tuple[float, float, float]) -> str:
    """Return the verdict from the interval of a ratio."""
    _, low, high = ratio
    if low > 1.0:
        return "helps"
    return "harms" if high < 1.0 else "no difference"


def _format_interval(value: float, low: float, high: float, digits: int) -> str:
    return f"{number(value, digits)} ({number(low, digits)} to {number(high, digits)})"


def _format_trial(name: str) -> str:
    return f"{name} ({DISTURBANCES[name]})" if name in DISTURBANCES else name


@cache
def make_pairs(measured: MeasuredSets) -> tuple[Pair, ...]:
    """Return every ordered pair of trials of one unit."""
    return tuple(
        _make_pair(measured, train, test)
        for unit in SAME_UNIT
        for train, test in permutations(unit, 2)
    )


def bands(measured: MeasuredSets) -> str:
    """Return the errors of fits of the fast trial with several frequency limits."""
    fast = measured.load_recording(FAST)
    if fast.attitude is None:
        raise ValueError(f"{FAST} has no reference attitude")
    rows = []
    for band_hz in BANDS_HZ:
        fit = fit_attitude([(fast.samples, fast.attitude)], band_hz)
        scales = [
            f"{number(value, 5)} ± {number(fit.std[f'scale.{axis}'], 5)}"
            for axis, value in zip("xyz", fit.scale.tolist(), strict=True)
        ]
        errors_deg = []
        for name in (*SLOW, FAST):
            loaded = measured.load_recording(name)
            angle, _ = _compute_errors(
                loaded, fit.time_offset_s, compute_rest_bias(loaded), fit.gain
            )
            errors_deg.append(number(float(np.degrees(np.sqrt(np.mean(angle**2)))), 3))
        rows.append([number(band_hz, 0), *scales, *errors_deg])
    head = ["frequencies up to, Hz", *(f"scale {axis}" for axis in "xyz")]
    return table([*head, *(f"tested on trial {name}, °" for name in (*SLOW, FAST))], rows)


def _make_pair(measured: MeasuredSets, train: str, test: str) -> Pair:
    loaded = measured.load_recording(test)
    angles = {}
    begins_s = np.zeros(0)
    for words, offset_s, bias, gain in _make_parameter_sets(measured, train, test, loaded):
        angles[words], begins_s = _compute_errors(loaded, offset_s, bias, gain)
    if len({angle.size for angle in angles.values()}) != 1:
        raise ValueError(f"{train} and {test}: the parameter sets have different windows")
    return Pair(train, test, angles, np.floor((begins_s - begins_s[0]) / BLOCK_S))


def _compute_errors(
    loaded: LoadedRecording, offset_s: float, bias_rad_s: FloatArray, gain: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the angle error and the begin of each window in motion."""
    attitude = loaded.attitude
    if attitude is None:
        raise ValueError(f"{loaded.samples.board} has no reference attitude")
    rate = (loaded.samples.rate_rad_s - bias_rad_s) @ np.linalg.inv(gain).T
    time_s = loaded.samples.time_s - offset_s
    moving = ~loaded.make_rest_mask(attitude.time_s)
    error = window_rotation_error(time_s, rate, attitude, WINDOW_S, moving)
    return error.angle_rad, error.begin_s


def _make_parameter_sets(
    measured: MeasuredSets, train: str, test: str, loaded: LoadedRecording
) -> Iterator[tuple[str, float, FloatArray, FloatArray]]:
    """Yield name, time offset, bias and gain of each parameter set."""
    offset_s, bias, gain = read_fit(measured, train)
    tested_offset_s, tested_bias, tested_gain = read_fit(measured, test)
    rest_bias, nominal = compute_rest_bias(loaded), np.eye(3)
    yield RAW, 0.0, rest_bias, nominal
    yield OFFSET, offset_s, rest_bias, nominal
    yield GAIN, offset_s, rest_bias, gain
    yield ALL, offset_s, bias, gain
    yield TESTED, tested_offset_s, tested_bias, tested_gain
