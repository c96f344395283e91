"""The gain anew where a cause cuts rates off: by its exact effect, not by its slope.

A rate below a threshold does not show, and nor does a little more gain of it: beside a dead
zone the fit's derivative by the gain is zero wherever a rate is swallowed, and a fit that
began from what the base model made of the swallowed rates stays there. Another cause that
turns or scales the rate by as much as the gain should have moved then wins what is the
gain's: a slip of the board before its first move, an axis that is not square. So the gain
is looked for once more as if all rates showed, and judged by what then does.

What to use when: `regained` for a fit in which a cause that cuts rates off has come to act.

Source: that a step along one slope is taken where another, exact cost falls is
Levenberg-Marquardt with an approximate Jacobian; Dennis and Schnabel, Numerical Methods for
Unconstrained Optimization, chapter 10.
"""

from dataclasses import replace

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.discover.refit import Weighed, refit
from gyrorig_solver.discover.scores import Seen
from gyrorig_solver.discover.wandering import log_likelihood
from gyrorig_solver.estimate.chain import CUTTING
from gyrorig_solver.estimate.extension import Extension
from gyrorig_solver.estimate.likelihood import GAINS, Solution, solve_again
from gyrorig_solver.estimate.projection import Projection
from gyrorig_solver.model.terms.bases import LinearTerm
from gyrorig_solver.model.terms.protocol import Link, Part, TermParameter
from gyrorig_solver.model.terms.scene import Scene

TURNS = 2  # each from where the last one ended
ASKED = 4.0  # deviations of the statistic's scatter above its mean: then the residual asks for it
WORTH_NATS = 2.0  # less is no other place, but the same one better found
# From where: what is best to first order, or by damped steps from next to none; where much is
# swallowed the former is wild, where little is the latter may stay on the plain it began on.
STARTS = (0.0, 1e-9)
SHOWN_SIGMA = 2.0  # deviations of an entry of the gain: then the data show that it changes
MOST = 0.2  # of a gain: a board that is turned by more was put on another way


class GainChange(LinearTerm):
    """What is added to G, row by row."""

    cause = "gain_change"
    part: Part = "sensor"
    link: Link = "sensor"
    as_if_shown: bool = True
    parameters = (
        TermParameter(
            name="gain",
            unit="1",
            typical=1e-2,
            lower=-MOST,
            upper=MOST,
            prior_std=MOST,
            parts=tuple(f"{row}{column}" for row in "xyz" for column in "xyz"),
        ),
    )
    excitation = "fast moves about every axis"
    harm = "none: it is the calibration"

    def basis(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return each rate of the stage on each axis of the sensor, (9, blocks, 3)."""
        seen = scene.seen(scene.rate_rad_s)
        found = np.zeros((3, 3, *seen.shape))
        for row in range(3):
            found[row, :, :, row] = seen.T
        return found.reshape(GAINS, *seen.shape)

    def sentence(self, values: FloatArray) -> str:
        """Say the largest."""
        return f"the gain is off by up to {np.abs(values).max():.2g}"


def cuts(extensions: tuple[Extension, ...]) -> bool:
    """Return whether a cause that cuts rates off is at work."""
    return any(one.acts and one.term.link in CUTTING for one in extensions)


def regained(solution: Solution) -> Solution:
    """Return the fit with its gain looked for by what it does; itself where that wins nothing."""
    if not cuts(solution.extensions):
        return solution
    for _ in range(TURNS):
        beside = Projection.of(solution)
        if not _asks(beside):
            break
        nats, better = log_likelihood(solution) + WORTH_NATS, None
        for start in STARTS:
            one = refit(beside, GainChange(), None, [np.full(GAINS, start)])
            if one is None or one.won < WORTH_NATS:
                continue
            for change in _steps(one):
                estimate = solution.estimate.copy()
                estimate[:GAINS] += change
                there = solve_again(replace(solution, estimate=estimate), solution.extensions)
                if log_likelihood(there) > nats:
                    nats, better = log_likelihood(there), there
        if better is None:
            break
        solution = better
    return solution


def _steps(one: Weighed) -> list[FloatArray]:
    """Return the whole change of the gain, and what of it the data show.

    An entry that hardly any motion shows may be found anywhere within its deviation, and a fit
    that began from there would settle at another place.
    """
    whole = one.extension.values
    shown = np.where(np.abs(whole) > SHOWN_SIGMA * one.std, whole, 0.0)
    return [whole, shown] if 0 < np.count_nonzero(shown) < GAINS else [whole]


def _asks(beside: Projection) -> bool:
    """Return whether the residual would have more gain, were all rates to show."""
    change = GainChange()
    white = beside.signals(lambda scene: change.directions(scene, np.zeros(GAINS)), term=change)
    seen = Seen.of(beside.look(white))
    spread = float(np.sqrt(2.0 * max(seen.degrees_of_freedom, 1)))
    return seen.statistic > seen.degrees_of_freedom + ASKED * spread
