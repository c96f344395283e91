"""The payload bends the tilt axis, by its lever in gravity.

tilt + c cos(tilt) + s sin(tilt): the torque of a weight at any angle to the stage; 0.05 to
0.3 deg (as remembered). An eccentric tilt wheel is the same function. The constant part is a
tilt zero, and over few tilts it looks like a wrong tilt step (0.99).
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import LinearAngleTerm
from gyrorig_solver.model.terms.protocol import TermParameter
from gyrorig_solver.model.terms.scene import Scene
from gyrorig_solver.model.terms.wording import DEG


def _parameter(name: str) -> TermParameter:
    return TermParameter(
        name=name,
        unit="rad",
        typical=0.1 * DEG,
        lower=-2.0 * DEG,
        upper=2.0 * DEG,
        prior_std=0.5 * DEG,
        parts=("tilt",),
    )


class TiltSag(LinearAngleTerm):
    """c and s."""

    cause = "tilt_sag"
    parameters = (_parameter("cosine"), _parameter("sine"))
    confused_with = ("step_resolution", "axis_nonorthogonality", "board_slip")
    excitation = "pan swept at five tilts over the whole range"
    harm = "M and the scales take it up: tens of standard deviations before it shows"

    def shapes(self, scene: Scene, values: FloatArray) -> list[tuple[int, FloatArray]]:
        """Return cosine and sine of the tilt angle."""
        tilt = scene.angle_rad[1]
        return [(1, np.cos(tilt)), (1, np.sin(tilt))]

    def sentence(self, values: FloatArray) -> str:
        """Say the amplitude."""
        size = float(np.hypot(values[0], values[1])) / DEG
        return f"the tilt axis gives way to the payload's weight by up to {size:.3g} deg"


TERM = TiltSag()
