"""A step is not the angle that the resolution says.

angle (1 + e) on each axis, from the count's zero: a gear ratio, a step mode, a rounded
resolution (185.1428 as 185 arcsec is 7.7e-4). On pan the gain's y and z columns take it
whole: nothing shows. On tilt it shows in where the pan axis lies in the stage over tilt.
"""

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import LinearAngleTerm
from gyrorig_solver.model.terms.protocol import Link, TermParameter
from gyrorig_solver.model.terms.scene import Scene
from gyrorig_solver.model.terms.wording import PAN_TILT, listed


class StepResolution(LinearAngleTerm):
    """e for pan and tilt."""

    cause = "step_resolution"
    link: Link = "drive"
    parameters = (
        TermParameter(
            name="share",
            unit="1",
            typical=1e-3,
            lower=-0.1,
            upper=0.1,
            prior_std=0.02,
            parts=PAN_TILT,
        ),
    )
    confused_with = ("tilt_sag", "clock_skew", "eccentricity")
    excitation = "pan swept at three tilts or more, far apart; pan's needs a known turn"
    harm = "the scale of y and z is off by pan's share, and nothing shows in a residual"

    def shapes(self, scene: Scene, values: FloatArray) -> list[tuple[int, FloatArray]]:
        """Return the angles themselves."""
        return [(0, scene.angle_rad[0]), (1, scene.angle_rad[1])]

    def sentence(self, values: FloatArray) -> str:
        """Say the shares."""
        return f"a step is not what it is said to be: {listed(values * 100.0, PAN_TILT, '%')}"


TERM = StepResolution()
