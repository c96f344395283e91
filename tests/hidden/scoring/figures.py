"""Figures of a set of judged cases, one per goal.

What to use when: `compute_figures` for the numbers that the goals limit, each with its derivation;
`count_confusions` for the confusion matrix.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from tests.hidden.scoring.goals import (
    DETECTABLE,
    GAP_BEYOND,
    GAP_PER_VALUE,
    GOALS,
    NAMED_TIMES,
    OUTSIDE_TIMES,
    RIG_GAIN_SIGMA,
    RUNG_WIDTH,
    Goal,
)
from tests.hidden.scoring.once import Multiplicity, compute_mean_power
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


def compute_figures(
    outcomes: Sequence[Outcome],
    gaps: Sequence[Gap] = (),
    bounds: Sequence[Bound] = (),
    measured: Sequence[Multiplicity] = (),
) -> dict[str, Figure]:
    """Return the figure of each goal by name; `measured`: effective trials of a search."""
    nulls = _compute_share(_select_kind(outcomes, "null"), lambda outcome: outcome.alarmed)
    rungs = [
        outcome
        for outcome in _select_kind(outcomes, "one")
        if is_on_rung(outcome, 2.0) or is_on_rung(outcome, 3.0)
    ]
    plain = [outcome for outcome in rungs if not outcome.soak]
    soaked = [outcome for outcome in rungs if outcome.soak]
    once = [outcome for outcome in _select_kind(outcomes, "one") if is_on_rung(outcome, 1.0)]
    bound = [
        outcome
        for outcome in outcomes
        if outcome.kind in IN_CATALOGUE
        and find_largest(outcome) >= _compute_least_times(NAMED_TIMES)
    ]
    outside = [
        outcome
        for outcome in _select_kind(outcomes, "outside")
        if find_largest(outcome) >= _compute_least_times(OUTSIDE_TIMES)
    ]
    nearly = [
        outcome
        for outcome in _select_kind(outcomes, "nearly")
        if find_largest(outcome) >= _compute_least_times(OUTSIDE_TIMES)
    ]
    many, rigs = _select_kind(outcomes, "many"), _select_kind(outcomes, "rig")
    harm = Share(sum(outcome.harm_printed for outcome in outcomes), len(outcomes))
    return {
        "false_alarms": _make_figure(nulls),
        "false_alarms_upper": Figure(nulls.upper if nulls.trials else np.nan, str(nulls)),
        "sole_right": _add_bound(_make_figure(_compute_share(plain, is_sole_right)), plain, bounds),
        "sole_right_soak": _add_bound(
            _make_figure(_compute_share(soaked, is_sole_right)), soaked, bounds
        ),
        "wrong_names": _make_count_figure(_compute_share(bound, lambda outcome: outcome.misled)),
        "detected_once": _add_separate_tests(
            _compute_share(once, lambda outcome: outcome.alarmed), once, measured
        ),
        "outside_wrong": _make_figure(_compute_share(outside, lambda outcome: outcome.wrong_sole)),
        "outside_group": _make_figure(_compute_share(outside, has_right_group)),
        "nearly_wrong": _make_figure(_compute_share(nearly, _is_nearly_wrong)),
        "recall": _make_figure(compute_recall(many)),
        "precision": _make_figure(compute_precision(many)),
        "rig_recall": _make_figure(compute_recall(rigs)),
        "rig_precision": _make_figure(compute_precision(rigs)),
        "rig_gain": _make_figure(_compute_share(rigs, has_right_gain)),
        "gap": _make_gap_figure(gaps),
        "covered_causes": _make_figure(compute_cause_coverage(outcomes)),
        "covered_calibration": _make_figure(compute_calibration_coverage(outcomes)),
        "harm_printed": _make_figure(harm),
    }


def find_missed_goals(results: dict[str, Figure], goals: Iterable[Goal] = GOALS) -> list[Goal]:
    """Return the goals that are not met, without those that have no cases."""
    return [
        goal
        for goal in goals
        if not np.isnan(results[goal.name].value) and not goal.is_met(results[goal.name].value)
    ]


def is_on_rung(outcome: Outcome, times: float) -> bool:
    """Return whether a case hides one cause of the given number of minimum detectable sizes."""
    return len(outcome.fates) == 1 and abs(outcome.fates[0].times / times - 1.0) <= RUNG_WIDTH


def find_largest(outcome: Outcome) -> float:
    """Return the largest hidden size of a case, in minimum detectable sizes; 0 for none."""
    return max((fate.times for fate in outcome.fates), default=0.0)


def is_sole_right(outcome: Outcome) -> bool:
    """Return whether the only hidden cause is the only stated name."""
    (fate,) = outcome.fates
    return fate.sole and len(outcome.sets) == 1


def has_right_group(outcome: Outcome) -> bool:
    """Return whether an unexplained rest is reported with the true covariate first."""
    return bool(outcome.rest) and outcome.rest[0] in outcome.expected


def compute_recall(many: Sequence[Outcome]) -> Share:
    """Return the share of detectable hidden causes that are in stated sets."""
    seen = [fate for outcome in many for fate in outcome.fates if fate.times >= DETECTABLE]
    return Share(sum(fate.stated for fate in seen), len(seen))


def compute_precision(many: Sequence[Outcome]) -> Share:
    """Return the share of stated sets that contain a hidden cause."""
    sets = sum(len(outcome.sets) for outcome in many)
    return Share(sets - sum(len(outcome.extra) for outcome in many), sets)


def has_right_gain(outcome: Outcome) -> bool:
    """Return whether the gain is stated and every entry is near its true value."""
    return outcome.gain_sigma is not None and outcome.gain_sigma <= RIG_GAIN_SIGMA


def compute_cause_coverage(outcomes: Iterable[Outcome]) -> Share:
    """Return the coverage of the intervals of correctly named sizes."""
    each = [
        c for outcome in outcomes if outcome.kind in IN_CATALOGUE for c in outcome.covered_causes
    ]
    return Share(sum(c.inside for c in each), len(each))


def compute_calibration_coverage(outcomes: Iterable[Outcome]) -> Share:
    """Return the coverage of the calibration's intervals, after selection."""
    kinds = ("null", *IN_CATALOGUE)
    each = [c for outcome in outcomes if outcome.kind in kinds for c in outcome.covered_calibration]
    return Share(sum(c.inside for c in each), len(each))


def count_confusions(outcomes: Iterable[Outcome], times: float) -> dict[str, Counter[str]]:
    """Return for each cause hidden alone the number of cases per stated name."""
    counts: dict[str, Counter[str]] = {}
    for outcome in outcomes:
        if outcome.kind == "one" and is_on_rung(outcome, times):
            counts.setdefault(outcome.fates[0].cause, Counter())[outcome.fates[0].said] += 1
    return dict(sorted(counts.items()))


def group_by_cause(outcomes: Iterable[Outcome], times: float) -> dict[str, list[Outcome]]:
    """Return the cases that hide one cause of a size, by cause."""
    groups: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        if outcome.kind == "one" and is_on_rung(outcome, times):
            groups.setdefault(outcome.fates[0].cause, []).append(outcome)
    return dict(sorted(groups.items()))


def _is_nearly_wrong(outcome: Outcome) -> bool:
    """Return whether a sole name is wrong; the name of a similar cause is right for a shape."""
    return any(is_sole(names) and outcome.near not in names for names in outcome.sets)


def _select_kind(outcomes: Iterable[Outcome], kind: str) -> list[Outcome]:
    return [outcome for outcome in outcomes if outcome.kind == kind]


def _compute_least_times(times: float) -> float:
    return times * (1.0 - RUNG_WIDTH)


def _compute_share(outcomes: Sequence[Outcome], hit: Callable[[Outcome], bool]) -> Share:
    return Share(sum(hit(outcome) for outcome in outcomes), len(outcomes))


def _make_figure(share: Share) -> Figure:
    return Figure(share.value, str(share))


def _add_bound(figure: Figure, outcomes: Sequence[Outcome], bounds: Sequence[Bound]) -> Figure:
    """Add the bound on the figure; a case without a bound counts as certain."""
    chance = {bound.seed: bound.chance for bound in bounds}
    each = [chance.get(outcome.seed, 1.0) for outcome in outcomes]
    if not each or not chance:
        return figure
    most = 100.0 * sum(each) / len(each)
    return Figure(figure.value, f"{figure.words}; upper bound {most:.1f} %")


def _add_separate_tests(
    share: Share, once: Sequence[Outcome], measured: Sequence[Multiplicity]
) -> Figure:
    """Add the power of the separate tests of the causes, at the search's number of trials."""
    if not once or not measured:
        return _make_figure(share)
    most = 100.0 * compute_mean_power(measured, [outcome.fates[0].cause for outcome in once])
    return Figure(share.value, f"{share}; separate tests {most:.1f} %")


def _make_count_figure(share: Share) -> Figure:
    return Figure(float(share.hits) if share.trials else np.nan, str(share))


def _make_gap_figure(gaps: Sequence[Gap]) -> Figure:
    """Return the median gap to the oracle beyond the allowed cost of estimation."""
    if not gaps:
        return Figure(np.nan, "none measured")
    beyond = [gap.short - gap.allowed for gap in gaps]
    short = float(np.median([gap.short for gap in gaps]))
    allowed = float(np.median([gap.allowed for gap in gaps]))
    words = f"median difference {short:.1f} nats in {len(gaps)} cases, allowed {allowed:.1f}"
    return Figure(float(np.median(beyond)), words)
