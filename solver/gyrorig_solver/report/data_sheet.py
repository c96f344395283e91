"""Limits of a sensor's data sheet, in the units that a report shows.

What to use when: `data_sheet_range` for a parameter's range, `data_sheet_white_noise` and
`data_sheet_noise` for the noise. They return nothing where the profile has no value.
"""

import math

from gyrorig_protocol.profile import SensorProfile
from gyrorig_solver.model import format_short
from gyrorig_solver.model.catalogue import catalogue

_ALLAN_FLOOR = 0.664  # of the coefficient B: sqrt(2 ln 2 / pi), IEEE Std 952 annex C


def data_sheet_range(
    name: str, profile: SensorProfile | None, full_scale_dps: float | None
) -> tuple[float, float] | None:
    """Return the lowest and highest value of a parameter, in the unit that is shown."""
    if profile is None:
        return None
    cause, _, parameter = name.partition(".")
    if cause in catalogue():
        limit = catalogue()[cause].data_sheet_limit(parameter, profile)
        return None if limit is None else (-limit, limit)
    middle, half_width, factor = {
        "bias": (0.0, profile.zero_rate_limit_dps(full_scale_dps), 1.0),  # deg/s
        "scale": (1.0, profile.scale_tolerance, 1.0),
        "nonorthogonality": (0.0, profile.cross_axis, 1e3),  # mrad
    }.get(name, (0.0, None, 1.0))
    if half_width is None:
        return None
    return middle - factor * half_width, middle + factor * half_width


def data_sheet_white_noise(profile: SensorProfile | None) -> tuple[str, str]:
    """Return the data sheet's noise density, deg/s/sqrt(Hz), and angle random walk, deg/sqrt(h)."""
    density_dps = None if profile is None else profile.noise_density_dps_rthz
    if density_dps is None:
        return "", ""
    # Data sheets state one-sided densities; IEEE Std 952 defines N by the two-sided one.
    return format_short(density_dps), format_short(60.0 * density_dps / math.sqrt(2.0))


def data_sheet_noise(name: str, profile: SensorProfile | None) -> str:
    """Return the data sheet's value of another noise coefficient."""
    if profile is None:
        return ""
    allan_floor_dps_h = profile.bias_instability_dps_h
    if name == "bias_instability" and allan_floor_dps_h is not None:
        # Data sheets give the minimum of the Allan deviation, which is 0.664 of the coefficient.
        coefficient_text = format_short(allan_floor_dps_h / _ALLAN_FLOOR)
        return f"{coefficient_text} (Allan minimum {format_short(allan_floor_dps_h)})"
    return ""
