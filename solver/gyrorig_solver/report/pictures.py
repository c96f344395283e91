"""Which figures a calibration report shows, drawn.

What to use when: `pictures` for a fit's; the page leaves out those that are empty.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.report import figures
from gyrorig_solver.report.data import ReportData

_TURNS_RAD_S = 0.01  # slower is rest


@dataclass(frozen=True, slots=True)
class Pictures:
    """SVG texts; empty where there is nothing to show."""

    angle_error: str = ""
    rate_error: str = ""
    residual: str = ""
    spectrum: str = ""
    allan: str = ""
    linearity: str = ""
    pan: str = ""
    tilt: str = ""
    clock: str = ""


def pictures(data: ReportData, inverse_gain: FloatArray) -> Pictures | None:
    """Return the figures of one fit, None where it keeps no arrays.

    Args:
        data: of the report.
        inverse_gain: shape (3, 3), the identity where the gain is not known.
    """
    fit = data.diagnostics
    if fit is None:
        return None
    turns = float(np.nanmax(np.abs(fit.reference_rad_s))) > _TURNS_RAD_S
    after = fit.residual_rad_s @ inverse_gain.T
    course = None if data.clock is None else data.clock.course
    noise = {name: figure.value for name, figure in data.calibration.noise.items()}
    return Pictures(
        angle_error=figures.angle_error(fit, after),
        rate_error=figures.rate_error(fit, after),
        residual=figures.residual_over_time(fit),
        spectrum=figures.residual_spectrum(fit),
        allan=figures.allan(fit, noise),
        linearity=figures.residual_against_rate(fit) if turns else "",
        pan=figures.residual_against_angle(fit, 0) if turns else "",
        tilt=figures.residual_against_angle(fit, 1) if turns else "",
        clock=""
        if course is None or data.clock is None
        else figures.clock(course, data.clock.wander_bound_s),
    )
