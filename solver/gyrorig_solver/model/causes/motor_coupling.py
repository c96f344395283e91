"""Motor coupling: running motors shift the bias, by their current or their magnetic field.

y_i += m_i while pan runs and n_i while tilt runs, at any speed. Typical 20 mdeg/s. In contrast to
vibration it does not grow with speed.
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.cause_categories import RATE_COVARIATES
from gyrorig_solver.model.signal_arrays import on_all_axes, split_axes
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import BinnedDependence, TermParameter, size_parameter
from gyrorig_solver.model.term_kinds import LinearTerm
from gyrorig_solver.model.value_format import DEG, XYZ, format_list


def _parameter(name: str) -> TermParameter:
    return size_parameter(name, "rad/s", XYZ, typical=0.02, limit=1.0, prior_std=0.5, factor=DEG)


class MotorCoupling(LinearTerm):
    """m for pan, then n for tilt, for x, y, z each."""

    cause = "motor_coupling"
    title = "A running motor changes the bias"
    equation = "y = y + pan while pan runs + tilt while tilt runs"
    part = "sensor"
    stage = "bias"
    parameters = (_parameter("pan"), _parameter("tilt"))
    confused_with = (
        "scale_asymmetry",
        "scale_quadratic",
        "vibration_rectification",
        "dead_zone",
    )
    remedy = "supply the board separately from the motors and route their cables apart"
    covariates = RATE_COVARIATES
    picture = BinnedDependence("mean", "speed")
    needs_angles = True
    excitation = "moves at several speeds with rests of the same length between them"
    effect_if_ignored = "the bias in motion differs from the bias at rest"

    def basis_signals(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return when each motor runs, on each axis, (6, blocks, 3)."""
        running = np.where(state.motion_known, state.moving, False).astype(np.float64)
        measured = state.measure_sensor_rate(on_all_axes(running))
        return split_axes(measured)

    @property
    def is_of_unit(self) -> bool:
        """The motors are the unit's."""
        return True

    def describe(self, values: FloatArray) -> str:
        pan, tilt = values[:3] / DEG, values[3:] / DEG
        return (
            f"running motors shift the bias: pan {format_list(pan, XYZ, 'deg/s')}, "
            f"tilt {format_list(tilt, XYZ, 'deg/s')}"
        )


TERM = MotorCoupling()
