"""The bias wanders at random.

One-sided density 2 K^2/(2 pi f)^2 (IEEE Std 952, annex C, one-sided), K = 0.3 to 3
mdeg/s/sqrt(s): low-frequency power that the next cycle does not repeat. The noise model has
it; here it is a cause only where K is far above what the part has.
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import UnseenTerm
from gyrorig_solver.model.terms.protocol import Kind, Part, TermParameter
from gyrorig_solver.model.terms.wording import DEG, XYZ, listed


class BiasRandomWalk(UnseenTerm):
    """K for x, y, z."""

    cause = "bias_random_walk"
    part: Part = "sensor"
    kind: Kind = "stochastic"
    parameters = (
        TermParameter(
            name="level",
            unit="rad/s/sqrt(s)",
            typical=1e-3 * DEG,
            lower=0.0,
            upper=0.1 * DEG,
            prior_std=0.01 * DEG,
            parts=XYZ,
        ),
    )
    confused_with = ("bias_ramp", "warm_up", "thermal_bias", "bias_step")
    excitation = "a static recording of ten minutes or more"
    harm = "the bias holds for minutes only"

    def density(self, frequency_hz: FloatArray, values: FloatArray) -> FloatArray:
        """Return what it adds to the one-sided density of the rate, (k, 3)."""
        shape = 2.0 / (2.0 * np.pi * frequency_hz) ** 2
        return np.asarray(np.outer(shape, values**2), dtype=np.float64)

    def sentence(self, values: FloatArray) -> str:
        """Say the levels."""
        return f"the bias wanders: {listed(values / DEG * 1e3, XYZ, 'mdeg/s after a second')}"


TERM = BiasRandomWalk()
