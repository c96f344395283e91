"""Common offsets: is a parameter off by the same on every unit, or different on each?

What to use when: `compare_offsets` for every answer that the latest calibrations give,
`describe_offsets` for the answers as lines, `common_offset` for one parameter.

A wrong number in a program, truncated counts, a wrong tick rate and the host's clock shift all
units by the same. Parts, mounts and a sensor's own clock differ from unit to unit. The mean and
the spread of boards of one kind separate the two. Truncation lowers every axis by half a count;
if the biases differ by more than that, it cannot be seen, and the text reports this. Clocks are
compared per kind of sensor, where its boards are on several rigs, and per rig, because all
boards of a rig share its host.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.fleet.column_units import column_label, column_unit
from gyrorig_solver.fleet.drift.latest_calibrations import PARAMETER_COLUMNS, LatestCalibrations
from gyrorig_solver.fleet.drift.population import MIN_BOARDS, Population, fit_population
from gyrorig_solver.model import plural
from gyrorig_solver.numerics import normal_score, normal_upper_tail

# The values of an ideal board on an ideal rig. A time offset has no nominal value.
NOMINAL_VALUES = {
    name: 1.0 if name.startswith("scale") else 0.0
    for name in PARAMETER_COLUMNS
    if not name.startswith("time")
}
DECISION_P_VALUE = 1e-6  # of an offset or of a spread, before it is reported
COMMON_SHARE = 0.9  # of the mean square deviation: the offset is three times the spread
CLOCK_PARAMETER = "clock_skew"
# Standard deviation of a clock's skew from 40 s, with a clock map of 20 us; see docs/clocks.md.
SKEW_STD_PPM = 0.5
_MAX_RIGS_NAMED = 4

Answer = Literal["same", "different", "open"]


@dataclass(frozen=True, slots=True)
class CommonOffset:
    """The part of the deviation from nominal that is the same on every unit."""

    parameter: str
    offset: float  # of the fleet's mean from nominal
    z: float  # normal score of the offset
    p_value: float
    share: float  # of the mean square deviation from nominal that is common to all
    boards: int
    spread: float  # standard deviation between boards
    homogeneity_p_value: float  # of Cochran's test that all boards are equal

    @property
    def is_common(self) -> bool:
        """Whether one constant explains the deviation better than the spread of the parts."""
        return self.answer == "same"

    @property
    def answer(self) -> Answer:
        """Whether the deviation is common.

        same: one number is off on all units. different: boards differ, and no single number
        explains the deviation. open: neither can be decided; boards are alike and near nominal.
        """
        if self.p_value < DECISION_P_VALUE and self.share > COMMON_SHARE:
            return "same"
        return "different" if self.homogeneity_p_value < DECISION_P_VALUE else "open"


@dataclass(frozen=True, slots=True)
class OffsetComparison:
    """Whether one parameter is off by the same on all boards of a sensor, or of a rig."""

    kind: Literal["sensor", "rig"]
    name: str  # of the sensor or the rig
    result: CommonOffset
    count_size_rad_s: float | None = None  # of a bias: one count, where all boards agree on it

    @property
    def hides_truncation(self) -> bool:
        """Whether half a count on every unit would not be seen, because the biases differ more."""
        if self.count_size_rad_s is None or self.result.is_common:
            return False
        return not _common_share(0.5 * self.count_size_rad_s, self.result.spread) > COMMON_SHARE


def common_offset(fitted: Population, nominal: float) -> CommonOffset:
    """Test whether a deviation from nominal is the same on every unit.

    The spread between boards is estimated; therefore this is Student's t test, and `z` the normal
    score with the same tail probability.
    """
    offset = fitted.mean - nominal
    degrees_of_freedom = int((~fitted.is_outlier).sum()) - 1  # of the spread
    z = float(normal_score(np.array(offset / fitted.mean_std), degrees_of_freedom))
    return CommonOffset(
        parameter=fitted.parameter,
        offset=offset,
        z=z,
        p_value=2.0 * normal_upper_tail(abs(z)),
        share=_common_share(offset, fitted.spread),
        boards=fitted.boards,
        spread=fitted.spread,
        homogeneity_p_value=fitted.homogeneity_p_value,
    )


def compare_offsets(
    boards: LatestCalibrations, populations: dict[tuple[str, str], Population]
) -> list[OffsetComparison]:
    """Test every parameter of every sensor, then the clocks per sensor and per rig."""
    sensors = np.array(boards.sensor)
    comparisons: list[OffsetComparison] = []
    for (sensor, name), fitted in populations.items():
        if name not in NOMINAL_VALUES:
            continue
        count_size_rad_s = None
        if name.startswith("bias"):
            count_size_rad_s = _common_count_size(boards.count_size_rad_s[sensors == sensor])
        offset = common_offset(fitted, NOMINAL_VALUES[name])
        comparisons.append(OffsetComparison("sensor", sensor, offset, count_size_rad_s))
    return [*comparisons, *_compare_clocks(boards)]


_ANSWER_WORDS: dict[Answer, tuple[str, str]] = {
    "same": ("the same on every unit", "caused by a number in a program, not by parts"),
    "different": ("different on each unit", "caused by the parts, not by a constant"),
    "open": ("neither common nor different", "as far as these calibrations show"),
}
_CLOCK_ANSWER_WORDS: dict[Answer, str] = {
    "same": "caused by the host's clock",
    "different": "caused by the boards' clocks",
    "open": "boards and host agree",
}


def describe_offsets(comparisons: Sequence[OffsetComparison]) -> list[str]:
    """Return the answers as lines: what is the same on every unit, and what differs."""
    lines: list[str] = []
    by_sensor: dict[str, list[OffsetComparison]] = {}
    for comparison in comparisons:
        if comparison.kind == "sensor":
            by_sensor.setdefault(comparison.name, []).append(comparison)
    for sensor, group in by_sensor.items():
        boards = max(comparison.result.boards for comparison in group)
        for answer, (head, tail) in _ANSWER_WORDS.items():
            labels = [_label(item) for item in group if item.result.answer == answer]
            if labels:
                lines.append(f"{head} on {boards} {sensor}: {', '.join(labels)} ({tail})")
        hiding = [comparison for comparison in group if comparison.hides_truncation]
        if hiding:
            factor, unit = column_unit(hiding[0].result.parameter)
            half_count = 0.5 * factor * (hiding[0].count_size_rad_s or 0.0)
            spread = factor * min(comparison.result.spread for comparison in hiding)
            lines.append(
                f"truncation of the counts (a bias of {half_count:.2g} {unit} on every axis) "
                f"cannot be detected on {sensor}, because the biases of the boards differ by "
                f"{spread:.2g} {unit}"
            )
    for answer, (head, _) in _ANSWER_WORDS.items():
        rigs = [
            comparison
            for comparison in comparisons
            if comparison.kind == "rig" and comparison.result.answer == answer
        ]
        if rigs:
            lines.append(f"{head} on {_rigs_text(rigs)} ({_CLOCK_ANSWER_WORDS[answer]})")
    return lines


def _rigs_text(comparisons: Sequence[OffsetComparison]) -> str:
    names = ", ".join(
        f"{comparison.name} ({_clock_text(comparison)})"
        for comparison in comparisons[:_MAX_RIGS_NAMED]
    )
    unnamed = len(comparisons) - _MAX_RIGS_NAMED
    more = f" and {plural(unnamed, 'more rig')}" if unnamed > 0 else ""
    return f"the boards of {names}{more}: clocks"


def _label(comparison: OffsetComparison) -> str:
    if comparison.result.parameter == CLOCK_PARAMETER:
        return f"clocks ({_clock_text(comparison)})"
    return column_label(comparison.result.parameter)


def _clock_text(comparison: OffsetComparison) -> str:
    return f"{comparison.result.offset:+.3g} ppm, spread {comparison.result.spread:.2g} ppm"


def _compare_clocks(boards: LatestCalibrations) -> Iterator[OffsetComparison]:
    """Test clocks per sensor on several rigs, then per rig after the sensors' common offset."""
    skew_ppm = boards.clock_skew_ppm.copy()
    known = np.isfinite(skew_ppm) & ~boards.is_refused
    sensors, rigs = np.array(boards.sensor), np.array(boards.rig)
    for sensor in sorted(set(sensors[known])):
        selected = known & (sensors == sensor)
        if selected.sum() >= MIN_BOARDS and len(set(rigs[selected])) > 1:
            offset = _clock_offset(skew_ppm[selected])
            yield OffsetComparison("sensor", str(sensor), offset)
            if offset.is_common:
                skew_ppm[selected] -= offset.offset
    for rig in sorted(set(rigs[known]) - {""}):
        selected = known & (rigs == rig)
        if selected.sum() >= MIN_BOARDS:
            yield OffsetComparison("rig", str(rig), _clock_offset(skew_ppm[selected]))


def _clock_offset(skew_ppm: FloatArray) -> CommonOffset:
    fitted = fit_population(CLOCK_PARAMETER, skew_ppm, np.full(skew_ppm.shape, SKEW_STD_PPM))
    return common_offset(fitted, 0.0)


def _common_count_size(count_size_rad_s: FloatArray) -> float | None:
    """Return the rate of one count, None where the boards' ranges differ."""
    known = count_size_rad_s[np.isfinite(count_size_rad_s)]
    if not known.size or float(np.ptp(known)) > 1e-6 * float(known.max()):
        return None
    return float(known[0])


def _common_share(offset: float, spread: float) -> float:
    return offset**2 / (offset**2 + spread**2) if offset else 0.0
