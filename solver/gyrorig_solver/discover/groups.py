"""Nameless tests: does a residual depend on an angle, a speed, the time, a transient?

Free functions of each covariate are projected off all that a fit can follow, like a cause:
at first the smooth ones alone, then ever more detail. What is significant here and
explained by no cause is "unexplained, depends on X". Where several covariates are
significant, for most programs let one pass for the other, X is the one whose free
function is the most likely to have made the residual.

What to use when: `signatures` for all of it; `scatter` for what shows in the variance only.
"""

from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.arrays import FloatArray, IntArray
from gyrorig_solver.chance import chi2_tail
from gyrorig_solver.discover.free_shapes import Family, families
from gyrorig_solver.discover.growth import by_speed, grown
from gyrorig_solver.discover.result import Signature
from gyrorig_solver.discover.scores import VANISHED, Seen
from gyrorig_solver.discover.wandering import risen
from gyrorig_solver.estimate.projection import Looked, Projection
from gyrorig_solver.model.terms.sample_jitter import SampleJitter

DETAILS = (3.0, 8.0, np.inf)  # half waves that are looked at together, coarse to fine
SINGLE = 4  # tests of the scatter
WORTH_A_LOOK = 0.05  # by calmed levels
NOTHING = Seen(0.0, 0, np.zeros(0))
SIZES = np.exp(np.linspace(-4.0, 16.0, 61))  # of a free function, squared, in deviations


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """What a family of free functions says of a residual."""

    seen: Seen  # by the detail that shows most
    at: IntArray  # (k,), which signals that are
    p_value: float  # the choice of the detail counted


def signatures(projection: Projection, as_found: Projection | None = None) -> list[Signature]:
    """Return all nameless tests of a residual, the least likely by chance first.

    Args:
        projection: the space beside the fit.
        as_found: where its noise levels are calmed, the same with those that were found:
            what passes for odd must make the likelihood rise, the levels found anew.
    """
    every = list(families(projection.scenes))
    tests = len(every) + SINGLE
    found = {one.covariate: one for one in scatter(as_found or projection, tests)}
    for family in every:
        one = _signature(projection, as_found, family, tests)
        before = None if one is None else found.get(one.covariate)
        if one is not None and (before is None or one.p_value < before.p_value):
            found[one.covariate] = one
    return sorted(found.values(), key=lambda one: (one.p_value, -one.statistic))


def _signature(
    projection: Projection, as_found: Projection | None, family: Family, tests: int
) -> Signature | None:
    white = family.white(projection)
    looked = projection.look(white)
    judged = judge(looked, family.detail)
    if judged is None:
        return None
    seen, p_value = judged.seen, judged.p_value
    if as_found is not None and p_value * tests < WORTH_A_LOOK:
        rise = 2.0 * max(risen(projection, white[judged.at], seen.values), 0.0)
        seen = replace(seen, statistic=min(rise, seen.statistic))
        p_value = len(DETAILS) * chi2_tail(seen.statistic, seen.degrees_of_freedom)
    return Signature(
        family.covariate,
        family.words,
        seen.statistic,
        seen.degrees_of_freedom,
        min(1.0, p_value * tests),
        evidence=evidence(looked, family.detail),
    )


def judge(looked: Looked, detail: FloatArray, beside: int = 0) -> Judged | None:
    """Return what signals say, the detail chosen that shows most; None where nothing is left.

    Each set of signals up to some detail gives a chi-squared statistic where there is nothing
    but noise; the least likely of m sets is no less likely than its chance times m
    (Bonferroni). A wide function is found by few degrees of freedom so, and a fine one at
    the price of ln m nats.

    Args:
        looked: what the projection says of them.
        detail: of each signal, half waves.
        beside: so many more signals come first, which the fit may follow as well: what they
            explain is taken off, and so are their degrees of freedom.
    """
    first = np.arange(beside)
    least = Seen.of(looked.part(first)) if beside else NOTHING
    sets = {int((detail <= most).sum()): np.flatnonzero(detail <= most) for most in DETAILS}
    best: Judged | None = None
    for some in sets.values():
        if not some.size:
            continue
        at = np.concatenate([first, beside + some])
        seen = Seen.of(looked.part(at))
        statistic = max(seen.statistic - least.statistic, 0.0)
        degrees = seen.degrees_of_freedom - least.degrees_of_freedom
        if degrees > 0:
            chance = min(1.0, len(sets) * chi2_tail(statistic, degrees))
            if best is None or chance < best.p_value:
                best = Judged(Seen(statistic, degrees, seen.values), at, chance)
    return best


def evidence(looked: Looked, detail: FloatArray) -> float:
    """Return by how many nats a free function is likelier than none, at its likeliest size.

    The function's parts are taken as independent and normal, of a variance that falls with
    the square of the detail, as Brownian motion's over an interval. Their common size is
    chosen (type II likelihood). A function that could have shown anything pays for it.

    Source: MacKay, Neural Computation 4 (1992) 415; Brownian motion's expansion: Karhunen
    and Loeve.

    Args:
        looked: what the projection says of its parts.
        detail: of each part, half waves.
    """
    some = np.flatnonzero(np.diag(looked.information) > VANISHED * np.maximum(looked.raw, 1e-300))
    if not some.size:
        return 0.0
    width = 1.0 / (np.maximum(detail[some], 1.0) * np.sqrt(looked.raw[some]))
    information = looked.information[np.ix_(some, some)] * np.outer(width, width)
    strength, along = np.linalg.eigh(information)
    keep = strength > VANISHED
    known = strength[keep]
    shown = (along[:, keep].T @ (looked.score[some] * width)) ** 2 / known
    gain = SIZES[:, None] / float(known.max()) * known
    nats = 0.5 * np.sum(shown * gain / (1.0 + gain) - np.log1p(gain), axis=1)
    return max(0.0, float(nats.max()))


def scatter(projection: Projection, tests: int) -> list[Signature]:
    """Return the tests of the whitened residual's variance and of single lines.

    Args:
        projection: the space beside the fit.
        tests: among which all false alarms are shared.
    """
    left = projection.left(projection.residual)
    found: list[Signature] = []
    moving, jitter, power = _shapes(projection)
    some = power > 0.0
    excess = left**2 - 1.0
    for name, words, shapes in (
        ("moving", "on whether and how fast the stage moves, in its scatter", moving),
        ("acceleration_scatter", "on the acceleration, in its scatter", jitter),
    ):
        one = grown(shapes[:, some], excess[some])
        if one.degrees_of_freedom:
            p_value = min(1.0, one.p_value * tests)
            found.append(Signature(name, words, one.statistic, one.degrees_of_freedom, p_value))
    found.append(_line(projection, left, tests))
    return found


def _shapes(projection: Projection) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return, as long as the whitened residual: motion, variance by jitter, and use."""
    moving, jitter, use = [], [], []
    fastest = max(
        (float(np.linalg.norm(m.rate, axis=1).max()) for s in projection.stretches
         for m in s.models if len(m.rate)), default=0.0
    )  # fmt: skip
    for s in projection.stretches:
        for scene, model in zip(s.scenes, s.models, strict=True):
            n = model.used.size
            speed = np.linalg.norm(model.rate, axis=1)
            own = (
                SampleJitter().variance(scene, np.ones(1)).T
                / np.mean(s.noise.variance(n), axis=0)[:, None]
            )
            moving.append(np.tile(by_speed(speed, fastest), (1, 3)))
            jitter.append(own.reshape(1, -1))
            use.append(np.tile(model.used.astype(np.float64), (3, 1)).ravel())
    used = np.concatenate(use)
    return np.concatenate(moving, axis=1) * (used > 0.0), np.concatenate(jitter, axis=1), used


def _line(projection: Projection, left: FloatArray, tests: int) -> Signature:
    """Return the test for a single line in the spectrum of any axis."""
    best, many, start = (0.0, 0.0), 0, 0
    for s in projection.stretches:
        for used in s.used:
            n = used.size
            white = left[start : start + 3 * n].reshape(3, n)
            start += 3 * n
            power = np.abs(np.fft.rfft(white, axis=1)[:, 1:-1]) ** 2 / n
            many += power.size
            at = np.unravel_index(int(np.argmax(power)), power.shape)
            hertz = float(at[1] + 1) / n * s.noise.sampling.rate_hz
            best = max(best, (float(power[at]), hertz))
    p_value = -np.expm1(many * np.log1p(-np.exp(-best[0]))) if many else 1.0
    words = f"on a line at {best[1]:.2f} Hz"
    return Signature("line", words, 2.0 * best[0], 2, min(1.0, float(p_value) * tests))
