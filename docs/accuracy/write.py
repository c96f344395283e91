"""Write the tables of docs/accuracy.md, or check them.

    python docs/accuracy/write.py            write every block
    python docs/accuracy/write.py --check    change nothing; 1 if a block differs

This program measures nothing. `python tests/bench/bench_accuracy.py --out
docs/accuracy/results.json` measures efficiency (half an hour on two free cores), and `python
tests/bench/bench_coverage.py --out docs/accuracy/coverage.json` measures coverage (ten minutes on
one core). `bench_motor_noise.py` measures noise in motion.
"""

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from docs.accuracy import coverage, motor_noise, speed, statistics
from docs.blocks import write_or_check
from docs.markdown import Block

DOCUMENT = Path(__file__).resolve().parents[1] / "accuracy.md"
BLOCKS: dict[str, Block] = {
    **statistics.BLOCKS,
    **coverage.BLOCKS,
    **motor_noise.BLOCKS,
    **speed.BLOCKS,
}


def main() -> int:
    """Write or check the document; return the exit code."""
    parser = argparse.ArgumentParser(description="Write the tables of docs/accuracy.md.")
    parser.add_argument(
        "--check", action="store_true", help="change nothing; exit code 1 if a block differs"
    )
    options = parser.parse_args()
    return write_or_check(DOCUMENT, BLOCKS, options.check, "python docs/accuracy/write.py")


if __name__ == "__main__":
    sys.exit(main())
