"""The ramps have rounded corners: acceleration comes on over a time.

The angle's mean over a box of length L about each instant (a jerk-limited profile with
jerk = acceleration/L). The box's own delay, L/2, is left out: start delays and the time
offset take it. 10 to 100 ms; for short L the change is L^2/24 angle'', so it grows as L^2, and
only its sign tells it from a base that gives way.
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import AngleTerm, scanned
from gyrorig_solver.model.terms.profiles import box_mean
from gyrorig_solver.model.terms.protocol import Link, TermParameter
from gyrorig_solver.model.terms.scene import Scene
from gyrorig_solver.model.terms.wording import PAN_TILT, listed


class SCurve(AngleTerm):
    """L for pan and tilt."""

    cause = "s_curve"
    link: Link = "motor"
    parameters = (
        TermParameter(
            name="length",
            unit="s",
            typical=0.03,
            lower=0.0,
            upper=0.5,
            prior_std=0.1,
            parts=PAN_TILT,
        ),
    )
    confused_with = ("base_compliance", "base_speed_jump", "low_pass_lag", "acceleration_error")
    excitation = "the fastest accelerations; several boards with different low-passes"
    harm = "the time offset takes it; little else moves"

    def change(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the rounded angles minus the told ones, (2, n + 1)."""
        rounded = [
            box_mean(scene.edges_s, angle, float(length))
            for angle, length in zip(scene.angle_rad, values, strict=True)
        ]
        return np.stack(rounded) - scene.angle_rad

    def bank(self, scene: Scene) -> FloatArray:
        """Look from several lengths; there is no derivative at zero."""
        return scanned(self, length=np.array([0.01, 0.02, 0.04, 0.08, 0.16]))

    def sentence(self, values: FloatArray) -> str:
        """Say the lengths."""
        return f"the ramps' corners are rounded over {listed(values * 1e3, PAN_TILT, 'ms')}"


TERM = SCurve()
