"""Tilt zero error: the stage is not level at the zero of the tilt axis.

True tilt t + z. The rate becomes Rx(z)^T omega for every motion, which is exactly a rotation of M
about x. A gyroscope alone therefore never shows it, and M is only as accurate as the zero. A home
sensor always gives the same position within 0.05 deg, but this position is 0.1 to 1 deg away from
level. The accelerometer can measure it: see `model.leveling.estimate_level`.
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import BinnedDependence, size_parameter
from gyrorig_solver.model.term_kinds import NonlinearTerm
from gyrorig_solver.model.value_format import DEG


class TiltZero(NonlinearTerm):
    """The angle z: true tilt minus commanded tilt."""

    cause = "tilt_zero"
    title = "The tilt zero is wrong"
    equation = "tilt = tilt + angle"
    part = "ptu"
    stage = "axes"
    kind = "gauge"
    scope = "unit"
    parameters = (
        size_parameter("angle", "rad", typical=0.3, limit=5.0, prior_std=1.0, factor=DEG),
    )
    remedy = "level the unit and set tilt_zero in the rig file"
    covariates = None
    picture = BinnedDependence("gain", "tilt", 10)
    excitation = (
        "readings of the board's accelerometer at rest at several tilts, because no motion shows "
        "a tilt zero"
    )
    effect_if_ignored = (
        "the misalignment about x is wrong by the whole angle, and no residual shows this error"
    )

    def effect(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the exact change of the rate, (blocks, 3)."""
        return self._measured_rotation(
            state, float(np.sin(values[0])), float(np.cos(values[0])) - 1.0
        )

    def jacobian(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the derivative, (1, blocks, 3)."""
        return self._measured_rotation(state, float(np.cos(values[0])), -float(np.sin(values[0])))[
            None
        ]

    def missing_data(self, state: SignalState) -> str | None:
        """Return why the gyroscope cannot show it."""
        return (
            "the rates cannot separate an error of the tilt zero from the misalignment about x; "
            "rest at several tilts and record the accelerometer"
        )

    def describe(self, values: FloatArray) -> str:
        return f"the zero of the tilt axis is {values[0] / DEG:.3f} deg away from level"

    def _measured_rotation(self, state: SignalState, sine: float, cosine: float) -> FloatArray:
        _, y, z = state.rate_rad_s.T
        rate = np.column_stack([np.zeros_like(y), cosine * y + sine * z, -sine * y + cosine * z])
        return state.measure_stage_rate(rate)


TERM = TiltZero()
