"""A bias that wanders far more than an ordinary part's, as a cause with a name.

The noise levels hold such a bias, so no residual is left of it; what is odd are the levels.
It is named where the likelihood of the levels as they are beats that of an ordinary part's by
more than chance, where a random walk says it better than flicker, where beside it nothing
else is odd, and where no cause that was doubted for it is nearly as likely.

What to use when: `look_for_walk` beside the last fit of a search; a name beside it that the
walk leaves open (a step, a warming) is stated with it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.chance import chi2_tail
from gyrorig_solver.discover.result import NamedCause, Rival, Value
from gyrorig_solver.discover.search import STATED, Doubt
from gyrorig_solver.discover.wandering import CALM, calmed, is_calm
from gyrorig_solver.estimate.extension import Extension
from gyrorig_solver.estimate.likelihood import Solution
from gyrorig_solver.estimate.noise import (
    SPREAD,
    NoiseModel,
    Spectrum,
    ordinary_levels,
    quantum_density,
    shapes,
)
from gyrorig_solver.model.terms.bias_random_walk import BiasRandomWalk
from gyrorig_solver.model.terms.wording import XYZ

FLICKER, WALK = 1, 2  # which of a noise model's levels
SHOWN_NATS = 4.5  # of one axis, three deviations: there it acts
JUMPS_S = (1.0, 2.0, 4.0)  # means long enough that the white noise does not hide a leap
JUMPS_SIGMA = 3.5
FEWEST = 20  # means
FARTHEST = 12.0  # of a level's logarithm from an ordinary part's: 400 times its amplitude
LOOKS = 241  # levels along that way


@dataclass(frozen=True, slots=True, eq=False)
class _Axis:
    """What one axis of one recording says of one of its levels."""

    log_levels: FloatArray  # (LOOKS,)
    nats: FloatArray  # (LOOKS,), above what an ordinary part's level would have

    @property
    def rise(self) -> float:
        """Nats that the best level is above an ordinary part's highest."""
        return max(float(self.nats.max()), 0.0)

    def level(self) -> tuple[float, float]:
        """Return the root of the level, and its deviation, by its posterior."""
        away = (self.log_levels - self.log_levels.mean()) / SPREAD
        belief = self.nats - 0.5 * away**2
        weight = np.exp(belief - belief.max())
        weight /= weight.sum()
        root = np.exp(0.5 * self.log_levels)
        mean = float(weight @ root)
        return mean, float(np.sqrt(weight @ (root - mean) ** 2))


def look_for_walk(
    solution: Solution, tests: int, alpha: float, doubts: Sequence[Doubt] = ()
) -> NamedCause | None:
    """Return a wandering bias as a cause, None where it wanders as an ordinary part's.

    Args:
        solution: the last fit of a search.
        tests: how many share the false alarms.
        alpha: rate of false alarms of all of them.
        doubts: causes that a bias as calm as an ordinary part's would have made significant.
    """
    if is_calm(solution):
        return None
    walk = [_along(*one, WALK) for one in _axes(solution)]
    flicker = [_along(*one, FLICKER) for one in _axes(solution)]
    risen = np.array([one.rise for one in walk]).reshape(-1, 3).sum(axis=0)
    rise = float(risen.sum())
    if rise < sum(one.rise for one in flicker):
        return None
    if _leaping(solution, risen > SHOWN_NATS):
        return None
    p_value = min(1.0, chi2_tail(2.0 * rise, float(np.sum(risen > 0.0))) * tests)
    if p_value >= alpha:
        return None
    term = BiasRandomWalk()
    own = term.parameters[0]
    values, stds = _levels(walk)
    shares = [float(np.exp(min(one.evidence, FARTHEST))) for one in doubts]
    posterior = 1.0 / (1.0 + sum(shares))
    rivals = sorted(zip(doubts, shares, strict=True), key=lambda pair: -pair[1])
    some = np.flatnonzero((risen > SHOWN_NATS) | (risen == risen.max()))
    return NamedCause(
        term=term,
        where=tuple(XYZ[k] for k in some),
        extension=Extension(term, values, np.zeros(0, dtype=np.int64)),
        values=tuple(
            Value(f"{own.name}.{axis}", float(value), float(std), own.unit, own.typical)
            for axis, value, std in zip(XYZ, values, stds, strict=True)
        ),
        statistic=2.0 * rise,
        degrees_of_freedom=int(np.sum(risen > 0.0)),
        p_value=p_value,
        posterior=posterior,
        one_of=_stated(rivals, posterior),
        rivals=_as_rivals(rivals, posterior),
        changes=(),  # the levels hold it: what it spoils, the deviations say
        gain=None,
    )


def _axes(solution: Solution) -> Iterator[tuple[Spectrum, NoiseModel, NoiseModel, int]]:
    """Yield each recording's axes: spectrum, levels, the same calmed, and which axis."""
    for spectrum, noise in zip(solution.spectra, solution.noises, strict=True):
        calm = calmed(noise)
        for axis in range(3):
            yield spectrum, noise, calm, axis


def _along(spectrum: Spectrum, noise: NoiseModel, calm: NoiseModel, axis: int, which: int) -> _Axis:
    """Return what an axis says of one level, the others no higher than an ordinary part's."""
    usual = ordinary_levels(float(noise.levels[axis, 0]))
    log_levels = np.log(usual[which]) + np.linspace(-FARTHEST, FARTHEST, LOOKS)
    shape = shapes(spectrum.frequency_hz, noise.sampling)
    others = calm.levels[axis].copy()
    others[which] = 0.0
    beside = others @ shape + quantum_density(noise.sampling)
    density = beside + np.exp(log_levels)[:, None] * shape[which]
    nats = -0.5 * (np.log(density) + spectrum.density[:, axis] / density) @ spectrum.count
    ordinary = log_levels <= np.log(float(CALM * usual[which]))
    return _Axis(log_levels, nats - float(nats[ordinary].max(initial=float(nats[0]))))


def leaps(signal: FloatArray, rate_hz: float) -> bool:
    """Return whether a signal goes by leaps: what a random walk adds is normally distributed.

    Judged by the kurtosis of the differences of means, whose deviation is sqrt(24/n) for
    normal ones (Kendall and Stuart, The Advanced Theory of Statistics, volume 1).

    Args:
        signal: shape (n, k).
        rate_hz: of it.
    """
    for mean_s in JUMPS_S:
        block = max(1, round(mean_s * rate_hz))
        whole = len(signal) // block
        if whole <= FEWEST:
            continue
        mean = signal[: whole * block].reshape(whole, block, -1).mean(axis=1)
        step = np.diff(mean, axis=0)
        unit = (step - step.mean(axis=0)) / np.maximum(step.std(axis=0), 1e-30)
        kurtosis = np.mean(unit**4, axis=0) - 3.0
        if np.any(kurtosis > JUMPS_SIGMA * np.sqrt(24.0 / len(step))):
            return True
    return False


def _leaping(solution: Solution, axes: BoolArray) -> bool:
    return any(
        leaps(np.where(used[:, None], residual, 0.0)[:, axes], session.sampling.rate_hz)
        for session in solution.sessions
        for residual, used in zip(session.residuals(solution.gain), session.used, strict=True)
    )


def _levels(walk: Sequence[_Axis]) -> tuple[FloatArray, FloatArray]:
    """Return the walk of each axis and its deviation, all recordings together, (3,) each."""
    each = np.array([one.level() for one in walk]).reshape(-1, 3, 2)
    weight = each[:, :, 1] ** -2.0
    total = weight.sum(axis=0)
    return np.sum(weight * each[:, :, 0], axis=0) / total, total**-0.5


def _stated(rivals: Sequence[tuple[Doubt, float]], posterior: float) -> tuple[str, ...]:
    names, total = [], posterior
    for rival, share in rivals:
        if total >= STATED:
            break
        names.append(rival.weighed.extension.term.cause)
        total += share * posterior
    return tuple(names)


def _as_rivals(rivals: Sequence[tuple[Doubt, float]], posterior: float) -> tuple[Rival, ...]:
    return tuple(
        Rival(
            one.weighed.extension.term.cause,
            one.rise,
            share * posterior,
            "beside it the bias would have to wander still" if share < 1.0 else "it fits as well",
        )
        for one, share in rivals
    )
