"""Does the bias wander, or does the model lack something slow? Both look alike at first.

What a model lacks raises the noise levels that are found beside it, most of all the slow
ones, and hides behind them: effects three times as large as can just be detected made the
flicker look ten times an ordinary part's, and so themselves five times less significant.
Hence everything is looked for with levels that are calmed to an ordinary part's, and
believed where the likelihood rises as much with levels found anew beside it. A bias that
does wander does not become likelier by a step, or by a function of an angle.

What to use when: `beside` for the space in which to look, `log_likelihood` of a fit,
`risen` for signals that no fit has, `wandering` for how much of it there is.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.chance import chi2_tail
from gyrorig_solver.discover.result import Signature
from gyrorig_solver.estimate.likelihood import Solution
from gyrorig_solver.estimate.noise import (
    SPREAD,
    NoiseModel,
    Periodogram,
    Spectrum,
    binned,
    fit_levels,
    ordinary_levels,
    shapes,
)
from gyrorig_solver.estimate.projection import Projection

WILD = 5.0  # times an ordinary part's wandering: that is odd in itself
CALM = 4.0  # times the power of an ordinary part's wandering
COVARIATE = "wandering"
LEVELS = 2  # of an axis: flicker and walk
SAME_LEVELS = 0.2  # relative: nothing hides behind levels that are an ordinary part's


def beside(solution: Solution, calm: bool = True) -> Projection:
    """Return the space beside a fit, its noise calmed or as it was found."""
    if not calm or is_calm(solution):
        return Projection.of(solution)
    return Projection.of(solution, noises=[calmed(noise) for noise in solution.noises])


def is_calm(solution: Solution) -> bool:
    """Return whether a fit's own noise levels are an ordinary part's."""
    return all(
        np.allclose(calmed(one).levels, one.levels, rtol=SAME_LEVELS, atol=0.0)
        for one in solution.noises
    )


def calmed(noise: NoiseModel) -> NoiseModel:
    """Return a noise that wanders no more than twice as much as an ordinary part's."""
    most = np.stack([CALM * ordinary_levels(float(axis[0])) for axis in noise.levels])
    most[:, 0] = np.inf
    return replace(noise, levels=np.minimum(noise.levels, most))


def log_likelihood(solution: Solution) -> float:
    """Return Whittle's log likelihood of a fit's residual, the levels' priors in it."""
    return _whittle(zip(solution.spectra, solution.noises, strict=True))


def log_evidence(solution: Solution, calm: bool = False) -> float:
    """Return the log likelihood less Occam's factor of the levels (Laplace's approximation).

    A level that has to be what it is has less of its prior than one that may be anything.
    `calm`: the bias wanders no more than an ordinary part's.
    """
    noises = [calmed(one) if calm else one for one in solution.noises]
    found = list(zip(solution.spectra, noises, strict=True))
    total = _whittle(found)
    for spectrum, noise in found:
        shape = shapes(spectrum.frequency_hz, noise.sampling)[1:3]
        share = noise.levels[:, 1:3, None] * shape / noise.density(spectrum.frequency_hz).T[:, None]
        for axis in share:
            told = 0.5 * (axis * spectrum.count) @ axis.T
            total -= 0.5 * float(np.linalg.slogdet(np.eye(2) + SPREAD**2 * told)[1])
    return total


@dataclass(frozen=True, slots=True)
class Wandering:
    """How much more a bias wanders beside a fit than an ordinary part's."""

    ratio: float  # of amplitudes, the largest of all axes and recordings
    axis: str
    signature: Signature

    @property
    def wild(self) -> bool:
        """Whether that is odd in itself: then what calmed levels show is believed."""
        return self.ratio > WILD


def wandering(solution: Solution) -> Wandering:
    """Return how much a bias wanders, by the likelihood of its levels against calmed ones."""
    pairs = [(n, calmed(n)) for n in solution.noises]
    free = _whittle(zip(solution.spectra, solution.noises, strict=True), prior=False)
    held = [one for _, one in pairs]
    rise = 2.0 * max(free - _whittle(zip(solution.spectra, held, strict=True), prior=False), 0.0)
    capped = sum(int(np.sum(n.levels > c.levels)) for n, c in pairs)
    ratios = np.stack([excess(n) for n in solution.noises]).max(axis=0)
    worst = int(np.argmax(ratios))
    ratio = float(ratios[worst])
    words = f"on the time: the bias wanders {ratio:.1f} times as much as an ordinary part's"
    # Any of the levels could have been the one: all were looked at (Bonferroni).
    looked = LEVELS * sum(len(n.levels) for n in solution.noises)
    p_value = min(1.0, looked * chi2_tail(rise, capped)) if capped else 1.0
    return Wandering(
        ratio,
        "xyz"[worst],
        Signature(COVARIATE, f"{words} ({'xyz'[worst]})", rise, capped, p_value),
    )


def excess(noise: NoiseModel) -> FloatArray:
    """Return flicker or walk, whichever is more, against an ordinary part's, shape (3,)."""
    usual = np.stack([ordinary_levels(float(axis[0])) for axis in noise.levels])
    return np.asarray(np.sqrt(np.max(noise.levels[:, 1:3] / usual[:, 1:3], axis=1)), np.float64)


def risen(projection: Projection, white: FloatArray, sizes: FloatArray) -> float:
    """Return by how many nats the likelihood rises if signals are taken out of a residual.

    Args:
        projection: the space beside the fit.
        white: signals, whitened, (k, all).
        sizes: how much of each, (k,).
    """
    before = projection.left(projection.residual)
    after = before - projection.left(sizes @ white)
    return _of_residual(projection, after) - _of_residual(projection, before)


def _of_residual(projection: Projection, white: FloatArray) -> float:
    """Return Whittle's log likelihood of a whitened residual (all,), its levels found anew."""
    rates, found = projection.unwhitened(white), []
    for s in projection.stretches:
        own, rates = rates[: len(s.used)], rates[len(s.used) :]
        sampling = s.noise.sampling
        pieces = [
            Periodogram.of(rate, sampling.rate_hz, float(np.mean(used)))
            for rate, used in zip(own, s.used, strict=True)
        ]
        spectrum = binned(pieces)
        found.append((spectrum, fit_levels(spectrum, sampling)))
    return _whittle(found)


def _whittle(found: Iterable[tuple[Spectrum, NoiseModel]], prior: bool = True) -> float:
    total = 0.0
    for spectrum, noise in found:
        density = noise.density(spectrum.frequency_hz)
        misfit = np.log(density) + spectrum.density / density
        total -= 0.5 * float(np.sum(spectrum.count[:, None] * misfit))
        total -= 0.5 * sum(_unlikely(axis) for axis in noise.levels if prior)
    return total


def _unlikely(levels: Sequence[float] | FloatArray) -> float:
    """Return how far an axis' levels lie from an ordinary part's, squared, in deviations."""
    ratio = np.asarray(levels)[1:3] / ordinary_levels(float(levels[0]))[1:3]
    return float(np.sum((np.log(ratio) / SPREAD) ** 2))
