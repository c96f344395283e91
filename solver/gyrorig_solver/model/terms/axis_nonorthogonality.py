"""The pan axis does not stand at a right angle on the tilt axis.

Seen from the tilt axis' carrier, the pan axis is (sin e, 0, cos e): pan turns the stage by
a part about its tilt axis too,

    omega = (tilt_rate + pan_rate sin e, pan_rate cos e sin t, pan_rate cos e cos t).

Machined units 0.1 to 0.3 deg (as remembered, no data sheet names it). At one tilt, or two,
the gain absorbs it whole. Gravity does not show it either: on a level rig it adds the same to
every reading of an accelerometer, as its bias does.
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import CurvedTerm
from gyrorig_solver.model.terms.protocol import Link, Part, Scope, TermParameter
from gyrorig_solver.model.terms.scene import Scene
from gyrorig_solver.model.terms.wording import DEG


class AxisNonOrthogonality(CurvedTerm):
    """One angle, e, from the right angle; positive leans the pan axis to +x."""

    cause = "axis_nonorthogonality"
    part: Part = "ptu"
    link: Link = "axes"
    scope: Scope = "unit"
    parameters = (
        TermParameter(
            name="angle",
            unit="rad",
            typical=0.15 * DEG,
            lower=-2.0 * DEG,
            upper=2.0 * DEG,
            prior_std=0.5 * DEG,
        ),
    )
    confused_with = ("board_slip", "tilt_sag")
    excitation = "pan swept at three or more tilts, far apart"
    harm = "the gain's x row and M take it up: up to 46 standard deviations before it shows"

    def effect(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the exact change of rate, (blocks, 3)."""
        return self._along(scene, float(np.sin(values[0])), float(np.cos(values[0])) - 1.0)

    def columns(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return its derivative, (1, blocks, 3)."""
        return self._along(scene, float(np.cos(values[0])), -float(np.sin(values[0])))[None]

    def missing(self, scene: Scene) -> str | None:
        """Say that the reference has no axes."""
        return None if scene.has_angles else "the reference has no pan and tilt; use a unit"

    def sentence(self, values: FloatArray) -> str:
        """Say the angle."""
        return f"pan and tilt axis are {abs(values[0]) / DEG:.3f} deg off a right angle"

    def _along(self, scene: Scene, across: float, along: float) -> FloatArray:
        pan, tilt = scene.pan_rate_rad_s, scene.tilt_rad
        rate = np.column_stack(
            [pan * across, pan * along * np.sin(tilt), pan * along * np.cos(tilt)]
        )
        return scene.seen_at_stage(rate)


TERM = AxisNonOrthogonality()
