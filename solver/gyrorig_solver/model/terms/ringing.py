"""The stage rings on its mount after each start and stop.

angle + A q, q'' + 2 z w q' + w^2 q = -angle'': a mode of the head, excited by the motor's
acceleration; A is its share in the stage's turn. 5 to 60 Hz, damping 0.025 to 0.1 (Q 5 to 20),
shares of 3 to 12 % (as remembered).
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import LinearAngleTerm, scanned
from gyrorig_solver.model.terms.profiles import resonance
from gyrorig_solver.model.terms.protocol import TermParameter
from gyrorig_solver.model.terms.scene import Scene
from gyrorig_solver.model.terms.wording import PAN_TILT, listed

LOWEST_HZ, HIGHEST_HZ = 3.0, 60.0  # of a head on its mount


class Ringing(LinearAngleTerm):
    """A for pan and tilt, then frequency and damping of the mode."""

    cause = "ringing"
    reshapes: bool = True
    parameters = (
        TermParameter(
            name="share",
            unit="1",
            typical=0.05,
            lower=0.0,
            upper=2.0,
            prior_std=1.0,
            parts=PAN_TILT,
        ),
        TermParameter(
            name="frequency",
            unit="Hz",
            typical=1.0,
            lower=1.0,
            upper=80.0,
            prior_std=20.0,
            role="shape",
            start=10.0,
        ),
        TermParameter(
            name="damping",
            unit="1",
            typical=0.03,
            lower=0.002,
            upper=0.35,
            prior_std=0.1,
            role="shape",
            start=0.05,
        ),
    )
    confused_with = ("base_compliance", "s_curve", "supply_hum")
    excitation = "hard stops with rests of half a second or more behind them"
    harm = "little: the time offset takes a part"

    def shapes(self, scene: Scene, values: FloatArray) -> list[tuple[int, FloatArray]]:
        """Return the deflections of pan and tilt."""
        mode = float(values[2]), float(values[3])
        return [(k, resonance(scene.edges_s, scene.angle_rad[k], *mode)) for k in (0, 1)]

    def bank(self, scene: Scene) -> FloatArray:
        """Scan the mode, as finely as its damping makes it wide."""
        found = []
        for damping in (0.03, 0.1, 0.25):
            count = 1 + int(np.log(HIGHEST_HZ / LOWEST_HZ) / (2.0 * damping))
            modes = np.geomspace(LOWEST_HZ, HIGHEST_HZ, count)
            found.append(scanned(self, frequency=modes, damping=np.array([damping])))
        return np.concatenate(found)

    def sentence(self, values: FloatArray) -> str:
        """Say share and frequency."""
        said = listed(values[:2] * 100.0, PAN_TILT, "%")
        return f"the stage rings at {values[2]:.1f} Hz (damping {values[3]:.2g}): {said}"


TERM = Ringing()
