"""Open the answers of explained cases, judge each, and keep what the page is made of.

The answers are opened here and nowhere before; each must be the one whose seal was in the
case's line when the finder had its say.

Run: python tests/hidden/score_cases.py CORPUS... --results RESULTS.jsonl... [--out scores.json]
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.hidden.explain_cases import bounds_path, held_path, results_of
from tests.hidden.scoring.answers import cases, opened
from tests.hidden.scoring.figures import Gap, figures, missed
from tests.hidden.scoring.goals import GOALS
from tests.hidden.scoring.kept import JudgedCases, write_judged_cases
from tests.hidden.scoring.outcome import Outcome, outcome_of
from tests.hidden.scoring.possible import Bound


def judged(corpora: Sequence[Path], results: Sequence[Path]) -> JudgedCases:
    """Return the outcome of every case that was explained.

    Args:
        corpora: folders of cases.
        results: files of lines; no seed is in two corpora.

    Raises:
        SealError: an answer is not the one that was sealed when the finder had its say.
    """
    lines = {seed: line for path in results for seed, line in results_of(path).items()}
    outcomes: list[Outcome] = []
    for corpus in corpora:
        for case in cases(corpus):
            line = lines.get(int(case.name))
            if line is not None:
                outcomes.append(outcome_of(opened(case, line["seal"]), line))
    seeds = {outcome.seed for outcome in outcomes}
    gaps = [
        Gap(seed, row["nats"], row["short"], row["values"])
        for path in results
        for seed, row in results_of(held_path(path)).items()
        if seed in seeds
    ]
    bounds = [
        Bound(**row)
        for path in results
        for seed, row in results_of(bounds_path(path)).items()
        if seed in seeds
    ]
    return JudgedCases(
        sorted(outcomes, key=lambda outcome: outcome.seed),
        sorted(gaps, key=lambda gap: gap.seed),
        sorted(bounds, key=lambda bound: bound.seed),
    )


def summary_text(judged_cases: JudgedCases) -> str:
    """Return the figures beside their goals, and what went wrong in which case, for a terminal."""
    results = figures(judged_cases.outcomes, judged_cases.gaps, judged_cases.bounds)
    failed = {goal.name for goal in missed(results)}
    lines = [
        f"{goal.number:2d} {goal.words}: {results[goal.name].words} "
        f"{'MISSED' if goal.name in failed else ''}"
        for goal in GOALS
    ]
    return "\n".join(
        [*lines, "", *(_fault(outcome) for outcome in judged_cases.outcomes if _faulty(outcome))]
    )


def _faulty(outcome: Outcome) -> bool:
    """Return whether somebody should look at a case."""
    if outcome.kind in ("null", "unobservable"):
        return outcome.alarmed
    large = all(fate.times >= 1.9 for fate in outcome.fates)
    if outcome.kind in ("outside", "nearly"):
        return large and (outcome.wrong_sole or not outcome.rest)
    return bool(outcome.extra) or (large and not all(fate.sole for fate in outcome.fates))


def _fault(outcome: Outcome) -> str:
    true = ", ".join(f"{f.cause}@{f.place} {f.times:.1f}x: {f.said}" for f in outcome.fates)
    sets = "; ".join("|".join(names) for names in outcome.sets)
    rest = f", rest {', '.join(outcome.rest)}" if outcome.rest else ""
    soak = " soak" if outcome.soak else ""
    return (
        f"{outcome.seed} {outcome.kind} {outcome.program}{soak}: hid [{true}] said [{sets}]{rest}"
    )


def main() -> None:
    """Judge, say, and keep."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("corpus", type=Path, nargs="+")
    parser.add_argument("--results", type=Path, nargs="+", required=True)
    parser.add_argument("--out", type=Path, help="keep the outcomes here")
    arguments = parser.parse_args()
    judged_cases = judged(arguments.corpus, arguments.results)
    sys.stdout.write(summary_text(judged_cases) + "\n")
    if arguments.out is not None:
        write_judged_cases(arguments.out, judged_cases)


if __name__ == "__main__":
    main()
