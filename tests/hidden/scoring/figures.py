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
    RIG_GAIN_SIGMA,
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
    nulls = _share(_of_kind(outcomes, "null"), lambda outcome: outcome.alarmed)
    rungs = [
        outcome
        for outcome in _of_kind(outcomes, "one")
        if on_rung(outcome, 2.0) or on_rung(outcome, 3.0)
    ]
    plain = [outcome for outcome in rungs if not outcome.soak]
    soaked = [outcome for outcome in rungs if outcome.soak]
    once = [outcome for outcome in _of_kind(outcomes, "one") if on_rung(outcome, 1.0)]
    bound = [
        outcome
        for outcome in outcomes
        if outcome.kind in IN_CATALOGUE and largest(outcome) >= _least(BOUND)
    ]
    outside = [
        outcome for outcome in _of_kind(outcomes, "outside") if largest(outcome) >= _least(FAR)
    ]
    nearly = [
        outcome for outcome in _of_kind(outcomes, "nearly") if largest(outcome) >= _least(FAR)
    ]
    many, rigs = _of_kind(outcomes, "many"), _of_kind(outcomes, "rig")
    harm = Share(sum(outcome.harm_printed for outcome in outcomes), len(outcomes))
    return {
        "false_alarms": _of(nulls),
        "false_alarms_upper": Figure(nulls.upper if nulls.trials else np.nan, str(nulls)),
        "sole_right": _beside_chance(_of(_share(plain, sole_right)), plain, bounds),
        "sole_right_soak": _beside_chance(_of(_share(soaked, sole_right)), soaked, bounds),
        "wrong_names": _count(_share(bound, lambda outcome: outcome.misled)),
        "detected_once": _beside_tests(
            _share(once, lambda outcome: outcome.alarmed), once, measured
        ),
        "outside_wrong": _of(_share(outside, lambda outcome: outcome.wrong_sole)),
        "outside_group": _of(_share(outside, right_group)),
        "nearly_wrong": _of(_share(nearly, _nearly_wrong)),
        "recall": _of(recall(many)),
        "precision": _of(precision(many)),
        "rig_recall": _of(recall(rigs)),
        "rig_precision": _of(precision(rigs)),
        "rig_gain": _of(_share(rigs, has_right_gain)),
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


def on_rung(outcome: Outcome, times: float) -> bool:
    """Return whether a case hides one cause of the given number of minimum detectable sizes."""
    return len(outcome.fates) == 1 and abs(outcome.fates[0].times / times - 1.0) <= RUNG_WIDTH


def largest(outcome: Outcome) -> float:
    """Return the largest hidden size of a case, in minimum detectable sizes; 0 for none."""
    return max((fate.times for fate in outcome.fates), default=0.0)


def sole_right(outcome: Outcome) -> bool:
    """Return whether the only hidden cause is the only stated name."""
    (fate,) = outcome.fates
    return fate.sole and len(outcome.sets) == 1


def right_group(outcome: Outcome) -> bool:
    """Return whether an unexplained rest is reported with the true covariate first."""
    return bool(outcome.rest) and outcome.rest[0] in outcome.expected


def recall(many: Sequence[Outcome]) -> Share:
    """Return the share of detectable hidden causes that are in stated sets."""
    seen = [fate for outcome in many for fate in outcome.fates if fate.times >= SEEN]
    return Share(sum(fate.stated for fate in seen), len(seen))


def precision(many: Sequence[Outcome]) -> Share:
    """Return the share of stated sets that contain a hidden cause."""
    sets = sum(len(outcome.sets) for outcome in many)
    return Share(sets - sum(len(outcome.extra) for outcome in many), sets)


def has_right_gain(outcome: Outcome) -> bool:
    """Return whether every stated entry of the gain is near its true value; False for none."""
    return outcome.gain_sigma is not None and outcome.gain_sigma <= RIG_GAIN_SIGMA


def covered_causes(outcomes: Iterable[Outcome]) -> Share:
    """Return the coverage of the intervals of correctly named sizes."""
    each = [
        c for outcome in outcomes if outcome.kind in IN_CATALOGUE for c in outcome.covered_causes
    ]
    return Share(sum(c.inside for c in each), len(each))


def covered_calibration(outcomes: Iterable[Outcome]) -> Share:
    """Return the coverage of the calibration's intervals, after selection."""
    kinds = ("null", *IN_CATALOGUE)
    each = [c for outcome in outcomes if outcome.kind in kinds for c in outcome.covered_calibration]
    return Share(sum(c.inside for c in each), len(each))


def confusion(outcomes: Iterable[Outcome], times: float) -> dict[str, Counter[str]]:
    """Return for each cause hidden alone how often it was given which name."""
    counts: dict[str, Counter[str]] = {}
    for outcome in outcomes:
        if outcome.kind == "one" and on_rung(outcome, times):
            counts.setdefault(outcome.fates[0].cause, Counter())[outcome.fates[0].said] += 1
    return dict(sorted(counts.items()))


def by_cause(outcomes: Iterable[Outcome], times: float) -> dict[str, list[Outcome]]:
    """Return the cases that hide one cause of a size, by cause."""
    groups: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        if outcome.kind == "one" and on_rung(outcome, times):
            groups.setdefault(outcome.fates[0].cause, []).append(outcome)
    return dict(sorted(groups.items()))


def _nearly_wrong(outcome: Outcome) -> bool:
    """A shape similar to a cause can have its name; any other sole name is wrong."""
    return any(is_sole(names) and outcome.near not in names for names in outcome.sets)


def _of_kind(outcomes: Iterable[Outcome], kind: str) -> list[Outcome]:
    return [outcome for outcome in outcomes if outcome.kind == kind]


def _least(times: float) -> float:
    return times * (1.0 - RUNG_WIDTH)


def _share(outcomes: Sequence[Outcome], hit: Callable[[Outcome], bool]) -> Share:
    return Share(sum(hit(outcome) for outcome in outcomes), len(outcomes))


def _of(share: Share) -> Figure:
    return Figure(share.value, str(share))


def _beside_chance(figure: Figure, outcomes: Sequence[Outcome], bounds: Sequence[Bound]) -> Figure:
    """Add the bound on the figure; a case without a bound counts as certain."""
    chance = {bound.seed: bound.chance for bound in bounds}
    each = [chance.get(outcome.seed, 1.0) for outcome in outcomes]
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
    most = 100.0 * borne(measured, [outcome.fates[0].cause for outcome in once])
    return Figure(share.value, f"{share}; separate tests {most:.1f} %")


def _count(share: Share) -> Figure:
    return Figure(float(share.hits) if share.trials else np.nan, str(share))


def _gap(gaps: Sequence[Gap]) -> Figure:
    """Return the median gap to the oracle beyond the allowed cost of estimation."""
    if not gaps:
        return Figure(np.nan, "none measured")
    beyond = [gap.short - gap.allowed for gap in gaps]
    short = float(np.median([gap.short for gap in gaps]))
    allowed = float(np.median([gap.allowed for gap in gaps]))
    words = f"median difference {short:.1f} nats in {len(gaps)} cases, allowed {allowed:.1f}"
    return Figure(float(np.median(beyond)), words)
