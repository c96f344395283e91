"""The verdict on a calibration: whether to use it, and the reasons with their remedies."""

import math
from typing import Literal

from gyrorig_protocol.profile import SensorProfile
from gyrorig_solver.calibration.calibration_document import Trust
from gyrorig_solver.data.link_remedies import LOST_SAMPLES, OUTLIERS, WRONG_AXES, WRONG_SCALE
from gyrorig_solver.data.stream.gain_checks import check_gain
from gyrorig_solver.estimate import GyroFit
from gyrorig_solver.model import DEG_PER_RAD, plural

_REFUSED_CHI2 = 25.0  # above it, the standard uncertainties are meaningless
_LOST_SHARE = 0.02  # of the samples; fewer gaps only reduce the precision
_OUTLIER_SHARE = 0.01

Verdict = Literal["good", "limited", "refused"]


def judge_fit(fit: GyroFit) -> Trust:
    """Return the verdict on a fit.

    refused: no parameter was observable, the residual is far larger than the noise, or the fit
    reports that its reference is none.
    limited: the fit reports a problem, or too many samples were lost or were outliers.
    """
    verdict: Verdict = "good"
    reasons = list(fit.limited_reasons or fit.observability.reasons)
    if fit.observability.unobservable and not reasons:
        unobservable = ", ".join(fit.observability.unobservable)
        reasons.append(
            f"{unobservable} not observable. Record a program that turns about every axis"
        )
    total = fit.samples + fit.lost
    if fit.lost > _LOST_SHARE * max(total, 1):
        remedy = LOST_SAMPLES.for_link(fit.link)
        reasons.append(f"{fit.lost} of {total} samples were lost. {_capitalised(remedy)}")
    if fit.outliers > _OUTLIER_SHARE * max(fit.samples, 1):
        reasons.append(
            f"{plural(fit.outliers, 'sample was', 'samples were')} rejected as outliers. "
            f"{_capitalised(OUTLIERS.for_link(fit.link))}"
        )
    if reasons:
        verdict = "limited"
    if math.isfinite(fit.reduced_chi2) and fit.reduced_chi2 > _REFUSED_CHI2:
        reasons.append(
            f"the residual's variance is {fit.reduced_chi2:.3g} times that of the noise, so "
            "the standard uncertainties have no meaning. Check the signs, the axes and the "
            "full scale in the rig file or in the import map"
        )
        verdict = "refused"
    if fit.observability.rank == 0 or fit.refused_reasons:
        verdict = "refused"
    return Trust(verdict=verdict, reasons=[*fit.refused_reasons, *reasons])


def mirror_warnings(fit: GyroFit) -> list[str]:
    """Return a remark if the gain mirrors the axes of the reference.

    The correction is right nevertheless, so it is no reason of the verdict. A reference without
    times has signs that a person states, and its estimator gives a reason for wrong ones.
    """
    if "time_offset" not in fit.terms:
        return []
    return [
        f"{finding.seen_as}. The correction includes this, and gives rates along the axes of the "
        f"reference. If these are right, {WRONG_AXES.for_link(fit.link)}, and calibrate again; "
        "otherwise, correct the signs of the reference"
        for finding in check_gain(fit.gain, link=fit.link)[0].findings
    ]


def profile_warnings(
    fit: GyroFit, profile: SensorProfile | None, full_scale_dps: float | None = None
) -> list[str]:
    """Return a warning for each value outside the data sheet's limits at the board's full scale."""
    if profile is None:
        return []
    warnings = []
    if profile.scale_tolerance is not None:
        for axis, scale in zip("xyz", fit.scale, strict=True):
            if math.isfinite(scale) and abs(abs(scale) - 1.0) > profile.scale_tolerance:
                warnings.append(
                    f"scale.{axis} is {scale:.4f}, outside the {profile.sensor}'s data-sheet range "
                    f"1 ± {profile.scale_tolerance:g}. "
                    f"{_capitalised(WRONG_SCALE.for_link(fit.link))}"
                )
    zero_rate_dps = profile.zero_rate_limit_dps(full_scale_dps)
    if zero_rate_dps is not None:
        for axis, bias_dps in zip("xyz", fit.bias_rad_s * DEG_PER_RAD, strict=True):
            if math.isfinite(bias_dps) and abs(bias_dps) > zero_rate_dps:
                warnings.append(
                    f"bias.{axis} is {bias_dps:.1f} deg/s, outside the {profile.sensor}'s "
                    f"data-sheet range ±{zero_rate_dps:g} deg/s. Check that the board was at rest"
                )
    return warnings


def _capitalised(text: str) -> str:
    return text[:1].upper() + text[1:]
