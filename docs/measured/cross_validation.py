"""`broad`, cross-validated: every trial of a unit fitted, every other trial of it judged.

What to use when: `held_out` for the rotation errors of all ordered pairs, `factors` for what
each pair gains, `summary` for the sentences about them, `bands` for the trial whose gain does
harm elsewhere: what it gives when only its lower frequencies are used.

Intervals are of a bootstrap over blocks of `BLOCK_S`, not over windows: neighbouring windows
share one motion, and resampling them alone would claim too narrow an interval.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import permutations

import numpy as np
from docs.markdown import number, table
from docs.measured.attitude_sets import SAME_UNIT, fit_of, rest_bias
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
SEED = 20260131  # so that the same errors give the same interval
DISTURBED = {"24": "tapping", "33": "magnet"}  # by the names of the files
RAW, OFFSET, GAIN, ALL, OWN = (
    "raw gyro",
    "time offset only",
    "time offset and gain",
    "full calibration",
    "fit of the tested trial",
)
PARAMETER_SETS = (RAW, OFFSET, GAIN, ALL, OWN)


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """Rotation errors on one trial, per set of parameters from the fit of another."""

    train: str
    test: str
    angle_rad: dict[str, FloatArray]  # by parameter set, one value per window
    block: FloatArray  # (n,), which block each window is in

    @property
    def title(self) -> str:
        """`02 → 05`, a disturbed trial with its disturbance."""
        return " → ".join(_titled(name) for name in (self.train, self.test))

    def rms_deg(self, parameter_set: str) -> tuple[float, float, float]:
        """The rms and its 95 % interval."""
        whole = float(np.sqrt(np.mean(self.angle_rad[parameter_set] ** 2)))
        low, high = np.percentile(np.sqrt(self._means(parameter_set)), PERCENT)
        return float(np.degrees(whole)), float(np.degrees(low)), float(np.degrees(high))

    def factor(self, before: str, after: str) -> tuple[float, float, float]:
        """The ratio of two rms errors and its 95 % interval, with the same blocks."""
        squares = [
            float(np.mean(self.angle_rad[parameter_set] ** 2)) for parameter_set in (before, after)
        ]
        drawn = np.sqrt(self._means(before) / self._means(after))
        low, high = np.percentile(drawn, PERCENT)
        return float(np.sqrt(squares[0] / squares[1])), float(low), float(high)

    def closer_percent(self, before: str, after: str) -> float:
        """The share of windows in which `after` is closer to the reference."""
        return 100.0 * float(np.mean(self.angle_rad[after] < self.angle_rad[before]))

    def _means(self, parameter_set: str) -> FloatArray:
        """Mean squares of the bootstrap's draws; every call draws the same blocks."""
        _, at = np.unique(self.block, return_inverse=True)
        sums = np.bincount(at, self.angle_rad[parameter_set] ** 2)
        counts = np.bincount(at)
        drawn = np.random.default_rng(SEED).integers(0, sums.size, (BOOTSTRAPS, sums.size))
        return np.asarray(sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1), np.float64)


def held_out(measured: MeasuredSets) -> str:
    """Rotation error of every ordered pair, one column per set of parameters."""
    rows = []
    for pair in pairs(measured):
        cells = [
            _with_interval(*pair.rms_deg(parameter_set), 3) for parameter_set in PARAMETER_SETS
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
    """Error ratios of each pair, compared with raw and with the time offset alone."""
    rows = []
    for pair in pairs(measured):
        rows.append(
            [
                pair.title,
                _with_interval(*pair.factor(RAW, ALL), 2),
                _with_interval(*pair.factor(OFFSET, ALL), 2),
                number(pair.closer_percent(OFFSET, ALL), 0),
                _with_interval(*pair.factor(ALL, OWN), 2),
                _verdict(pair.factor(OFFSET, ALL)),
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
    """The number of pairs in which the calibration helps, and by how much."""
    all_pairs = pairs(measured)
    whole = [pair.factor(RAW, ALL) for pair in all_pairs]
    lines = [_counted("Compared with the raw gyro,", whole, all_pairs)]
    with_offset = [pair.factor(OFFSET, ALL) for pair in all_pairs]
    lines.append(
        _counted("Compared with a correction of the time offset alone,", with_offset, all_pairs)
    )
    return "\n".join(lines)


def _counted(
    comparison: str, factor: list[tuple[float, float, float]], all_pairs: tuple[Pair, ...]
) -> str:
    """One line of the summary."""
    verdicts = [_verdict(ratio) for ratio in factor]
    helped = [
        ratio[0] for ratio, verdict in zip(factor, verdicts, strict=True) if verdict == "helps"
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
            for pair, ratio, its in zip(all_pairs, factor, verdicts, strict=True)
            if its == verdict
        ]
        if titles:
            line += f". {statement} {', '.join(titles)}"
        elif verdict == "harms":
            line += ". The calibration increases the error in no pair"
    return f"{line}."


def _verdict(factor: tuple[float, float, float]) -> str:
    """The verdict that the interval of a ratio allows."""
    _, low, high = factor
    if low > 1.0:
        return "helps"
    return "harms" if high < 1.0 else "no difference"


def _with_interval(value: float, low: float, high: float, digits: int) -> str:
    return f"{number(value, digits)} ({number(low, digits)} to {number(high, digits)})"


def _titled(name: str) -> str:
    return f"{name} ({DISTURBED[name]})" if name in DISTURBED else name


@cache
def pairs(measured: MeasuredSets) -> tuple[Pair, ...]:
    """Every ordered pair of trials of one unit."""
    return tuple(
        _pair(measured, train, test) for unit in SAME_UNIT for train, test in permutations(unit, 2)
    )


def bands(measured: MeasuredSets) -> str:
    """The fast trial fitted up to several frequency limits, tested on trials of its unit."""
    fast = measured.load(FAST)
    if fast.attitude is None:
        raise ValueError(f"{FAST} has no reference attitude")
    rows = []
    for band_hz in BANDS_HZ:
        fit = fit_attitude([(fast.samples, fast.attitude)], band_hz)
        scales = [
            f"{number(value, 5)} ± {number(fit.std[f'scale.{axis}'], 5)}"
            for axis, value in zip("xyz", fit.scale.tolist(), strict=True)
        ]
        judged = []
        for name in (*SLOW, FAST):
            loaded = measured.load(name)
            angle, _ = _errors(loaded, fit.time_offset_s, rest_bias(loaded), fit.gain)
            judged.append(number(float(np.degrees(np.sqrt(np.mean(angle**2)))), 3))
        rows.append([number(band_hz, 0), *scales, *judged])
    head = ["frequencies up to, Hz", *(f"scale {axis}" for axis in "xyz")]
    return table([*head, *(f"tested on trial {name}, °" for name in (*SLOW, FAST))], rows)


def _pair(measured: MeasuredSets, train: str, test: str) -> Pair:
    loaded = measured.load(test)
    angles = {}
    begin = np.zeros(0)
    for words, offset_s, bias, gain in _ways(measured, train, test, loaded):
        angles[words], begin = _errors(loaded, offset_s, bias, gain)
    if len({angle.size for angle in angles.values()}) != 1:
        raise ValueError(f"{train} and {test}: the parameter sets have different windows")
    return Pair(train, test, angles, np.floor((begin - begin[0]) / BLOCK_S))


def _errors(
    loaded: LoadedRecording, offset_s: float, bias_rad_s: FloatArray, gain: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Angle errors of the windows in motion, and when each begins."""
    attitude = loaded.attitude
    if attitude is None:
        raise ValueError(f"{loaded.samples.board} has no reference attitude")
    rate = (loaded.samples.rate_rad_s - bias_rad_s) @ np.linalg.inv(gain).T
    time_s = loaded.samples.time_s - offset_s
    moving = ~loaded.at_rest(attitude.time_s)
    error = window_rotation_error(time_s, rate, attitude, WINDOW_S, moving)
    return error.angle_rad, error.begin_s


def _ways(
    measured: MeasuredSets, train: str, test: str, loaded: LoadedRecording
) -> Iterator[tuple[str, float, FloatArray, FloatArray]]:
    """The parameter sets: name, time offset, bias and gain."""
    offset_s, bias, gain = fit_of(measured, train)
    own_offset_s, own_bias, own_gain = fit_of(measured, test)
    rest, nominal = rest_bias(loaded), np.eye(3)
    yield RAW, 0.0, rest, nominal
    yield OFFSET, offset_s, rest, nominal
    yield GAIN, offset_s, rest, gain
    yield ALL, offset_s, bias, gain
    yield OWN, own_offset_s, own_bias, own_gain
