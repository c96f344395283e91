"""Whether a result is to be used: the verdict, and each reason with its remedy."""

import math
from typing import Literal

from gyrorig_protocol.profile import SensorProfile
from gyrorig_solver.calibration.document import Trust
from gyrorig_solver.estimate.result import GyroFit
from gyrorig_solver.findings.document import FindingsDocument

# Residuals this many times their noise are not covered by the standard deviations given.
_REFUSED_CHI2 = 25.0
_LOST_SHARE = 0.02  # of the samples; fewer gaps cost precision only
_OUTLIER_SHARE = 0.01
HARMLESS_SIGMA = 1.0
_DEG = 180.0 / math.pi

Verdict = Literal["good", "limited", "refused"]


def judge(fit: GyroFit) -> Trust:
    """Return the verdict on a fit.

    refused: nothing was observable, or the residual is far outside its noise. limited: the
    fit gives a reason for distrust, or too many samples were lost or were spikes.
    """
    verdict: Verdict = "good"
    reasons = list(fit.distrust or fit.observability.reasons)
    if fit.observability.unobservable and not reasons:
        hidden = ", ".join(fit.observability.unobservable)
        reasons.append(f"{hidden} not observable: record a program that turns about every axis")
    total = fit.samples + fit.lost
    if fit.lost > _LOST_SHARE * max(total, 1):
        reasons.append(
            f"{fit.lost} of {total} samples were lost: lower the output rate or raise the baud rate"
        )
    if fit.outliers > _OUTLIER_SHARE * max(fit.samples, 1):
        reasons.append(
            f"{fit.outliers} samples were set aside as outliers: check the sensor's bus, its "
            "supply and the reference"
        )
    if reasons:
        verdict = "limited"
    if math.isfinite(fit.reduced_chi2) and fit.reduced_chi2 > _REFUSED_CHI2:
        reasons.append(
            f"the residual's variance is {fit.reduced_chi2:.3g} times its noise, so the standard "
            "deviations mean nothing: check signs, axes and full scale in the rig's configuration"
        )
        verdict = "refused"
    if fit.observability.rank == 0:
        verdict = "refused"
    return Trust(verdict=verdict, reasons=reasons)


def with_findings(trust: Trust, findings: FindingsDocument) -> Trust:
    """Return the verdict with what a search for causes left unexplained.

    A rest that might move a parameter by more than one of its standard deviations makes a
    result limited: they do not tell how far off it is.
    """
    rest = findings.unexplained
    if rest is None or (rest.harm_sigma is not None and rest.harm_sigma <= HARMLESS_SIGMA):
        return trust
    off = "" if rest.harm_sigma is None else f" by up to about {rest.harm_sigma:.0f} of its std"
    reason = (
        f"something is left that no known cause explains, it depends {rest.best_covariate} and "
        f"may move a parameter{off}: look at the findings' report, mend the rig, record again"
    )
    verdict: Verdict = "limited" if trust.verdict == "good" else trust.verdict
    return Trust(verdict=verdict, reasons=[*trust.reasons, reason])


def profile_warnings(
    fit: GyroFit, profile: SensorProfile | None, full_scale_dps: float | None = None
) -> list[str]:
    """Say where a value lies outside what the data sheet allows at the board's full scale."""
    if profile is None:
        return []
    out = []
    if profile.scale_tolerance is not None:
        for axis, scale in zip("xyz", fit.scale, strict=True):
            if math.isfinite(scale) and abs(abs(scale) - 1.0) > profile.scale_tolerance:
                out.append(
                    f"scale.{axis} is {scale:.4f}, outside the {profile.sensor}'s "
                    f"1 ± {profile.scale_tolerance:g}: check the full scale that the board "
                    "says it is set to"
                )
    zero_rate_dps = profile.zero_rate_at(full_scale_dps)
    if zero_rate_dps is not None:
        for axis, bias in zip("xyz", fit.bias_rad_s, strict=True):
            if math.isfinite(bias) and abs(bias) * _DEG > zero_rate_dps:
                out.append(
                    f"bias.{axis} is {bias * _DEG:.1f} deg/s, outside the {profile.sensor}'s "
                    f"±{zero_rate_dps:g}: check that the rig stood still"
                )
    return out
