"""Make several tiers in turn, with a few sessions of each tier per round.

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

ROUND_SIZE = len(SIZED) + len(COUNTED)  # each cause once; then follow the next rung and the soak


@dataclass(frozen=True, slots=True)
class TierPart:
    """Sessions of one tier."""

    folder: str
    tier: str
    first: int  # seed
    count: int
    sessions_per_round: int
    rungs: tuple[str, ...] = ("1", "2", "3")


PARTS = (
    TierPart("ladder", "ladder", 210_000, 8 * 2 * 2 * ROUND_SIZE, 2 * ROUND_SIZE, ("3", "2")),
    TierPart("ladder", "ladder", 250_000, 8 * 2 * ROUND_SIZE, ROUND_SIZE, ("1",)),
    TierPart("outside", "outside", 500_000, 500, 16),
    TierPart("many", "many", 400_000, 40, 4),
    TierPart("nearly", "nearly", 600_000, 100, 4),
    TierPart("rig", "rig", 800_000, 100, 4),
    TierPart("held", "held", 700_000, 100, 4),
    TierPart("mixed", "mixed", 300_000, 1000, 16),
    TierPart("nulls", "nulls", 10_000, 1000, 60),
)


def main() -> None:
    """Read the command line and make all rounds."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--rounds", type=int, default=50)
    parser.add_argument("--tiers", nargs="+", choices=TIERS, default=list(TIERS))
    parser.add_argument(
        "--a-round", type=int, help="largest number of sessions of a part per round"
    )
    parser.add_argument(
        "--beyond", type=int, default=0, help="number to add to every seed, for new sessions"
    )
    arguments = parser.parse_args()
    for round_number in range(arguments.rounds):
        for part in PARTS:
            sessions_per_round = min(
                part.sessions_per_round, arguments.a_round or part.sessions_per_round
            )
            offset = round_number * sessions_per_round
            if offset < part.count and part.tier in arguments.tiers:
                first = part.first + arguments.beyond
                make.main(
                    ["--out", str(arguments.out / part.folder), "--tier", part.tier,
                     "--base", str(first), "--first", str(first + offset),
                     "--count", str(min(sessions_per_round, part.count - offset)),
                     "--rungs", *part.rungs]
                )  # fmt: skip


if __name__ == "__main__":
    main()
