"""Whether a fitted value is plausible for the part: comparison with its data sheet.

A motion that is too weak, a reference that is wrong, or a wrong configuration can give values that
fit the data and no part can have. Their uncertainty by the data does not show it.

What to use when: `find_conflicts` for the values of a fit; `add_conflicts` for a verdict, and
`widen_by_conflicts` for the total uncertainty.

Source: two results that disagree are given the variance between them; Paule and Mandel, J. Res.
NBS 87 (1982) 377.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.profile import SensorProfile
from gyrorig_solver.calibration.calibration_document import Trust
from gyrorig_solver.calibration.verdict import Verdict
from gyrorig_solver.discover import CALIBRATION_PARAMETERS
from gyrorig_solver.estimate import GyroFit
from gyrorig_solver.model import DEG_PER_RAD, format_short, group_of, plural
from gyrorig_solver.uncertainty import OtherEntry, UncertaintyBudget

MAX_SIGMA = 4.0  # prior and data together; above it the value is not plausible
# A data sheet's limits are two standard deviations. The smallest values: mounting, ageing.
LIMIT_SIGMA = 2.0
MIN_SCALE_STD, MIN_NONORTHOGONALITY_STD = 0.005, 0.005
MIN_BIAS_STD_RAD_S = math.radians(1.25)  # parts that were soldered are off by several deg/s
# Of a part without a data sheet: the widest of the shipped profiles.
DEFAULT_SCALE_STD, DEFAULT_NONORTHOGONALITY_STD = 0.075, 0.02
DEFAULT_BIAS_STD_RAD_S = math.radians(12.5)
# The gyroscope's axes against those of the accelerometer in the same package.
PACKAGE_MISALIGNMENT_STD_RAD = 0.015
REMEDY = (
    "turn the board faster and further about all three axes, and check the reference, the axes and "
    "the full scale"
)
OTHER_EXPLANATION = f"The motion was too weak, or the reference is wrong. To correct it: {REMEDY}"
UNIT_RATIOS = {
    DEG_PER_RAD: "the rates seem to be in deg/s, although the recording states rad/s",
    1.0 / DEG_PER_RAD: "the rates seem to be in rad/s, although the recording states deg/s",
}
UNIT_TOLERANCE = 1.2  # between the ratio of the units and a scale factor


@dataclass(frozen=True, slots=True)
class DataSheetConflict:
    """A fitted value that the part's data sheet makes implausible, SI."""

    parameter: str
    value: float
    nominal: float
    prior_std: float
    std: float  # by the data

    @property
    def sigma(self) -> float:
        """The difference in standard deviations of prior and data together."""
        return abs(self.value - self.nominal) / math.hypot(self.prior_std, self.std)

    @property
    def excess_std(self) -> float:
        """The standard uncertainty that makes value and prior agree within one deviation."""
        variance = (self.value - self.nominal) ** 2 - self.prior_std**2 - self.std**2
        return math.sqrt(max(variance, 0.0))


def find_conflicts(
    fit: GyroFit, profile: SensorProfile | None, full_scale_dps: float | None = None
) -> list[DataSheetConflict]:
    """Return the values of a fit that are not plausible for the part, the worst first.

    Args:
        fit: the fit.
        profile: of the part; None: the widest limits of gyroscopes.
        full_scale_dps: the board's setting, None if unknown.
    """
    conflicts = []
    for name, (nominal, prior_std) in _priors(fit, profile, full_scale_dps).items():
        value, std = fit.value(name), fit.std.get(name, math.nan)
        if math.isfinite(value) and math.isfinite(std):
            signed = math.copysign(nominal, value)  # an axis can be reversed
            conflicts.append(DataSheetConflict(name, value, signed, prior_std, std))
    implausible = [conflict for conflict in conflicts if conflict.sigma > MAX_SIGMA]
    return sorted(implausible, key=lambda conflict: -conflict.sigma)


def add_conflicts(
    trust: Trust, conflicts: Sequence[DataSheetConflict], profile: SensorProfile | None
) -> Trust:
    """Return the verdict with a reason for the values that are not plausible."""
    if not conflicts:
        return trust
    worst = conflicts[0]
    others = f" ({plural(len(conflicts) - 1, 'other parameter')} too)" if len(conflicts) > 1 else ""
    part = "a gyroscope" if profile is None else f"the {profile.sensor} (data sheet)"
    reason = (
        f"{worst.parameter} is {_shown(worst.parameter, worst.value)}, which is not plausible for "
        f"{part}, {_shown(worst.parameter, worst.nominal)} ± "
        f"{_shown(worst.parameter, worst.prior_std)}: the difference is {worst.sigma:.1f} standard "
        f"deviations{others}. {_explain_units(conflicts) or OTHER_EXPLANATION}"
    )
    verdict: Verdict = "limited" if trust.verdict == "good" else trust.verdict
    return Trust(verdict=verdict, reasons=[*trust.reasons, reason])


def _explain_units(conflicts: Sequence[DataSheetConflict]) -> str:
    """Return the unit that explains every implausible scale factor, empty without one."""
    scales = [abs(each.value) for each in conflicts if each.parameter.startswith("scale.")]
    for ratio, text in UNIT_RATIOS.items():
        limits = (ratio / UNIT_TOLERANCE, ratio * UNIT_TOLERANCE)
        if scales and all(limits[0] < scale < limits[1] for scale in scales):
            return (
                f"All its scale factors are near {ratio:.3g}: {text}. Correct `unit` of the gyro "
                "in the import map, and import the data again"
            )
    return ""


def widen_by_conflicts(
    budget: UncertaintyBudget, conflicts: Sequence[DataSheetConflict]
) -> UncertaintyBudget:
    """Return a budget in which each implausible value is uncertain by its excess."""
    if not conflicts:
        return budget
    excess = {conflict.parameter: conflict.excess_std for conflict in conflicts}
    added = np.array([excess.get(name, 0.0) for name in CALIBRATION_PARAMETERS])
    return budget.widened(OtherEntry("data_sheet", added, REMEDY))


def _priors(
    fit: GyroFit, profile: SensorProfile | None, full_scale_dps: float | None
) -> Mapping[str, tuple[float, float]]:
    """Return nominal value and standard deviation of each parameter that the part limits."""
    tolerance = None if profile is None else profile.scale_tolerance
    cross_axis = None if profile is None else profile.cross_axis
    zero_rate_dps = None if profile is None else profile.zero_rate_limit_dps(full_scale_dps)
    scale_std = _limit_std(tolerance, MIN_SCALE_STD, DEFAULT_SCALE_STD)
    axes_std = _limit_std(cross_axis, MIN_NONORTHOGONALITY_STD, DEFAULT_NONORTHOGONALITY_STD)
    zero_rate_rad_s = None if zero_rate_dps is None else math.radians(zero_rate_dps)
    bias_std = _limit_std(zero_rate_rad_s, MIN_BIAS_STD_RAD_S, DEFAULT_BIAS_STD_RAD_S)
    priors = {
        **{f"scale.{axis}": (1.0, scale_std) for axis in "xyz"},
        **{f"nonorthogonality.{pair}": (0.0, axes_std) for pair in ("xy", "zx", "zy")},
        **{f"bias.{axis}": (0.0, bias_std) for axis in "xyz"},
    }
    if fit.gravity_moves is not None:  # M relates the gyroscope to its own package
        std = max(axes_std, PACKAGE_MISALIGNMENT_STD_RAD)
        priors |= {f"misalignment.{axis}": (0.0, std) for axis in "xyz"}
    return priors


def _limit_std(limit: float | None, least: float, default: float) -> float:
    return default if limit is None else max(limit / LIMIT_SIGMA, least)


def _shown(name: str, value: float) -> str:
    group = group_of(name)
    if group is None or group.unit == "1":
        return format_short(value)
    return f"{format_short(value * group.factor)} {group.unit}"
