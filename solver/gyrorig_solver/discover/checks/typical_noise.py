"""Separates a bias random walk from unmodelled low-frequency effects.

An unmodelled effect raises the fitted noise levels, mainly flicker and random walk. The effect then
seems less significant. Effects of three times the detectable size raised the flicker to ten times
that of a typical part, and were then five times less significant. Therefore the search uses typical
noise levels. A cause is accepted if the likelihood rises as much with fitted levels. If the bias
really has a random walk, the likelihood does not rise as much.

What to use when: `build_projector` for the search, `build_usual_projector` for the tests of the
residual, `whittle_log_likelihood` of a fit, `measure_bias_walk` for an unusual random walk.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.discover.cause_findings import DependenceTest
from gyrorig_solver.discover.checks.walk_profile import (
    TYPICAL_POWER_FACTOR,
    fit_usual_noises,
    profile_walks,
)
from gyrorig_solver.estimate import (
    PRIOR_LOG_STD,
    ConvergedFit,
    NoiseModel,
    NuisanceProjector,
    Spectrum,
    nominal_levels,
)
from gyrorig_solver.model import XYZ
from gyrorig_solver.numerics import chi2_upper_tail

WALK_COVARIATE = "wandering"  # the bias is a random walk
LEVEL_TOLERANCE = 0.2  # relative difference from the levels of a typical part that does not count


def build_projector(solution: ConvergedFit, typical: bool = True) -> NuisanceProjector:
    """Return the nuisance projector of a fit, with typical or with fitted noise levels."""
    if not typical or has_typical_noise(solution):
        return NuisanceProjector.at_fit(solution)
    return NuisanceProjector.at_fit(
        solution, noises=[limit_to_typical(noise) for noise in solution.noises]
    )


def build_usual_projector(solution: ConvergedFit) -> NuisanceProjector:
    """Return the nuisance projector with the best noise levels that usual parts have.

    An effect of the time that no cause explains raises the fitted levels of flicker and walk. It
    then looks like noise. Below the levels of usual parts, it cannot be distinguished from noise.
    """
    return NuisanceProjector.at_fit(solution, noises=fit_usual_noises(solution))


def has_typical_noise(solution: ConvergedFit) -> bool:
    """Return whether a fit's noise levels are those of a typical part."""
    return all(
        np.allclose(limit_to_typical(noise).levels, noise.levels, rtol=LEVEL_TOLERANCE, atol=0.0)
        for noise in solution.noises
    )


def limit_to_typical(noise: NoiseModel) -> NoiseModel:
    """Return the noise with flicker and walk limited to twice a typical part's amplitude."""
    upper = np.stack(
        [TYPICAL_POWER_FACTOR * nominal_levels(float(axis[0])) for axis in noise.levels]
    )
    upper[:, 0] = np.inf
    return replace(noise, levels=np.minimum(noise.levels, upper))


def whittle_log_likelihood(solution: ConvergedFit) -> float:
    """Return the Whittle log-likelihood of a fit's residual, with the priors of the levels."""
    return _whittle(zip(solution.spectra, solution.noises, strict=True))


def whittle_log_evidence(solution: ConvergedFit, typical: bool = False) -> float:
    """Return the log-likelihood with the Occam factor of the levels (Laplace's approximation).

    A level that the data determine exactly uses a small part of its prior, which costs evidence.
    `typical`: the bias has at most the random walk of a typical part.
    """
    noises = [limit_to_typical(noise) if typical else noise for noise in solution.noises]
    fits = list(zip(solution.spectra, noises, strict=True))
    total = _whittle(fits)
    for spectrum, noise in fits:
        shape = spectrum.unit_densities(noise.sampling)[1:3]
        level_shares = (
            noise.levels[:, 1:3, None] * shape / spectrum.expected_density(noise).T[:, None]
        )
        for axis in level_shares:
            information = 0.5 * (axis * spectrum.count) @ axis.T
            total -= 0.5 * float(np.linalg.slogdet(np.eye(2) + PRIOR_LOG_STD**2 * information)[1])
    return total


def measure_bias_walk(solution: ConvergedFit) -> DependenceTest:
    """Test by the likelihood ratio whether the bias has an unusual random walk."""
    gains_nats = [profile.gain_nats for profile in profile_walks(solution)]
    unusual = sum(gain > 0.0 for gain in gains_nats)
    statistic = 2.0 * sum(gains_nats)
    # All axes of all recordings were tested, so their number multiplies the p-value (Bonferroni).
    p_value = len(gains_nats) * chi2_upper_tail(statistic, unusual) if unusual else 1.0
    ratios = np.stack([excess_walk(noise) for noise in solution.noises]).max(axis=0)
    worst = int(np.argmax(ratios))
    description = (
        f"on the time: the bias wanders {float(ratios[worst]):.1f} times as much as that of a "
        f"typical sensor ({XYZ[worst]})"
    )
    return DependenceTest(WALK_COVARIATE, description, statistic, unusual, min(1.0, p_value))


def excess_walk(noise: NoiseModel) -> FloatArray:
    """Return the larger ratio of flicker and walk to those of a typical part, shape (3,)."""
    typical = np.stack([nominal_levels(float(axis[0])) for axis in noise.levels])
    return np.asarray(np.sqrt(np.max(noise.levels[:, 1:3] / typical[:, 1:3], axis=1)), np.float64)


def _whittle(fits: Iterable[tuple[Spectrum, NoiseModel]]) -> float:
    total = 0.0
    for spectrum, noise in fits:
        density = spectrum.expected_density(noise)
        misfit = np.log(density) + spectrum.density / density
        total -= 0.5 * float(np.sum(spectrum.count[:, None] * misfit))
        total -= 0.5 * sum(_prior_deviation_squared(axis) for axis in noise.levels)
    return total


def _prior_deviation_squared(levels: Sequence[float] | FloatArray) -> float:
    """Return the squared distance of an axis' levels from typical levels, in prior deviations."""
    ratio = np.asarray(levels)[1:3] / nominal_levels(float(levels[0]))[1:3]
    return float(np.sum((np.log(ratio) / PRIOR_LOG_STD) ** 2))
