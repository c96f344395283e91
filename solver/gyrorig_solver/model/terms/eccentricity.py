"""The pan wheel is not round about its axis: an error once per turn.

pan + Re(z (exp(-i pan) + w exp(-2 i pan))), z = c + i s: the gain goes with the pan angle. 0.02
to 0.1 deg (as remembered). A wheel that sits off its axis is seldom quite round either, and two
bearings run out each for itself: w is the share that comes twice per turn, with its phase
against the first. The same on tilt cannot be told from a sagging payload (see `tilt_sag`).
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import LinearAngleTerm
from gyrorig_solver.model.terms.protocol import Link, TermParameter
from gyrorig_solver.model.terms.scene import Scene
from gyrorig_solver.model.terms.wording import DEG


def _parameter(name: str) -> TermParameter:
    return TermParameter(
        name=name,
        unit="rad",
        typical=0.05 * DEG,
        lower=-1.0 * DEG,
        upper=1.0 * DEG,
        prior_std=0.3 * DEG,
        parts=("pan",),
    )


def _oval(name: str) -> TermParameter:
    return TermParameter(
        name=name,
        unit="1",
        typical=0.25,
        lower=-1.0,
        upper=1.0,
        prior_std=0.5,
        role="shape",
    )


class Eccentricity(LinearAngleTerm):
    """c and s; then w, along the first and a quarter period ahead of it."""

    cause = "eccentricity"
    link: Link = "wheel"
    parameters = (_parameter("cosine"), _parameter("sine"), _oval("oval"), _oval("oval_across"))
    confused_with = ("worm_error", "step_resolution")
    excitation = "pan over its full range; over +-80 deg one and two per turn look alike"
    harm = "the scale holds for the pan angles of the recording"

    def shapes(self, scene: Scene, values: FloatArray) -> list[tuple[int, FloatArray]]:
        """Return cosine and sine of the pan angle, each with its part twice per turn."""
        pan, along, across = scene.angle_rad[0], float(values[2]), float(values[3])
        cosine, sine = np.cos(2.0 * pan), np.sin(2.0 * pan)
        return [
            (0, np.cos(pan) + along * cosine + across * sine),
            (0, np.sin(pan) + along * sine - across * cosine),
        ]

    def sentence(self, values: FloatArray) -> str:
        """Say the amplitude."""
        size = float(np.hypot(values[0], values[1])) / DEG
        return f"the pan axis is off by +-{size:.3g} deg once per turn"


TERM = Eccentricity()
