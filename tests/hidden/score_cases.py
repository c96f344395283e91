"""Open the answers of explained cases, judge each case, and store the results for the page.

No earlier program opens the answers. Each answer must match the seal in the line of its case.

Run: python tests/hidden/score_cases.py CORPUS... --results RESULTS.jsonl... [--out scores.json]
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.hidden.explain_cases import bounds_path, gaps_path, read_rows
from tests.hidden.scoring.answers import list_cases, open_answer
from tests.hidden.scoring.figures import Gap, compute_figures, find_missed_goals
from tests.hidden.scoring.goals import GOALS
from tests.hidden.scoring.kept import JudgedCases, write_judged_cases
from tests.hidden.scoring.outcome import Outcome, judge_case
from tests.hidden.scoring.possible import Bound


def judge_cases(corpora: Sequence[Path], results: Sequence[Path]) -> JudgedCases:
    """Return the outcome of every explained case.

    Args:
        corpora: folders of cases.
        results: files of lines; a seed is in one corpus only.

    Raises:
        SealError: an answer does not match the seal in the line of its case.
    """
    lines = {seed: line for path in results for seed, line in read_rows(path).items()}
    outcomes: list[Outcome] = []
    for corpus in corpora:
        for case in list_cases(corpus):
            line = lines.get(int(case.name))
            if line is not None:
                outcomes.append(judge_case(open_answer(case, line["seal"]), line))
    seeds = {outcome.seed for outcome in outcomes}
    gaps = [
        Gap(seed, row["nats"], row["short"], row["values"])
        for path in results
        for seed, row in read_rows(gaps_path(path)).items()
        if seed in seeds
    ]
    bounds = [
        Bound(**row)
        for path in results
        for seed, row in read_rows(bounds_path(path)).items()
        if seed in seeds
    ]
    return JudgedCases(
        sorted(outcomes, key=lambda outcome: outcome.seed),
        sorted(gaps, key=lambda gap: gap.seed),
        sorted(bounds, key=lambda bound: bound.seed),
    )


def make_summary(judged_cases: JudgedCases) -> str:
    """Return the figures with their goals, and the cases with a wrong result, for a terminal."""
    results = compute_figures(judged_cases.outcomes, judged_cases.gaps, judged_cases.bounds)
    failed = {goal.name for goal in find_missed_goals(results)}
    lines = [
        f"{goal.number:2d} {goal.words}: {results[goal.name].words} "
        f"{'MISSED' if goal.name in failed else ''}"
        for goal in GOALS
    ]
    return "\n".join(
        [
            *lines,
            "",
            *(_describe_fault(outcome) for outcome in judged_cases.outcomes if _is_faulty(outcome)),
        ]
    )


def _is_faulty(outcome: Outcome) -> bool:
    """Return whether the result of a case is wrong or incomplete."""
    if outcome.kind in ("null", "unobservable"):
        return outcome.alarmed
    is_large = all(fate.times >= 1.9 for fate in outcome.fates)
    if outcome.kind in ("outside", "nearly"):
        return is_large and (outcome.wrong_sole or not outcome.rest)
    return bool(outcome.extra) or (is_large and not all(fate.sole for fate in outcome.fates))


def _describe_fault(outcome: Outcome) -> str:
    hidden = ", ".join(f"{f.cause}@{f.place} {f.times:.1f}x: {f.said}" for f in outcome.fates)
    sets = "; ".join("|".join(names) for names in outcome.sets)
    rest = f", rest {', '.join(outcome.rest)}" if outcome.rest else ""
    soak = " soak" if outcome.soak else ""
    return (
        f"{outcome.seed} {outcome.kind} {outcome.program}{soak}: "
        f"hidden [{hidden}] stated [{sets}]{rest}"
    )


def main() -> None:
    """Judge the cases, print the summary, and store the outcomes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("corpus", type=Path, nargs="+")
    parser.add_argument("--results", type=Path, nargs="+", required=True)
    parser.add_argument("--out", type=Path, help="store the outcomes in this file")
    arguments = parser.parse_args()
    judged_cases = judge_cases(arguments.corpus, arguments.results)
    sys.stdout.write(make_summary(judged_cases) + "\n")
    if arguments.out is not None:
        write_judged_cases(arguments.out, judged_cases)


if __name__ == "__main__":
    main()
