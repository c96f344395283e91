"""Vibration of the running motors shifts the bias.

y_i += v_i (pan_rate^2 + tilt_rate^2): steppers shake the more the faster they run, and a gyro
turns the square of an acceleration into rate (the g^2 term of IEEE Std 1431), on axes that do
not turn too. No data sheet of these parts gives it; 5 mdeg/s at 1000 (deg/s)^2 is seen.
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import LinearTerm
from gyrorig_solver.model.terms.protocol import Part, TermParameter
from gyrorig_solver.model.terms.scene import Scene, by_axis
from gyrorig_solver.model.terms.wording import DEG, XYZ, listed

_PER_MDPS = 1e-3 * DEG / (1000.0 * DEG**2)  # 1 mdeg/s at 1000 (deg/s)^2


class VibrationRectification(LinearTerm):
    """v for x, y, z."""

    cause = "vibration_rectification"
    part: Part = "sensor"
    parameters = (
        TermParameter(
            name="coefficient",
            unit="s/rad",
            typical=5.0 * _PER_MDPS,
            lower=-200.0 * _PER_MDPS,
            upper=200.0 * _PER_MDPS,
            prior_std=100.0 * _PER_MDPS,
            parts=XYZ,
        ),
    )
    confused_with = ("scale_quadratic", "scale_asymmetry", "motor_coupling", "g_sensitivity")
    excitation = "four speeds or more, each at several tilts"
    harm = "the bias of the moving board is not that of the resting one"

    def basis(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the motors' speeds squared on each axis, (3, blocks, 3)."""
        speed = scene.pan_rate_rad_s**2 + scene.tilt_rate_rad_s**2
        felt = np.where(scene.known, speed, 0.0)
        return by_axis(scene.seen(np.repeat(felt[:, None], 3, axis=1)))

    def missing(self, scene: Scene) -> str | None:
        """Say that the reference has no motors."""
        return None if scene.has_angles else "the reference has no pan and tilt; use a unit"

    def sentence(self, values: FloatArray) -> str:
        """Say the shifts."""
        said = listed(values / _PER_MDPS, XYZ, "mdeg/s at 32 deg/s")
        return f"the motors' vibration shifts the bias with speed squared: {said}"


TERM = VibrationRectification()
