"""Figures of a set of judged cases, one per goal.

What to use when: `figures` for the numbers that the goals limit, each with its derivation;
`confusion` for the confusion matrix.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from tests.hidden.scoring.goals import (
    BOUND,
    FAR,
    GAP_BEYOND,
    GAP_PER_VALUE,
    GOALS,
    RUNG_WIDTH,
    SEEN,
    Goal,
)
from tests.hidden.scoring.once import Multiplicity, borne
from tests.hidden.scoring.outcome import Outcome, is_sole
from tests.hidden.scoring.possible import Bound
from tests.hidden.scoring.shares import Share

IN_CATALOGUE = ("one", "two", "many")


@dataclass(frozen=True, slots=True)
class Figure:
    """A value and its derivation."""

    value: float  # NaN if there was no case
    words: str


@dataclass(frozen=True, slots=True)
class Gap:
    """Difference between the oracle's held-out gain and the solver's, for one case."""

    seed: int
    nats: float  # the oracle's gain
    short: float  # nats
    values: int  # estimated from the first recording

    @property
    def allowed(self) -> float:
        """The allowed cost of their estimation, in nats."""
        return GAP_PER_VALUE * self.values + GAP_BEYOND


def figures(
    outcomes: Sequence[Outcome],
    gaps: Sequence[Gap] = (),
    bounds: Sequence[Bound] = (),
    measured: Sequence[Multiplicity] = (),
) -> dict[str, Figure]:
    """Return the figure of each goal by name; `measured`: effective trials of a search."""
    nulls = _share(_of_kind(outcomes, "null"), lambda one: one.alarmed)
    rungs = [one for one in _of_kind(outcomes, "one") if on_rung(one, 2.0) or on_rung(one, 3.0)]
    plain = [one for one in rungs if not one.soak]
    soaked = [one for one in rungs if one.soak]
    once = [one for one in _of_kind(outcomes, "one") if on_rung(one, 1.0)]
    bound = [one for one in outcomes if one.kind in IN_CATALOGUE and largest(one) >= _least(BOUND)]
    outside = [one for one in _of_kind(outcomes, "outside") if largest(one) >= _least(FAR)]
    nearly = [one for one in _of_kind(outcomes, "nearly") if largest(one) >= _least(FAR)]
    many = _of_kind(outcomes, "many")
    harm = Share(sum(one.harm_printed for one in outcomes), len(outcomes))
    return {
        "false_alarms": _of(nulls),
        "false_alarms_upper": Figure(nulls.upper if nulls.trials else np.nan, str(nulls)),
        "sole_right": _beside(_of(_share(plain, sole_right)), plain, bounds),
        "sole_right_soak": _beside(_of(_share(soaked, sole_right)), soaked, bounds),
        "wrong_names": _count(_share(bound, lambda one: one.misled)),
        "detected_once": _beside_tests(_share(once, lambda one: one.alarmed), once, measured),
        "outside_wrong": _of(_share(outside, lambda one: one.wrong_sole)),
        "outside_group": _of(_share(outside, right_group)),
        "nearly_wrong": _of(_share(nearly, _nearly_wrong)),
        "recall": _of(recall(many)),
        "precision": _of(precision(many)),
        "gap": _gap(gaps),
        "covered_causes": _of(covered_causes(outcomes)),
        "covered_calibration": _of(covered_calibration(outcomes)),
        "harm_printed": _of(harm),
    }


def missed(figures_: dict[str, Figure], goals: Iterable[Goal] = GOALS) -> list[Goal]:
    """Return the goals that are not met, without those that have no cases."""
    return [
        goal
        for goal in goals
        if not np.isnan(figures_[goal.name].value) and not goal.met(figures_[goal.name].value)
    ]


def on_rung(one: Outcome, times: float) -> bool:
    """Return whether a case hides one cause of the given number of minimum detectable sizes."""
    return len(one.fates) == 1 and abs(one.fates[0].times / times - 1.0) <= RUNG_WIDTH


def largest(one: Outcome) -> float:
    """Return the largest hidden size of a case, in minimum detectable sizes; 0 for none."""
    return max((fate.times for fate in one.fates), default=0.0)


def sole_right(one: Outcome) -> bool:
    """Return whether the only hidden cause is the only stated name."""
    (fate,) = one.fates
    return fate.sole and len(one.sets) == 1


def right_group(one: Outcome) -> bool:
    """Return whether an unexplained rest is reported with the true covariate first."""
    return bool(one.rest) and one.rest[0] in one.expected


def recall(many: Sequence[Outcome]) -> Share:
    """Return the share of detectable hidden causes that are in stated sets."""
    seen = [fate for one in many for fate in one.fates if fate.times >= SEEN]
    return Share(sum(fate.stated for fate in seen), len(seen))


def precision(many: Sequence[Outcome]) -> Share:
    """Return the share of stated sets that contain a hidden cause."""
    sets = sum(len(one.sets) for one in many)
    return Share(sets - sum(len(one.extra) for one in many), sets)


def covered_causes(outcomes: Iterable[Outcome]) -> Share:
    """Return the coverage of the intervals of correctly named sizes."""
    each = [c for one in outcomes if one.kind in IN_CATALOGUE for c in one.covered_causes]
    return Share(sum(c.inside for c in each), len(each))


def covered_calibration(outcomes: Iterable[Outcome]) -> Share:
    """Return the coverage of the calibration's intervals, after selection."""
    kinds = ("null", *IN_CATALOGUE)
    each = [c for one in outcomes if one.kind in kinds for c in one.covered_calibration]
    return Share(sum(c.inside for c in each), len(each))


def confusion(outcomes: Iterable[Outcome], times: float) -> dict[str, Counter[str]]:
    """Return for each cause hidden alone how often it was given which name."""
    found: dict[str, Counter[str]] = {}
    for one in outcomes:
        if one.kind == "one" and on_rung(one, times):
            found.setdefault(one.fates[0].cause, Counter())[one.fates[0].said] += 1
    return dict(sorted(found.items()))


def by_cause(outcomes: Iterable[Outcome], times: float) -> dict[str, list[Outcome]]:
    """Return the cases that hide one cause of a size, by cause."""
    found: dict[str, list[Outcome]] = {}
    for one in outcomes:
        if one.kind == "one" and on_rung(one, times):
            found.setdefault(one.fates[0].cause, []).append(one)
    return dict(sorted(found.items()))


def _nearly_wrong(one: Outcome) -> bool:
    """A shape similar to a cause can have its name; any other sole name is wrong."""
    return any(is_sole(names) and one.near not in names for names in one.sets)


def _of_kind(outcomes: Iterable[Outcome], kind: str) -> list[Outcome]:
    return [one for one in outcomes if one.kind == kind]


def _least(times: float) -> float:
    return times * (1.0 - RUNG_WIDTH)


def _share(some: Sequence[Outcome], hit: Callable[[Outcome], bool]) -> Share:
    return Share(sum(hit(one) for one in some), len(some))


def _of(share: Share) -> Figure:
    return Figure(share.value, str(share))


def _beside(figure: Figure, some: Sequence[Outcome], bounds: Sequence[Bound]) -> Figure:
    """Add the bound on the figure; a case without a bound counts as certain."""
    chance = {one.seed: one.chance for one in bounds}
    each = [chance.get(one.seed, 1.0) for one in some]
    if not each or not chance:
        return figure
    most = 100.0 * sum(each) / len(each)
    return Figure(figure.value, f"{figure.words}; upper bound {most:.1f} %")


def _beside_tests(
    share: Share, once: Sequence[Outcome], measured: Sequence[Multiplicity]
) -> Figure:
    """Add the power of the separate tests of the causes, at the search's number of trials."""
    if not once or not measured:
        return _of(share)
    most = 100.0 * borne(measured, [one.fates[0].cause for one in once])
    return Figure(share.value, f"{share}; separate tests {most:.1f} %")


def _count(share: Share) -> Figure:
    return Figure(float(share.hits) if share.trials else np.nan, str(share))


def _gap(gaps: Sequence[Gap]) -> Figure:
    """Return the median gap to the oracle beyond the allowed cost of estimation."""
    if not gaps:
        return Figure(np.nan, "none measured")
    beyond = [one.short - one.allowed for one in gaps]
    short = float(np.median([one.short for one in gaps]))
    allowed = float(np.median([one.allowed for one in gaps]))
    words = f"median difference {short:.1f} nats in {len(gaps)} cases, allowed {allowed:.1f}"
    return Figure(float(np.median(beyond)), words)
