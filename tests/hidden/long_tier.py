"""The long tier, all of it: make the sessions, explain them, open the answers, write the page.

Every step goes on where it was stopped: sessions that are there are not made again, explained
ones not explained again. Hours on two cores; some GB in the folder.

Run: python tests/hidden/long_tier.py --out FOLDER [--workers 2] [--rounds 50] [--a-round N]
"""

import argparse
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
MAKER = HERE / "truth" / "in_turn.py"
RESULTS = HERE.parents[1] / "docs" / "discovery" / "results.json"
SIDE_BY_SIDE = (
    ("nulls",),
    ("ladder", "mixed", "many", "rig", "outside", "nearly", "held"),
)  # about as long to make


def make(out: Path, rounds: int, a_round: int | None) -> list[str]:
    """Make what is missing of the corpora; return their folders."""
    started = []
    for tiers in SIDE_BY_SIDE:
        order = [sys.executable, str(MAKER), "--out", str(out), "--rounds", str(rounds)]
        order += ["--a-round", str(a_round)] if a_round else []
        started.append(subprocess.Popen([*order, "--tiers", *tiers]))
    codes = [process.wait() for process in started]
    if any(codes):
        raise SystemExit(f"long tier: the sessions were not made: {codes}")
    return [str(out / tier) for tiers in SIDE_BY_SIDE for tier in tiers]


def main() -> None:
    """Go through all steps."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=50, help="fewer make a smaller corpus")
    parser.add_argument("--a-round", type=int, help="at most so many sessions of a part a round")
    arguments = parser.parse_args()
    corpora = make(arguments.out, arguments.rounds, arguments.a_round)
    lines = str(arguments.out / "results.jsonl")
    steps = (
        ["explain_cases.py", *corpora, "--out", lines, "--workers", str(arguments.workers)],
        ["score_cases.py", *corpora, "--results", lines, "--out", str(RESULTS)],
        ["write_scores.py"],
    )
    for script, *words in steps:
        subprocess.run([sys.executable, str(HERE / script), *words], check=True)


if __name__ == "__main__":
    main()
