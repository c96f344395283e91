"""What a part's data sheet allows, beside what was found, in the units that a report shows.

What to use when: `allowed` for a parameter's range, `noise_said` for a coefficient of the
noise. Both give nothing where the profile is silent.
"""

import math

from gyrorig_protocol.profile import SensorProfile
from gyrorig_solver.calibration.wording import short

_RAD = math.pi / 180.0
_G_M_S2 = 9.80665  # standard gravity, BIPM SI brochure
_ALLAN_FLOOR = 0.664  # of the coefficient B: sqrt(2 ln 2 / pi), IEEE Std 952 annex C


def allowed(
    name: str, profile: SensorProfile | None, full_scale_dps: float | None
) -> tuple[float, float] | None:
    """Return the least and greatest value of a parameter, in the unit that is shown.

    Args:
        name: of the parameter, as the document has it.
        profile: the part's, None where there is none.
        full_scale_dps: that the board was set to: a zero-rate limit goes with it.
    """
    if profile is None:
        return None
    drift_rad_s_k = _times(_RAD, profile.zero_rate_per_kelvin_dps)
    middle, half = {
        "bias": (0.0, profile.zero_rate_at(full_scale_dps)),  # deg/s
        "scale": (1.0, profile.scale_tolerance),
        "nonorthogonality": (0.0, _times(1e3, profile.cross_axis)),  # mrad
        "thermal_bias": (0.0, drift_rad_s_k),
        "thermal_bias.slope": (0.0, drift_rad_s_k),
        "thermal_scale": (0.0, profile.scale_per_kelvin),
        "g_sensitivity": (0.0, _times(_RAD / _G_M_S2, profile.g_sensitivity_dps_g)),
    }.get(name, (0.0, None))
    return None if half is None else (middle - half, middle + half)


def noise_said(name: str, profile: SensorProfile | None) -> str:
    """Return what the data sheet says of a coefficient of the noise, in words."""
    if profile is None:
        return ""
    if name == "angle_random_walk" and profile.noise_density_dps_rthz is not None:
        return short(profile.noise_density_dps_rthz)  # deg/s/sqrt(Hz), one-sided like ours
    floor = profile.bias_instability_dps_h
    if name == "bias_instability" and floor is not None:
        # Data sheets give the lowest point of an Allan plot, which is 0.664 of the coefficient.
        return f"{short(floor / _ALLAN_FLOOR)} (Allan floor {short(floor)})"
    return ""


def _times(factor: float, value: float | None) -> float | None:
    return None if value is None else factor * value
