"""The worm, or the motor, is not even: an error that repeats with the stage's angle.

angle + c cos(2 pi angle/P) + s sin(2 pi angle/P) on each axis. A PTU-E46-17.5 has 17.5
motor turns to one of the stage: P = 20.57 deg; a worm of two starts on 35 teeth would make it
10.29 deg a tooth. 0.005 to 0.03 deg (as remembered): 0.02 deg is a ripple of 0.6 % of the
rate at 20.57 deg. Locked to the angle, not to time: its frequency goes with the speed.
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import LinearAngleTerm, scanned
from gyrorig_solver.model.terms.protocol import Link, TermParameter
from gyrorig_solver.model.terms.scene import Scene
from gyrorig_solver.model.terms.wording import DEG, PAN_TILT, listed

TURN_RAD = 2.0 * np.pi / 17.5  # of the stage, to one of the motor


def _parameter(name: str) -> TermParameter:
    return TermParameter(
        name=name,
        unit="rad",
        typical=0.015 * DEG,
        lower=-0.5 * DEG,
        upper=0.5 * DEG,
        prior_std=0.1 * DEG,
        parts=PAN_TILT,
    )


class WormError(LinearAngleTerm):
    """c, then s, for pan and tilt each; then the period."""

    cause = "worm_error"
    link: Link = "drive"
    parameters = (
        _parameter("cosine"),
        _parameter("sine"),
        TermParameter(
            name="period",
            unit="rad",
            typical=0.01 * TURN_RAD,
            lower=0.5 * DEG,
            upper=90.0 * DEG,
            prior_std=0.02 * TURN_RAD,
            role="shape",
            start=TURN_RAD,
        ),
    )
    confused_with = ("eccentricity", "supply_hum", "step_resolution")
    excitation = "sweeps over several worm turns; the same stretch at two speeds"
    harm = "little where sweeps span whole worm turns; else the scale takes a part"

    def shapes(self, scene: Scene, values: FloatArray) -> list[tuple[int, FloatArray]]:
        """Return cosine of pan and tilt, then sine."""
        phase = scene.angle_rad * (2.0 * np.pi / float(values[4]))
        waves = (np.cos(phase), np.sin(phase))
        return [(axis, wave[axis]) for wave in waves for axis in (0, 1)]

    def bank(self, scene: Scene) -> FloatArray:
        """Look from a motor's turn, its half, its third and a quarter of it."""
        return scanned(self, period=TURN_RAD / np.array([1.0, 2.0, 3.0, 4.0]))

    def sentence(self, values: FloatArray) -> str:
        """Say amplitudes and period."""
        size = np.hypot(values[:2], values[2:4]) / DEG
        said = listed(size, PAN_TILT, "deg")
        return f"the worm makes the angle uneven every {values[4] / DEG:.2f} deg: +-{said}"


TERM = WormError()
