"""Make several tiers in turn, a few sessions of each a round, so that all grow alike.

Run: python tests/hidden/truth/in_turn.py --out CORPORA --rounds N
"""

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from tests.hidden.truth import make
from tests.hidden.truth.draws import SIZED
from tests.hidden.truth.sizing import COUNTED

ROUND = len(SIZED) + len(COUNTED)  # each cause once; then the next rung, then with soak

# Tier: first seed, sessions in all, sessions a round.
TIERS = {
    "nulls": (10_000, 1000, 50),
    "ladder": (200_000, 8 * 2 * 3 * ROUND, ROUND),
    "mixed": (300_000, 1000, 50),
    "many": (400_000, 40, 2),
}


def main() -> None:
    """Read the command line and go round."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--rounds", type=int, default=50)
    told = parser.parse_args()
    for turn in range(told.rounds):
        for tier, (first, count, many) in TIERS.items():
            at = turn * many
            if at < count:
                make.main(
                    ["--out", str(told.out / tier), "--tier", tier, "--base", str(first),
                     "--first", str(first + at), "--count", str(min(many, count - at))]
                )  # fmt: skip


if __name__ == "__main__":
    main()
