"""Does a name hold against a free function of what it hangs on? One that does not is dropped.

A cause of the catalogue has a form: an eccentric wheel is off once and twice a turn, a ramp
is off in proportion to the same ramps told. Physics that is in no catalogue is often near
enough to such a form that the cause is significant and wins against all others there are.
It is not what the data show where they have more of the same kind that the form does not
allow. So each named cause is held against

 * free functions of its own covariates (`OWN`): of the angle, the rate, the time since a
   move began, whatever its form hangs on;
 * its own effect, growing and shrinking with the time, the angles and the speed, on which
   its size must not depend.

Both as score tests beside the fit in which the cause, its sizes and shapes and event, is
free. Where the name is right, and the model else, the statistic of a set of d signals that
the fit cannot follow is chi-squared with d degrees of freedom; the choice among sets is paid
for by Bonferroni, so that a right name is dropped in at most `LEVEL` of all sessions.

A form of an angle must not be decisively less likely than a free function of that angle
either: see `_likelier`.

A right name of a large effect leaves something as well, as every form is a little short
of the truth. What is less than `LITTLE` of what the cause explains is no reason.

What to use when: `kept` after a search; `fillers` and `without` where something is left.

Source: score test, Rao, Linear Statistical Inference, 6e; smooth tests of fit, Neyman 1937.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.discover.free_shapes import Family, families, swells
from gyrorig_solver.discover.groups import evidence, judge
from gyrorig_solver.discover.refit import Weighed
from gyrorig_solver.discover.result import Signature
from gyrorig_solver.discover.search import UNTRUE, Found, Standing
from gyrorig_solver.estimate.extension import Extension
from gyrorig_solver.estimate.likelihood import Solution, solve_again
from gyrorig_solver.estimate.projection import Projection
from gyrorig_solver.model.terms.protocol import indices
from gyrorig_solver.model.terms.scene import Scene

LEVEL = 0.005  # share of right names that may be dropped: a quarter of what names may be lost
LITTLE = UNTRUE  # share of a cause's own statistic
DECISIVE = 4.6  # nats, odds of a hundred: Jeffreys, Theory of Probability, appendix B

_EDGES = ("pan_transient", "tilt_transient", "move_gain", "move_delay")
_ANGLES = ("pan_angle", "tilt_angle")
_RATES = ("own_rate", "speed")
# The covariates that a cause's form hangs on; what is not here has none but its own size.
OWN: dict[str, tuple[str, ...]] = {
    "eccentricity": ("pan_angle",),
    "worm_error": _ANGLES,
    "step_resolution": _ANGLES,
    "tilt_sag": ("tilt_angle",),
    "axis_nonorthogonality": ("tilt_angle",),
    "acceleration_error": (*_EDGES, "speed"),
    "base_speed_jump": (*_EDGES, "speed"),
    "s_curve": (*_EDGES, "speed"),
    "base_compliance": _EDGES,
    "ringing": _EDGES,
    "backlash": _EDGES,
    "low_pass_lag": (*_EDGES, "speed"),
    "scale_asymmetry": _RATES,
    "scale_quadratic": _RATES,
    "scale_cubic": _RATES,
    "saturation": _RATES,
    "dead_zone": _RATES,
    "vibration_rectification": _RATES,
    "motor_coupling": _RATES,
    "bias_ramp": ("bias_time",),
    "bias_step": ("bias_time",),
    "warm_up": ("bias_time",),
    "thermal_bias": ("bias_time",),
    "thermal_scale": ("time",),
    "board_slip": ("time",),
    "clock_skew": ("move_delay",),
    "clock_step": ("move_delay",),
    "lost_samples": ("move_delay",),
    "g_sensitivity": ("bias_tilt",),
    "supply_hum": ("bias_time",),
}
WHOLE_STEP_SIGMA = 5.0  # that a loss must lie below a step to be none


@dataclass(frozen=True, slots=True)
class Against:
    """What free functions have against a name."""

    covariate: str
    words: str
    statistic: float  # that they explain beyond the name
    degrees_of_freedom: int
    p_value: float  # all that it was held against counted


def kept(base: Solution, found: Found) -> tuple[Found, tuple[Signature, ...]]:
    """Return a search's end without the names that do not hold, and what they hang on.

    Args:
        base: the fit of the base model.
        found: where the search ended.
    """
    free = [one for one in found.solution.extensions if one.free.size]
    against = [
        what_is_against(found, one, standing)
        for one, standing in zip(free, found.standings, strict=True)
    ]
    if not any(against):
        return found, ()
    doubts = sorted((one for one in against if one is not None), key=lambda one: one.p_value)
    signatures = tuple(
        Signature(d.covariate, d.words, d.statistic, d.degrees_of_freedom, d.p_value)
        for d in doubts
    )
    return without(base, found, [one is not None for one in against]), signatures


def fillers(found: Found, odd: Sequence[Signature], share: float) -> list[bool]:
    """Return which names may only fill a part of what has no name, of each standing.

    Where a covariate that a cause hangs on is odd beside it by as much, the cause may be the
    part of something larger that its form allows. A cause of another kind is none of that.

    Args:
        found: where the search ended.
        odd: what is odd beside its fit.
        share: of both that a cause must explain.
    """
    doubtful = []
    for one in found.standings:
        own = OWN.get(one.best.extension.term.cause)
        rest = [s.statistic - s.degrees_of_freedom for s in odd if own is None or
                s.covariate in own]  # fmt: skip
        nats = one.best.won if one.here is None else one.here
        won = 2.0 * max(nats, 0.0)
        doubtful.append(won < share * (won + max(rest, default=0.0)))
    return doubtful


def without(base: Solution, found: Found, gone: Sequence[bool]) -> Found:
    """Return a search's end without some of its names, all else fitted anew.

    Args:
        base: the fit of the base model.
        found: where the search ended.
        gone: which of its standings.
    """
    free = [one for one in found.solution.extensions if one.free.size]
    lost = [one for one, is_gone in zip(free, gone, strict=True) if is_gone]
    left = [one for one in found.solution.extensions if all(one is not other for other in lost)]
    solution = base if all(gone) else solve_again(found.solution, left)
    standings = tuple(s for s, is_gone in zip(found.standings, gone, strict=True) if not is_gone)
    return replace(found, solution=solution, standings=standings, last=Projection.of(solution))


def what_is_against(found: Found, one: Extension, standing: Standing) -> Against | None:
    """Return why a name does not hold, None where it does.

    Args:
        found: where the search ended.
        one: a cause of its fit.
        standing: its own.
    """
    projection, explains = found.last, 2.0 * standing.best.won
    if one.term.cause == "lost_steps" and _is_no_step(found.solution, one):
        words = "on a jump of less than one step"
        return Against("pan_transient", words, explains, 1, 0.0)
    scenes = projection.scenes
    own = OWN.get(one.term.cause, ())
    every = [(f, False) for f in families(scenes) if f.covariate in own]
    every += [(f, True) for f in swells(one, scenes)]
    heard = [held_against(projection, one, family, itself) for family, itself in every]
    worst = min((h for h in heard if h is not None), key=lambda h: h.p_value, default=None)
    if worst is not None:
        worst = replace(worst, p_value=min(1.0, worst.p_value * len(every)))
        beyond = worst.statistic - worst.degrees_of_freedom
        if worst.p_value < LEVEL and beyond > LITTLE * explains:
            return worst
    return _likelier(found.solution, one, standing.best)


def _likelier(solution: Solution, one: Extension, best: Weighed) -> Against | None:
    """Return the free function of an angle that is far likelier than a form of it, None if none.

    A form with a few unknowns can be bent so that it leaves little of another function of the
    angle, at sizes that cancel over the range that was seen. Its evidence pays for that.

    Args:
        solution: the fit that the cause is in.
        one: the cause as fitted.
        best: the same as it was weighed.
    """
    own = [name for name in OWN.get(one.term.cause, ()) if name in _ANGLES]
    if not own:
        return None
    others = [other for other in solution.extensions if other is not one]
    without = Projection.of(solution, extensions=others, back=[one])
    for family in families(without.scenes):
        if family.covariate in own:
            ahead = evidence(without.look(family.white(without)), family.detail) - best.evidence
            if ahead > max(DECISIVE, LITTLE * best.won):
                chance = float(np.exp(-ahead))
                return Against(family.covariate, family.words, 2.0 * ahead, 1, chance)
    return None


def held_against(
    projection: Projection, one: Extension, family: Family, itself: bool
) -> Against | None:
    """Return what a family of free functions explains beyond a name, None if nothing can.

    Args:
        projection: the space beside the fit that the cause is in.
        one: the cause as fitted.
        family: the free functions.
        itself: whether they are made of the cause's own effect.
    """
    held = [k for k in (*indices(one.term, role="shape"), *indices(one.term, role="event"))
            if k not in one.free]  # fmt: skip

    def shaped(scene: Scene) -> FloatArray:
        return one.term.columns(scene, one.values)[held]

    white = family.white(projection, one.term if itself else None)
    if held:
        white = np.concatenate([projection.signals(shaped, term=one.term), white])
    judged = judge(projection.look(white), family.detail, beside=len(held))
    if judged is None:
        return None
    seen = judged.seen
    return Against(
        family.covariate, family.words, seen.statistic, seen.degrees_of_freedom, judged.p_value
    )


def _is_no_step(solution: Solution, one: Extension) -> bool:
    """Return whether a loss is clearly less than a step: an angle slips by that, no motor does."""
    setting = solution.sessions[0].setting
    if setting is None or setting.rad_per_step is None:
        return False
    sizes = indices(one.term, role="size")
    first = solution.estimate.size - sum(e.free.size for e in solution.extensions)
    for other in solution.extensions:
        if other is one:
            break
        first += other.free.size
    for j, k in enumerate(one.free):
        if k in sizes and one.values[k] != 0.0:
            step = abs(setting.rad_per_step[sizes.index(int(k))])
            std = float(np.sqrt(solution.decision.covariance[first + j, first + j]))
            if abs(float(one.values[k])) > step - WHOLE_STEP_SIGMA * std:
                return False
    return True
