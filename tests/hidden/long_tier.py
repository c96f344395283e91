"""Run the long tier: make the sessions, explain them, open the answers, write the page.

A stopped run can continue: the steps do not make or explain an existing session again. The run
takes hours on two cores, and some GB of disk space.

Run: python tests/hidden/long_tier.py --out FOLDER [--workers 2] [--rounds 50] [--a-round N]
"""

import argparse
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
MAKER = HERE / "truth" / "in_turn.py"
RESULTS = HERE.parents[1] / "docs" / "discovery" / "results.json"
PARALLEL_TIERS = (
    ("nulls",),
    ("ladder", "mixed", "many", "rig", "outside", "nearly", "held"),
)  # both need about the same time


def make_corpora(out: Path, rounds: int, a_round: int | None) -> list[str]:
    """Make the missing sessions of the corpora; return their folders."""
    processes = []
    for tiers in PARALLEL_TIERS:
        command = [sys.executable, str(MAKER), "--out", str(out), "--rounds", str(rounds)]
        command += ["--a-round", str(a_round)] if a_round else []
        processes.append(subprocess.Popen([*command, "--tiers", *tiers]))
    codes = [process.wait() for process in processes]
    if any(codes):
        raise SystemExit(f"long tier: a program that makes the sessions failed: exit codes {codes}")
    return [str(out / tier) for tiers in PARALLEL_TIERS for tier in tiers]


def main() -> None:
    """Run all steps."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument(
        "--rounds",
        type=int,
        default=50,
        help="number of rounds; fewer rounds make a smaller corpus",
    )
    parser.add_argument(
        "--a-round", type=int, help="largest number of sessions of a part per round"
    )
    arguments = parser.parse_args()
    corpora = make_corpora(arguments.out, arguments.rounds, arguments.a_round)
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
