"""The sensor's low-pass is not the one that its configuration says.

The cut-off is f_c e^v: a register that selects 12.5 instead of 25 Hz is v = -0.69; between
parts of one type the cut-off varies by some 10 %. Nearly all of it is a lag, which the time
offset takes (0.998 of the energy); what is left is the shape of fast edges, on all axes and
both motors alike. The lag is left to the time offset for good: the effect is the other filter
without what it is slower by, so that a fit need not move its offset by milliseconds.
"""

from dataclasses import replace

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.low_pass import LowPass
from gyrorig_solver.model.terms.bases import CurvedTerm, scanned
from gyrorig_solver.model.terms.protocol import Link, Part, TermParameter
from gyrorig_solver.model.terms.scene import Scene

HIGHEST_SHARE = 0.45  # of the grid's rate: a bilinear filter cannot have a higher cut-off


class LowPassLag(CurvedTerm):
    """The logarithm of the cut-off over the configured one."""

    cause = "low_pass_lag"
    part: Part = "sensor"
    link: Link = "low_pass"
    parameters = (
        TermParameter("log_cutoff", "1", typical=0.3, lower=-1.6, upper=1.6, prior_std=1.0),
    )
    confused_with = ("base_compliance", "s_curve", "base_speed_jump", "clock_offset")
    excitation = "the fastest accelerations that the unit can, on both axes"
    harm = "the time offset holds for this filter only; scale up to 40 ppm at 12.5 Hz"

    def effect(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the difference of the two filters' outputs, (blocks, 3)."""
        there = self.passed(scene, values)
        if there is scene:
            return np.zeros((scene.blocks, 3))
        return scene.mean(there.now_rad_s - scene.now_rad_s)

    def passed(self, scene: Scene, values: FloatArray) -> Scene:
        """Return the scene with the other filter, its delay taken off."""
        other = self._other(scene, values)
        if other is None or scene.low_pass is None:
            return scene
        slower_s = other.delay_s - scene.low_pass.delay_s
        there = replace(scene, low_pass=other)
        return there.with_delay(np.full(scene.use.size, slower_s))

    def _other(self, scene: Scene, values: FloatArray) -> LowPass | None:
        if scene.low_pass is None or values[0] == 0.0:
            return None
        highest = HIGHEST_SHARE * scene.low_pass.rate_hz
        cutoff = min(scene.low_pass.bandwidth_hz * float(np.exp(values[0])), highest)
        return replace(scene.low_pass, bandwidth_hz=cutoff)

    def bandwidth_share(self, values: FloatArray) -> float:
        """Return the true cut-off over the configured one: the sensor's noise passes it too."""
        return float(np.exp(values[0]))

    def bank(self, scene: Scene) -> FloatArray:
        """Look from both sides; the effect is far from linear."""
        return scanned(self, log_cutoff=np.array([-0.7, -0.35, -0.1, 0.1, 0.35, 0.7]))

    def missing(self, scene: Scene) -> str | None:
        """Say that no cut-off is known."""
        if scene.low_pass is None:
            return "the low-pass is not known here; record the board's bandwidth_hz"
        return None

    def sentence(self, values: FloatArray) -> str:
        """Say the cut-off."""
        return f"the low-pass cuts off at {np.exp(values[0]):.2f} times the configured bandwidth"


TERM = LowPassLag()
