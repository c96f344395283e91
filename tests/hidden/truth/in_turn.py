"""Make several tiers in turn, a few sessions of each a round, so that all grow alike.

Run: python tests/hidden/truth/in_turn.py --out CORPORA --rounds N
"""

import argparse
import os
import sys
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from tests.hidden.truth import make
from tests.hidden.truth.draws import SIZED, TIERS
from tests.hidden.truth.sizing import COUNTED

ROUND = len(SIZED) + len(COUNTED)  # each cause once; then the next rung, then with soak


@dataclass(frozen=True, slots=True)
class Part:
    """Sessions of one tier."""

    folder: str
    tier: str
    first: int  # seed
    count: int
    a_round: int
    rungs: tuple[str, ...] = ("1", "2", "3")


PARTS = (
    Part("ladder", "ladder", 210_000, 8 * 2 * 2 * ROUND, 2 * ROUND, ("3", "2")),
    Part("ladder", "ladder", 250_000, 8 * 2 * ROUND, ROUND, ("1",)),
    Part("outside", "outside", 500_000, 500, 16),
    Part("many", "many", 400_000, 40, 4),
    Part("nearly", "nearly", 600_000, 100, 4),
    Part("rig", "rig", 800_000, 100, 4),
    Part("held", "held", 700_000, 100, 4),
    Part("mixed", "mixed", 300_000, 1000, 16),
    Part("nulls", "nulls", 10_000, 1000, 60),
)


def main() -> None:
    """Read the command line and go round."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--rounds", type=int, default=50)
    parser.add_argument("--tiers", nargs="+", choices=TIERS, default=list(TIERS))
    parser.add_argument("--a-round", type=int, help="at most so many sessions of a part a round")
    parser.add_argument("--beyond", type=int, default=0, help="added to every seed: fresh sessions")
    arguments = parser.parse_args()
    for turn in range(arguments.rounds):
        for part in PARTS:
            a_round = min(part.a_round, arguments.a_round or part.a_round)
            at = turn * a_round
            if at < part.count and part.tier in arguments.tiers:
                first = part.first + arguments.beyond
                make.main(
                    ["--out", str(arguments.out / part.folder), "--tier", part.tier,
                     "--base", str(first), "--first", str(first + at),
                     "--count", str(min(a_round, part.count - at)),
                     "--rungs", *part.rungs]
                )  # fmt: skip


if __name__ == "__main__":
    main()
