"""The long tier, all of it: make the sessions, explain them, open the answers, write the page.

Every step goes on where it was stopped: sessions that are there are not made again, explained
ones not explained again. Hours on two cores; some GB in the folder.

Run: python tests/hidden/long_tier.py --out FOLDER [--workers 2]
"""

import argparse
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
RESULTS = HERE.parents[1] / "docs" / "discovery" / "results.json"
# Tier of tests/hidden/truth/make.py, first seed, how many.
TIERS = (
    ("nulls", 10_000, 1000),
    ("ladder", 20_000, 310),
    ("mixed", 30_000, 300),
    ("outside", 40_000, 100),
    ("many", 50_000, 40),
)


def made(out: Path, workers: int) -> list[Path]:
    """Make what is missing of the corpora, in as many processes; return their folders."""
    folders = []
    for tier, first, count in TIERS:
        folder = out / tier
        order = [str(HERE / "truth" / "make.py"), "--out", str(folder), "--tier", tier]
        order += ["--first", str(first), "--count", str(count)]
        started = [
            subprocess.Popen([sys.executable, *order, "--shard", f"{k}/{workers}"])
            for k in range(1, workers + 1)
        ]
        codes = [one.wait() for one in started]
        if any(codes):
            raise SystemExit(f"long tier: {tier} was not made")
        folders.append(folder)
    return folders


def main() -> None:
    """Go through all steps."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--workers", type=int, default=2)
    told = parser.parse_args()
    corpora = [str(folder) for folder in made(told.out, told.workers)]
    lines = str(told.out / "results.jsonl")
    steps = (
        ["explain_cases.py", *corpora, "--out", lines, "--workers", str(told.workers)],
        ["score_cases.py", *corpora, "--results", lines, "--out", str(RESULTS)],
        ["write_scores.py"],
    )
    for script, *words in steps:
        subprocess.run([sys.executable, str(HERE / script), *words], check=True)


if __name__ == "__main__":
    main()
