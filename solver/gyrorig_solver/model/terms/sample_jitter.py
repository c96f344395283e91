"""Each sample is taken a little before or after its stamp, at random.

y(t + d), d white with deviation s: noise of variance s^2 (dy/dt)^2, there while the stage
accelerates and nowhere else. Polled gyros, arrival stamps instead of the board's: 1 to 20 ms;
interrupts 5 to 50 us. Nothing shows in the mean but a smoothing of order s^2.
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import UnseenTerm
from gyrorig_solver.model.terms.protocol import Kind, Part, Scope, TermParameter
from gyrorig_solver.model.terms.scene import Scene


class SampleJitter(UnseenTerm):
    """One deviation."""

    cause = "sample_jitter"
    part: Part = "clock"
    kind: Kind = "stochastic"
    scope: Scope = "recording"
    parameters = (
        TermParameter("deviation", "s", typical=5e-4, lower=0.0, upper=0.05, prior_std=0.01),
    )
    confused_with = ("acceleration_error", "repeated_samples")
    excitation = "long accelerations next to rests; stamps made on the board"
    harm = "the fit weighs accelerations too much; uncertainties are too small"

    def variance(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the variance that it adds to each block mean, (blocks, 3)."""
        slope = scene.filtered_slope_rad_s2
        return np.asarray(values[0] ** 2 * scene.read(slope**2) / self._samples(scene), np.float64)

    def shape(self, scene: Scene) -> FloatArray:
        """Return what a unit of it adds to each block mean, (blocks, 3).

        All axes of a block by one random number, for a sample is early or late on all of them.
        """
        slope = scene.read(scene.filtered_slope_rad_s2)
        return np.asarray(slope / np.sqrt(self._samples(scene)), dtype=np.float64)

    def _samples(self, scene: Scene) -> FloatArray:
        """Return how many samples are in each block mean, (blocks, 1)."""
        used = scene.use.reshape(scene.blocks, scene.block).sum(axis=1)
        period_s = scene.setting.sample_period_s
        instant_s = scene.fine * scene.step_s
        each = 1.0 if period_s is None else max(1.0, instant_s / period_s)
        return np.asarray(np.maximum(used * each, 1.0)[:, None], dtype=np.float64)

    def sentence(self, values: FloatArray) -> str:
        """Say the deviation."""
        return f"the samples' times scatter by {values[0] * 1e3:.3g} ms about their stamps"


TERM = SampleJitter()
