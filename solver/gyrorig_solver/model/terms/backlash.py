"""The gears have a gap: after a reversal the motor turns and the stage does not.

A play operator on each axis' angle: the stage follows once the gap g is crossed. The rate is
lost for g/speed after each reversal and never after a restart in the same direction. 0.02 to
0.1 deg, growing with wear (the maker's FAQ); 0.2 deg is a worn worm. On tilt the payload may
lean on one side of the gap at all times; then there is none, and its sign turns at balance.

The operator's output lies about the input. The unit's zero does not: it was found with the
wheel against one face, the one that homing's last way, or the payload, pushed it to, so the
stage is at the told angle when it comes from that side and a whole gap short of it from the
other. Which face it was no motion shows: half the gap is a tilt zero, a turn of the
misalignment about x. It is not fitted; the deviation of the gain holds it.
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import AngleTerm, scanned
from gyrorig_solver.model.terms.profiles import play
from gyrorig_solver.model.terms.protocol import Link, TermParameter
from gyrorig_solver.model.terms.scene import Scene
from gyrorig_solver.model.terms.wording import DEG, PAN_TILT, listed


class Backlash(AngleTerm):
    """The gap, then where in it the recording begins (1: pushing up), for pan and tilt."""

    cause = "backlash"
    link: Link = "play"
    parameters = (
        TermParameter(
            name="gap",
            unit="rad",
            typical=0.05 * DEG,
            lower=0.0,
            upper=1.0 * DEG,
            prior_std=0.3 * DEG,
            parts=PAN_TILT,
        ),
        TermParameter(
            name="begin",
            unit="1",
            typical=1.0,
            lower=-1.0,
            upper=1.0,
            prior_std=1.0,
            parts=PAN_TILT,
            role="shape",
        ),
    )
    confused_with = ("base_compliance", "lost_steps", "clock_offset", "dead_zone")
    excitation = "reversals and restarts in the same direction, at two speeds or more"
    derivative_step = 0.02  # contact moves from interval to interval
    harm = "little: each reversal is short; the angle between rests is off by the gap"

    def change(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return what the gap keeps back, (2, n + 1)."""
        found = np.zeros_like(scene.angle_rad)
        for axis in (0, 1):
            if values[axis] != 0.0:
                # What the axis did before this part of a series decides, where it is known.
                begin = scene.pushed(axis) or float(values[2 + axis])
                told = scene.angle_rad[axis]
                found[axis] = play(told, float(values[axis]), begin) - told
        return found

    def tilt_zero_std_rad(self, values: FloatArray) -> float:
        """Return half the gap of tilt: homing ended at one face or the other."""
        return 0.5 * float(values[1])

    def bank(self, scene: Scene) -> FloatArray:
        """Look from gaps a factor of two apart, pushing up, down or not at the begin."""
        return scanned(
            self,
            gap=DEG * 0.002 * 2.0 ** np.arange(10.0),
            begin=np.array([-1.0, 0.0, 1.0]),
        )

    def sentence(self, values: FloatArray) -> str:
        """Say the gaps."""
        return f"the gears have play: {listed(values[:2] / DEG, PAN_TILT, 'deg')}"


TERM = Backlash()
