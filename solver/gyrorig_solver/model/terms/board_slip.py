"""The board slips on its mount.

omega becomes R(r)^T omega from the event on, R(r) the small turn of the board on the stage:
a screw that was not tight, 0.1 to 1 deg. M steps; bias and scales stay.
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.gain import cross_matrix, rotation_matrix
from gyrorig_solver.model.terms.bases import CurvedTerm, event_times, scanned, since
from gyrorig_solver.model.terms.protocol import Link, Part, Scope, TermParameter
from gyrorig_solver.model.terms.scene import Scene
from gyrorig_solver.model.terms.wording import DEG, XYZ, listed

LOOKS = 60  # times over a recording from which a slip is looked for


class BoardSlip(CurvedTerm):
    """The turn about the stage's x, y, z, then when."""

    cause = "board_slip"
    part: Part = "mount"
    link: Link = "mount"
    scope: Scope = "recording"
    parameters = (
        TermParameter(
            name="turn",
            unit="rad",
            typical=0.3 * DEG,
            lower=-10.0 * DEG,
            upper=10.0 * DEG,
            prior_std=2.0 * DEG,
            parts=XYZ,
        ),
        TermParameter(
            "time", "s", typical=1.0, lower=-np.inf, upper=np.inf, prior_std=np.inf, role="event"
        ),
    )
    confused_with = ("thermal_scale", "axis_nonorthogonality", "lost_steps")
    excitation = "the first poses and sweeps once more at the end"
    harm = "M is a mean of two mounts"

    def effect(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the change of the measured rate, (blocks, 3)."""
        turned = scene.rate_rad_s @ rotation_matrix(values[:3]) - scene.rate_rad_s
        return scene.seen_at_stage(since(scene, float(values[3]))[:, None] * turned)

    def directions(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the derivative at no turn, -(e x omega) after the event, (3, blocks, 3)."""
        after = since(scene, float(values[3]))[:, None]
        # A low-pass of each component: what it leaves is turned about all axes at once.
        late = scene.seen(after * scene.rate_rad_s)
        return np.stack([late @ cross_matrix(unit) @ scene.gain.T for unit in np.eye(3)])

    def bank(self, scene: Scene) -> FloatArray:
        """Look from times all over the recording."""
        return scanned(self, time=event_times(scene, LOOKS))

    def sentence(self, values: FloatArray) -> str:
        """Say turn and time."""
        return f"the board slips at {values[3]:.1f} s by {listed(values[:3] / DEG, XYZ, 'deg')}"


TERM = BoardSlip()
