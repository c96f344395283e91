"""The board's clock and the unit's run at different rates.

Label t belongs to true time t - e (t - mid), mid the middle of the recording; e > 0: the
board's clock is fast. Crystals 20 to 50 ppm, ceramic resonators 640 ppm (an UNO R3), RC or
MEMS sample rates 0.5 to 8 % where the rate itself is taken as the clock. The scale of all
axes goes with it: (1 + e) of a rate is the same by another clock.
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import TimeTerm, scanned
from gyrorig_solver.model.terms.protocol import Scope, TermParameter
from gyrorig_solver.model.terms.scene import Scene


class ClockSkew(TimeTerm):
    """One ratio, e."""

    cause = "clock_skew"
    scope: Scope = "recording"
    parameters = (TermParameter("rate", "1", typical=3e-5, lower=-0.1, upper=0.1, prior_std=0.02),)
    confused_with = ("clock_step", "lost_samples", "thermal_scale")
    excitation = "starts and stops over the whole recording, and host receive times"
    harm = "the scale of all axes is off by the skew"

    def delay(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return -e (t - mid), (instants,)."""
        return float(values[0]) * self._away(scene)

    def delay_columns(self, scene: Scene, values: FloatArray) -> dict[int, FloatArray]:
        """Return -(t - mid)."""
        return {0: self._away(scene)}

    def bank(self, scene: Scene) -> FloatArray:
        """Look from no skew, and from resonators' and sample rates' errors."""
        return scanned(self, rate=np.array([0.0, 1e-3, -1e-3, 1e-2, -1e-2]))

    def sentence(self, values: FloatArray) -> str:
        """Say the skew."""
        which = "fast" if values[0] > 0.0 else "slow"
        return f"the board's clock is {abs(values[0]) * 1e6:.3g} ppm {which} against the unit's"

    def _away(self, scene: Scene) -> FloatArray:
        middle = (scene.setting.begin_s + scene.setting.end_s) / 2.0
        return np.asarray(middle - scene.instants_s, dtype=np.float64)


TERM = ClockSkew()
