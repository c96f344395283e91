"""Rate random walk: the bias is a random walk.

One-sided density 2 K^2/(2 pi f)^2 (IEEE Std 952, annex C, one-sided), K = 0.3 to 3 mdeg/s/sqrt(s):
low-frequency power that the next cycle does not repeat. The noise model contains it. It is a cause
only if K is far above the usual value of the part.
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.term import BinnedDependence, size_parameter
from gyrorig_solver.model.term_kinds import ZeroMeanTerm
from gyrorig_solver.model.value_format import DEG, XYZ, format_list


class BiasRandomWalk(ZeroMeanTerm):
    """The rate random walk K for x, y, z."""

    cause = "bias_random_walk"
    title = "The bias follows a random walk"
    equation = "S(f) of the bias = 2 level^2 / (2 pi f)^2"
    part = "sensor"
    kind = "stochastic"
    parameters = (
        size_parameter(
            "level",
            "rad/s/sqrt(s)",
            XYZ,
            typical=1e-3,
            lower=0.0,
            limit=0.1,
            prior_std=0.01,
            factor=DEG,
        ),
    )
    confused_with = ("bias_ramp", "warm_up", "thermal_bias", "bias_step")
    remedy = "change nothing at the rig, because the standard uncertainties include the random walk"
    file_remedy = "change nothing, because the standard uncertainties include the random walk"
    covariates = None
    picture = BinnedDependence("mean", "time")
    is_noise_process = True
    similar_in_draws = "any other slow change of the bias"
    excitation = "a static recording of at least ten minutes"
    effect_if_ignored = "the stated bias is valid for minutes only"

    def density(self, frequency_hz: FloatArray, values: FloatArray) -> FloatArray:
        """Return the added one-sided density of the rate, (k, 3)."""
        shape = 2.0 / (2.0 * np.pi * frequency_hz) ** 2
        return np.asarray(np.outer(shape, values**2), dtype=np.float64)

    def describe(self, values: FloatArray) -> str:
        levels = format_list(values / DEG, XYZ, "deg/s after one second")
        return f"the bias follows a random walk: {levels}"


TERM = BiasRandomWalk()
