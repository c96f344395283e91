"""Tables of docs/discovery-scores.md, from judged cases.

What to use when: one function per block of docs/discovery-scores.md.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np
from docs.markdown import table
from tests.hidden.scoring.figures import (
    IN_CATALOGUE,
    Gap,
    compute_figures,
    compute_precision,
    compute_recall,
    find_largest,
    find_missed_goals,
    group_by_cause,
    has_right_group,
    is_on_rung,
    is_sole_right,
)
from tests.hidden.scoring.goals import GOALS, HIDDEN, NAMED_TIMES, NULLS, RUNG_WIDTH, RUNGS, Goal
from tests.hidden.scoring.once import Multiplicity
from tests.hidden.scoring.outcome import AMONG, Outcome, is_sole
from tests.hidden.scoring.possible import Bound, compute_largest_share
from tests.hidden.scoring.shares import Share

KINDS = ("null", "one", "two", "many", "rig", "outside", "nearly", "unobservable")
Outcomes = Sequence[Outcome]
K = TypeVar("K")
T = TypeVar("T")
DOUBTFUL = 0.9  # probability below which a cause is listed with its rival


def cases(outcomes: Outcomes) -> str:
    """Return the number of cases per kind and program."""
    rows = []
    for kind in KINDS:
        chosen = [outcome for outcome in outcomes if outcome.kind == kind]
        programs = ", ".join(
            f"`{p}` {n}" for p, n in sorted(Counter(o.program for o in chosen).items())
        )
        soaked, decoys = sum(o.soak for o in chosen), sum(o.decoy is not None for o in chosen)
        rows.append((kind, str(len(chosen)), programs, str(soaked), str(decoys)))
    return table(
        (
            "kind",
            "sessions",
            "motion programs and their sessions",
            "sessions with a soak",
            "sessions with a decoy",
        ),
        rows,
    )


def session_counts(outcomes: Outcomes) -> str:
    """Return the number of sessions in the run, compared with the planned number."""
    null_count = sum(outcome.kind == "null" for outcome in outcomes)
    other_count = len(outcomes) - null_count
    lines = [
        f"- The test ran {count} of {planned} planned sessions {kind}"
        + ("." if count >= planned else ", so the confidence limits are wider than planned.")
        for kind, count, planned in (
            ("without a hidden cause", null_count, NULLS),
            ("with a hidden effect", other_count, HIDDEN),
        )
    ]
    return "\n".join(lines)


def goals(
    outcomes: Outcomes,
    gaps: Sequence[Gap],
    bounds: Sequence[Bound] = (),
    measured: Sequence[Multiplicity] = (),
) -> str:
    """Return every goal with its figure."""
    results = compute_figures(outcomes, gaps, bounds, measured)
    failed = {(goal.number, goal.name) for goal in find_missed_goals(results)}
    rows = []
    for goal in GOALS:
        figure = results[goal.name]
        verdict = "missed" if (goal.number, goal.name) in failed else "met"
        if np.isnan(figure.value):
            verdict = "not measured"
        value = _format_value(goal, figure.value)
        rows.append(
            (str(goal.number), goal.words, format_limit(goal), value, figure.words, verdict)
        )
    return table(("no.", "goal", "limit", "result", "derivation of the result", "verdict"), rows)


def format_limit(goal: Goal) -> str:
    """Return the limit of a goal."""
    low, high = (None if v is None else _format_value(goal, v) for v in (goal.low, goal.high))
    if low is not None and high is not None:
        return f"{low} to {high}"
    return f"≥ {low}" if low is not None else f"≤ {high}"


def _format_value(goal: Goal, value: float) -> str:
    if np.isnan(value):
        return ""
    if goal.name == "gap":
        return f"{value:+.1f} nats" if value else "0 nats"
    return f"{value:.0f}" if goal.name == "wrong_names" else f"{100.0 * value:.4g} %"


def false_alarms(outcomes: Outcomes) -> str:
    """Return the false alarms by program, and their names."""
    chosen = [outcome for outcome in outcomes if outcome.kind == "null"]
    rows = []
    for program, group in _group(chosen, lambda outcome: outcome.program):
        alarms = [outcome for outcome in group if outcome.alarmed]
        names = Counter(_format_names(outcome) for outcome in alarms)
        words = "; ".join(f"{text} ({n})" for text, n in names.most_common())
        rows.append((f"`{program}`", str(Share(len(alarms), len(group))), words))
    return table(("program", "sessions with a false alarm", "reported causes"), rows)


def causes(outcomes: Outcomes) -> str:
    """Return the result for each cause hidden alone, at each size."""
    plain = [outcome for outcome in outcomes if not outcome.soak]
    soaked = [outcome for outcome in outcomes if outcome.soak]
    at = {rung: group_by_cause(plain, rung) for rung in RUNGS}
    soak = [o for o in soaked if o.kind == "one" and (is_on_rung(o, 2.0) or is_on_rung(o, 3.0))]
    names = sorted({name for counts in at.values() for name in counts})
    rows = []
    for name in names:
        once = at[1.0].get(name, [])
        cells = [f"{sum(outcome.alarmed for outcome in once)} of {len(once)}"]
        for rung in RUNGS[1:]:
            cells.append(_format_fates(at[rung].get(name, [])))
        cells.append(_format_fates([outcome for outcome in soak if outcome.fates[0].cause == name]))
        rows.append((f"`{name}`", *cells))
    head = (
        "cause",
        "detected at 1x",
        "sole right name at 2x",
        "sole right name at 3x",
        "sole right name at 2x and 3x, with a soak",
    )
    return table(head, rows)


def _format_fates(group: Outcomes) -> str:
    """Return how often the name was right and alone, and the other results."""
    if not group:
        return ""
    right = sum(is_sole_right(outcome) for outcome in group)
    other = Counter(_describe_result(outcome) for outcome in group if not is_sole_right(outcome))
    words = ", ".join(f"{n} {text}" for text, n in other.most_common())
    return f"{right} of {len(group)}" + (f"; {words}" if words else "")


def _describe_result(outcome: Outcome) -> str:
    (fate,) = outcome.fates
    if fate.sole:
        return "with an additional wrong name"
    if fate.said == AMONG:
        return "in a set"
    return fate.said


def wrong_names(outcomes: Outcomes) -> str:
    """Return every case at 2x or more with a stated set that contains no hidden cause."""
    rows = [
        (
            str(outcome.seed),
            f"`{outcome.program}`" + (" with soak" if outcome.soak else ""),
            ", ".join(f"{fate.cause} {fate.times:.1f}x" for fate in outcome.fates),
            "; ".join(" or ".join(names) for names in outcome.extra),
            "yes" if outcome.misled else "no",
        )
        for outcome in outcomes
        if outcome.kind in IN_CATALOGUE
        and find_largest(outcome) >= NAMED_TIMES * (1.0 - RUNG_WIDTH)
        and outcome.extra
    ]
    if not rows:
        return "None."
    return table(
        ("seed", "program", "hidden causes", "stated but not hidden", "true cause not stated"), rows
    )


def inseparable(bounds: Sequence[Bound]) -> str:
    """Return the causes with a similar rival, and the bound on right names."""
    rows = []
    for cause, group in _group(bounds, lambda bound: bound.cause):
        at_two = [bound.chance for bound in group if bound.times > 1.5]  # goals begin at 2x
        if not at_two or min(at_two) >= DOUBTFUL:
            continue
        cells = []
        for rung, soak in ((2.0, False), (3.0, False), (2.0, True), (3.0, True)):
            chosen = [
                o for o in group if abs(o.times / rung - 1.0) <= RUNG_WIDTH and o.soak == soak
            ]
            cells.append(f"{100.0 * compute_largest_share(chosen):.0f} %" if chosen else "")
        rivals = Counter(bound.rival for bound in group).most_common(2)
        left = np.median([bound.left for bound in group])
        names = ", ".join(f"`{name}`" for name, _ in rivals)
        rows.append((f"`{cause}`", names, f"{100.0 * left:.1f} %", *cells))
    if not rows:
        return "None." if bounds else "Not measured."
    head = (
        "cause",
        "best rival",
        "residual of the rival",
        "2x",
        "3x",
        "2x with a soak",
        "3x with a soak",
    )
    return table(head, rows)


def shapes(outcomes: Outcomes) -> str:
    """Return the results for shapes outside the catalogue or similar to a cause."""
    rows = []
    chosen = [outcome for outcome in outcomes if outcome.kind in ("outside", "nearly")]
    for (kind, name), group in _group(chosen, lambda o: (o.kind, _format_shapes(o))):
        wrong = sum(
            any(is_sole(names) and outcome.near not in names for names in outcome.sets)
            for outcome in group
        )
        rows.append(
            (
                kind,
                name,
                str(len(group)),
                f"{min(map(find_largest, group)):.1f} to {max(map(find_largest, group)):.1f}",
                str(sum(bool(outcome.rest) for outcome in group)),
                str(sum(has_right_group(outcome) for outcome in group)),
                str(wrong),
            )
        )
    head = (
        "kind",
        "shape",
        "sessions",
        "size in detectable sizes",
        "unexplained residual reported",
        "right covariate",
        "wrong name",
    )
    return table(head, rows)


def _format_shapes(outcome: Outcome) -> str:
    return ", ".join(fate.cause.partition(":")[2] or fate.cause for fate in outcome.fates)


def unobservable(outcomes: Outcomes) -> str:
    """Return the results for unobservable causes and inseparable pairs."""
    hidden = [outcome for outcome in outcomes if outcome.kind == "unobservable"]
    silent = Share(sum(not outcome.alarmed for outcome in hidden), len(hidden))
    stated_share = Share(sum(outcome.said_blind for outcome in hidden), len(hidden))
    pairs = [outcome for outcome in outcomes if outcome.decoy == "pair"]
    right = [
        outcome
        for outcome in pairs
        if all(fate.stated for fate in outcome.fates)
        and all(
            set(names) <= {*outcome.allowed, *(f.cause for f in outcome.fates)}
            for names in outcome.sets
        )
    ]
    decoys = [outcome for outcome in outcomes if outcome.decoy in ("temperature", "idle_channel")]
    rows = [
        ("a hidden cause is unobservable: nothing is named", str(silent)),
        ("a hidden cause is unobservable: it is reported as not testable", str(stated_share)),
        ("two causes that the solver cannot separate: both are stated, and nothing else",
         str(Share(len(right), len(pairs)))),
        ("a decoy in the session: no wrong name",
         str(Share(sum(not outcome.extra for outcome in decoys), len(decoys)))),
    ]  # fmt: skip
    return table(("test", "share of right results"), rows)


def several_causes(outcomes: Outcomes) -> str:
    """Return the results for several causes at once."""
    rows = []
    chosen = [outcome for outcome in outcomes if outcome.kind in ("two", "many")]
    for count, group in _group(chosen, lambda outcome: len(outcome.fates)):
        recall, precision = compute_recall(group), compute_precision(group)
        rest = Share(sum(bool(outcome.rest) for outcome in group), len(group))
        rows.append((str(count), str(len(group)), str(recall), str(precision), str(rest)))
    head = (
        "hidden causes",
        "sessions",
        "recall of detectable causes",
        "precision of stated sets",
        "unexplained residual reported",
    )
    return table(head, rows)


def oracle_gaps(gaps: Sequence[Gap]) -> str:
    """Return the gap to the oracle on second recordings."""
    if not gaps:
        return "None measured."
    short = np.array([gap.short for gap in gaps])
    share = np.array([1.0 - gap.short / gap.nats for gap in gaps if gap.nats > 0.0])
    allowed = np.array([gap.allowed for gap in gaps])
    quarters = ", ".join(f"{v:.1f}" for v in np.percentile(short, (25, 50, 75)))
    rows = [
        ("number of second recordings", str(len(gaps))),
        ("difference from the oracle in nats: lower quartile, median, upper quartile", quarters),
        ("allowed difference p/2 + 1 in nats: median", f"{np.median(allowed):.1f}"),
        ("share of the oracle's gain: median, minimum",
         f"{100 * np.median(share):.2f} %, {100 * share.min():.1f} %"),
    ]  # fmt: skip
    return table(("quantity", "result"), rows)


def coverage(outcomes: Outcomes) -> str:
    """Return the coverage by calibration parameter and by cause."""
    kinds = ("null", *IN_CATALOGUE)
    chosen = [outcome for outcome in outcomes if outcome.kind in kinds]
    each = [(c.what, c) for outcome in chosen for c in outcome.covered_calibration]
    each += [(c.what.partition(".")[0], c) for outcome in chosen for c in outcome.covered_causes]
    rows = []
    for what in dict.fromkeys(name for name, _ in each):
        inside = [c for name, c in each if name == what]
        spread = float(np.median(np.abs([c.sigma for c in inside]))) / 0.6745
        rows.append(
            (f"`{what}`", str(Share(sum(c.inside for c in inside), len(inside))), f"{spread:.2f}")
        )
    return table(
        (
            "parameter or cause",
            "coverage of 95 % intervals",
            "spread of the errors, standard uncertainties",
        ),
        rows,
    )


def harm(outcomes: Outcomes) -> str:
    """Return the cause with the largest bias at its detectable size, by program."""
    chosen = [
        outcome for outcome in outcomes if outcome.kind == "null" and outcome.harm is not None
    ]
    rows = []
    for program, group in _group(chosen, lambda outcome: outcome.program):
        worst = [outcome.harm for outcome in group if outcome.harm is not None]
        top, sigma = max(worst, key=lambda entry: entry[1])
        names = Counter(name for name, _ in worst).most_common(2)
        printed = Share(sum(outcome.harm_printed for outcome in group), len(group))
        rows.append(
            (
                f"`{program}`",
                ", ".join(f"{name} ({n})" for name, n in names),
                f"{np.median([value for _, value in worst]):.0f}",
                f"{sigma:.0f}, {top}",
                str(printed),
            )
        )
    head = (
        "program",
        "cause with the largest bias",
        "median bias, standard uncertainties",
        "largest bias, its cause",
        "sessions that report it",
    )
    return table(head, rows)


def durations(outcomes: Outcomes) -> str:
    """Return the duration of an explanation, with both cores busy."""
    rows = []
    for (kind, program), group in _group(outcomes, lambda outcome: (outcome.kind, outcome.program)):
        all_s = [outcome.seconds for outcome in group]
        rows.append(
            (kind, f"`{program}`", str(len(all_s)), f"{np.median(all_s):.1f}", f"{max(all_s):.1f}")
        )
    return table(("kind", "program", "sessions", "median, s", "longest, s"), rows)


def _format_names(outcome: Outcome) -> str:
    names = " + ".join(" or ".join(names) for names in outcome.sets)
    return names or f"unexplained: {outcome.rest[0]}"


def _group(outcomes: Sequence[T], key: Callable[[T], K]) -> list[tuple[K, list[T]]]:
    groups: dict[K, list[T]] = {}
    for outcome in outcomes:
        groups.setdefault(key(outcome), []).append(outcome)
    return sorted(groups.items(), key=lambda pair: str(pair[0]))
