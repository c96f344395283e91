"""The motors start at a base speed that nobody told of.

Below the base speed a stepper starts and stops at once: the ramp begins at v_b above the
told one. 57 positions/s, 2.9 deg/s, is a factory setting (as remembered). Nearly all of it
is a shorter move, which start delays and the time offset take (0.998).
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.acceleration_error import laid_anew, no_profiles, redone
from gyrorig_solver.model.terms.bases import AngleTerm, scanned
from gyrorig_solver.model.terms.protocol import Link, TermParameter
from gyrorig_solver.model.terms.scene import Scene
from gyrorig_solver.model.terms.wording import DEG, PAN_TILT, listed


class BaseSpeedJump(AngleTerm):
    """Speed above the told base speed for pan and tilt."""

    cause = "base_speed_jump"
    link: Link = "profile"
    parameters = (
        TermParameter(
            name="speed",
            unit="rad/s",
            typical=2.9 * DEG,
            lower=0.0,
            upper=30.0 * DEG,
            prior_std=10.0 * DEG,
            parts=PAN_TILT,
        ),
    )
    confused_with = ("s_curve", "acceleration_error", "low_pass_lag", "clock_offset")
    excitation = "moves at several speeds; set the base speeds explicitly and log them"
    harm = "the time offset takes it; little else moves"

    def change(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the moves as they were done minus as told, (2, n + 1)."""
        return redone(scene, (0.0, 0.0), (float(values[0]), float(values[1])))

    def passed(self, scene: Scene, values: FloatArray) -> Scene:
        """Return the scene with the moves laid anew."""
        return laid_anew(scene, (0.0, 0.0), (float(values[0]), float(values[1])))

    def bank(self, scene: Scene) -> FloatArray:
        """Look from several jumps."""
        return scanned(self, speed=DEG * np.array([0.5, 1.5, 3.0, 6.0]))

    def missing(self, scene: Scene) -> str | None:
        """Say that the moves' profiles are not known."""
        return no_profiles(scene)

    def sentence(self, values: FloatArray) -> str:
        """Say the speeds."""
        return f"the motors start at once with {listed(values / DEG, PAN_TILT, 'deg/s')}"


TERM = BaseSpeedJump()
