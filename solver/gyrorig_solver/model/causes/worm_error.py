"""Periodic worm error: the worm or the motor is uneven, so the error repeats with the angle.

angle + c cos(2 pi angle/P) + s sin(2 pi angle/P) on each axis. A PTU-E46-17.5 has 17.5 motor turns
per turn of the stage: P = 20.57 deg. A worm with two starts on 35 teeth would make it 10.29 deg per
tooth. 0.005 to 0.03 deg (from memory): 0.02 deg is a ripple of 0.6 % of the rate at 20.57 deg. It
is periodic in the angle, not in time: its frequency grows with the speed.
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.cause_categories import ANGLE_COVARIATES
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import (
    BinnedDependence,
    TermParameter,
    shape_parameter,
    size_parameter,
)
from gyrorig_solver.model.term_kinds import LinearAngleTerm, scan_grid
from gyrorig_solver.model.value_format import DEG, PAN_TILT, format_list

MOTOR_TURN_RAD = 2.0 * np.pi / 17.5  # of the stage, per motor turn


def _parameter(name: str) -> TermParameter:
    return size_parameter(
        name, "rad", PAN_TILT, typical=0.015, limit=0.5, prior_std=0.1, factor=DEG
    )


class WormError(LinearAngleTerm):
    """c, then s, for pan and tilt each; then the period."""

    cause = "worm_error"
    title = "The worm has a periodic error"
    equation = "angle = angle + cosine cos(2 pi angle / period) + sine sin(2 pi angle / period)"
    stage = "drive"
    parameters = (
        _parameter("cosine"),
        _parameter("sine"),
        shape_parameter(
            "period",
            "rad",
            typical=0.01 * MOTOR_TURN_RAD,
            lower=0.5 * DEG,
            upper=90.0 * DEG,
            prior_std=0.02 * MOTOR_TURN_RAD,
            start=MOTOR_TURN_RAD,
        ),
    )
    confused_with = ("eccentricity", "supply_hum", "step_resolution")
    remedy = (
        "let every sweep cover whole turns of the worm (20.57 deg), or let `gyrorig solve` fit "
        "this cause"
    )
    covariates = ANGLE_COVARIATES
    picture = BinnedDependence("gain", "worm")
    excitation = "sweeps over several worm turns, over the same range at two speeds"
    effect_if_ignored = (
        "small if every sweep covers whole turns of the worm; otherwise the scale factors contain "
        "part of this error"
    )
    is_persistent = True

    def angle_shapes(self, state: SignalState, values: FloatArray) -> list[tuple[int, FloatArray]]:
        """Return cosine of pan and tilt, then sine."""
        waves = [state.angle_waves.cosine_and_sine(axis, float(values[4])) for axis in (0, 1)]
        return [(axis, waves[axis][k]) for k in (0, 1) for axis in (0, 1)]

    def template_bank(self, state: SignalState) -> FloatArray:
        """Scan one motor turn, its half, its third and its quarter."""
        return scan_grid(self, period=MOTOR_TURN_RAD / np.array([1.0, 2.0, 3.0, 4.0]))

    def describe(self, values: FloatArray) -> str:
        size = np.hypot(values[:2], values[2:4]) / DEG
        text = format_list(size, PAN_TILT, "deg")
        return f"the angle has a periodic error with a period of {values[4] / DEG:.2f} deg: ±{text}"


TERM = WormError()
