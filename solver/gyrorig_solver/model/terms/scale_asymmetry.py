"""The scale differs between the two directions.

y_i += a_i |(G omega)_i|: even in the rate with a corner at zero; (1 + a) forward, (1 - a)
back. 0.1 to 0.5 % (as remembered); one BMI270 was off by 2 deg in ten turns each way, 0.06 %.
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import LinearTerm
from gyrorig_solver.model.terms.protocol import Part, TermParameter
from gyrorig_solver.model.terms.scene import Scene, by_axis
from gyrorig_solver.model.terms.wording import XYZ, listed


class ScaleAsymmetry(LinearTerm):
    """a for x, y, z."""

    cause = "scale_asymmetry"
    part: Part = "sensor"
    parameters = (
        TermParameter(
            "share", "1", typical=2e-3, lower=-0.05, upper=0.05, prior_std=0.02, parts=XYZ
        ),
    )
    confused_with = ("scale_quadratic", "vibration_rectification", "motor_coupling")
    excitation = "both directions at four speeds or more, slow ones too"
    harm = "scale and bias are right for motion to and fro only"

    def basis(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return each axis' speed, (3, blocks, 3)."""
        return by_axis(scene.seen(np.abs(scene.sensor_rate_rad_s)))

    def sentence(self, values: FloatArray) -> str:
        """Say the shares."""
        return f"the scale differs forward and back: +-{listed(values * 100.0, XYZ, '%')}"


TERM = ScaleAsymmetry()
