"""Bias random walk as a named cause, from the noise levels of a fit.

The noise levels include the random walk, therefore the residual shows nothing. The walk is named
if the fitted levels are significantly more likely than typical ones, if a random walk fits better
than flicker, if no other test is significant, and if no alternative cause is nearly as likely.

What to use when: `RandomWalkCheck` after a search; causes that the walk leaves possible (a step, a
warm-up) are listed with it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.discover.cause_findings import NamedCause, RivalCause
from gyrorig_solver.discover.cause_ranking import credible_set
from gyrorig_solver.discover.checks.model_check import (
    DEPENDENCE_FALSE_ALARM_RATE,
    JudgedModel,
    Verdict,
)
from gyrorig_solver.discover.checks.residual_dependence import residual_dependence_tests
from gyrorig_solver.discover.checks.typical_noise import (
    TYPICAL_POWER_FACTOR,
    has_typical_noise,
    limit_to_typical,
)
from gyrorig_solver.discover.fit_space import NoiseAlternative
from gyrorig_solver.discover.motion_space import MotionFitSpace
from gyrorig_solver.discover.named_causes import name_outside_fit
from gyrorig_solver.discover.testable_terms import FALSE_ALARM_RATE
from gyrorig_solver.estimate import (
    PRIOR_LOG_STD,
    ConvergedFit,
    NoiseModel,
    Spectrum,
    nominal_levels,
    unit_densities,
)
from gyrorig_solver.estimate.noise.noise_model import quantum_density
from gyrorig_solver.model import XYZ
from gyrorig_solver.model.causes.bias_random_walk import BiasRandomWalk
from gyrorig_solver.numerics import chi2_upper_tail

FLICKER, WALK = 1, 2  # which of a noise model's levels
ACTING_NATS = 4.5  # of one axis, three deviations: there it acts
JUMP_AVERAGING_S = (1.0, 2.0, 4.0)  # means long enough that the white noise does not hide a leap
JUMP_KURTOSIS_SIGMA = 3.5
MIN_MEANS = 20  # means
MAX_LOG_LEVEL_SHIFT = (
    12.0  # of a level's logarithm from an ordinary part's: 400 times its amplitude
)
LEVEL_GRID_POINTS = 241  # levels along that way


@dataclass(frozen=True, slots=True, eq=False)
class _LevelProfile:
    """The profile log-likelihood of one noise level on one axis of one recording."""

    log_levels: FloatArray  # (LOOKS,)
    nats: FloatArray  # (LOOKS,), above what an ordinary part's level would have

    @property
    def gain_nats(self) -> float:
        """The log-likelihood of the best level minus that of a typical part's highest."""
        return max(float(self.nats.max()), 0.0)

    def posterior_level(self) -> tuple[float, float]:
        """Return the posterior mean of the level's root, and its standard deviation."""
        deviation = (self.log_levels - self.log_levels.mean()) / PRIOR_LOG_STD
        log_posterior = self.nats - 0.5 * deviation**2
        weight = np.exp(log_posterior - log_posterior.max())
        weight /= weight.sum()
        root = np.exp(0.5 * self.log_levels)
        mean = float(weight @ root)
        return mean, float(np.sqrt(weight @ (root - mean) ** 2))


class RandomWalkCheck:
    """Names a random walk of the bias if nothing else is significant in addition to it."""

    removes_names = False

    def judge(self, model: JudgedModel[MotionFitSpace]) -> Verdict:
        """Return the named walk, and the tests of the residual with noise levels that contain it.

        Other dependences are separate and come first.
        """
        solution = model.space.solution
        walk = detect_random_walk(
            solution, model.tests, FALSE_ALARM_RATE, model.result.noise_alternatives
        )
        if walk is None:
            return Verdict()
        tests = residual_dependence_tests(model.space.projector())
        if any(test.p_value < DEPENDENCE_FALSE_ALARM_RATE for test in tests):
            return Verdict()
        return Verdict(named=(walk,), dependence_tests=tuple(tests))


def detect_random_walk(
    solution: ConvergedFit,
    tests: int,
    alpha: float,
    noise_alternatives: Sequence[NoiseAlternative] = (),
) -> NamedCause | None:
    """Return a bias random walk as a named cause; None where it is that of a typical part.

    Args:
        solution: the last fit of a search.
        tests: how many share the false alarms.
        alpha: rate of false alarms of all of them.
        noise_alternatives: causes that are significant with typical noise levels only.
    """
    if has_typical_noise(solution):
        return None
    walk = [_profile_level(*profile, WALK) for profile in _axis_spectra(solution)]
    flicker = [_profile_level(*profile, FLICKER) for profile in _axis_spectra(solution)]
    axis_gains = np.array([profile.gain_nats for profile in walk]).reshape(-1, 3).sum(axis=0)
    gain = float(axis_gains.sum())
    if gain < sum(profile.gain_nats for profile in flicker):
        return None
    if _residual_has_jumps(solution, axis_gains > ACTING_NATS):
        return None
    p_value = min(1.0, chi2_upper_tail(2.0 * gain, float(np.sum(axis_gains > 0.0))) * tests)
    if p_value >= alpha:
        return None
    shares = [
        float(np.exp(min(profile.log_evidence, MAX_LOG_LEVEL_SHIFT)))
        for profile in noise_alternatives
    ]
    posterior = 1.0 / (1.0 + sum(shares))
    rivals = [
        _describe_rival(alternative, share, posterior)
        for alternative, share in sorted(
            zip(noise_alternatives, shares, strict=True), key=lambda pair: -pair[1]
        )
    ]
    acting = np.flatnonzero((axis_gains > ACTING_NATS) | (axis_gains == axis_gains.max()))
    return name_outside_fit(
        BiasRandomWalk(),
        *_combine_levels(walk),
        tuple(XYZ[k] for k in acting),
        statistic=2.0 * gain,
        degrees_of_freedom=int(np.sum(axis_gains > 0.0)),
        p_value=p_value,
        posterior=posterior,
        one_of=credible_set(posterior, ((rival.cause, rival.posterior) for rival in rivals)),
        rivals=tuple(rivals),
    )


def _axis_spectra(solution: ConvergedFit) -> Iterator[tuple[Spectrum, NoiseModel, NoiseModel, int]]:
    """Yield each recording's axes: spectrum, levels, levels limited to typical ones, axis index."""
    for spectrum, noise in zip(solution.spectra, solution.noises, strict=True):
        calm = limit_to_typical(noise)  # levels of a typical part at most
        for axis in range(3):
            yield spectrum, noise, calm, axis


def _profile_level(
    spectrum: Spectrum, noise: NoiseModel, limited: NoiseModel, axis: int, which: int
) -> _LevelProfile:
    """Profile one level of an axis, the others not above a typical part's."""
    typical = nominal_levels(float(noise.levels[axis, 0]))
    log_levels = np.log(typical[which]) + np.linspace(
        -MAX_LOG_LEVEL_SHIFT, MAX_LOG_LEVEL_SHIFT, LEVEL_GRID_POINTS
    )
    shape = unit_densities(spectrum.frequency_hz, noise.sampling)
    if spectrum.white_power is not None:
        shape[0] *= spectrum.white_power[:, axis]
    other_levels = limited.levels[axis].copy()
    other_levels[which] = 0.0
    other_density = other_levels @ shape + quantum_density(noise.sampling)
    density = other_density + np.exp(log_levels)[:, None] * shape[which]
    nats = -0.5 * (np.log(density) + spectrum.density[:, axis] / density) @ spectrum.count
    typical_levels = log_levels <= np.log(float(TYPICAL_POWER_FACTOR * typical[which]))
    return _LevelProfile(log_levels, nats - float(nats[typical_levels].max(initial=float(nats[0]))))


def has_jumps(signal: FloatArray, rate_hz: float) -> bool:
    """Return whether a signal has jumps, by the kurtosis of its increments.

    Judged by the kurtosis of the differences of means, whose deviation is sqrt(24/n) for
    normal ones (Kendall and Stuart, The Advanced Theory of Statistics, volume 1).

    Args:
        signal: shape (n, k).
        rate_hz: of it.
    """
    for mean_s in JUMP_AVERAGING_S:
        block = max(1, round(mean_s * rate_hz))
        whole = len(signal) // block
        if whole <= MIN_MEANS:
            continue
        mean = signal[: whole * block].reshape(whole, block, -1).mean(axis=1)
        step = np.diff(mean, axis=0)
        unit = (step - step.mean(axis=0)) / np.maximum(step.std(axis=0), 1e-30)
        kurtosis = np.mean(unit**4, axis=0) - 3.0
        if np.any(kurtosis > JUMP_KURTOSIS_SIGMA * np.sqrt(24.0 / len(step))):
            return True
    return False


def _residual_has_jumps(solution: ConvergedFit, axes: BoolArray) -> bool:
    return any(
        has_jumps(np.where(used[:, None], residual, 0.0)[:, axes], session.sampling.rate_hz)
        for session in solution.sessions
        for residual, used in zip(session.residuals(solution.gain), session.used, strict=True)
    )


def _combine_levels(profiles: Sequence[_LevelProfile]) -> tuple[FloatArray, FloatArray]:
    """Return the walk of each axis and its uncertainty over all recordings, (3,) each."""
    levels = np.array([profile.posterior_level() for profile in profiles]).reshape(-1, 3, 2)
    weight = levels[:, :, 1] ** -2.0
    total = weight.sum(axis=0)
    return np.sum(weight * levels[:, :, 0], axis=0) / total, total**-0.5


def _describe_rival(alternative: NoiseAlternative, share: float, posterior: float) -> RivalCause:
    return RivalCause(
        alternative.candidate.extension.term.cause,
        alternative.likelihood_gain_nats,
        share * posterior,
        "a model with this cause still needs a random walk of the bias"
        if share < 1.0
        else "the alternative fits as well",
    )
