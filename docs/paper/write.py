"""Write the tables of docs/paper.md, or check them.

    python docs/paper/write.py            write every block that its script can make now
    python docs/paper/write.py --check    change nothing; 1 if a block differs
    python docs/paper/write.py --all      also the end-to-end blocks (a minute; the emulator)

A block of the document is between `<!-- begin: name -->` and `<!-- end -->`. The name is
a key of BLOCKS in one of the scripts. A block contains only the output of its script.
"""

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from docs.blocks import write_or_check
from docs.markdown import Block
from docs.paper import (
    check_estimators,
    check_paths,
    check_search,
    check_tables,
    draw_figures,
)

DOCUMENT = Path(__file__).resolve().parents[1] / "paper.md"
QUICK: dict[str, Block] = {
    **check_tables.BLOCKS,
    **check_paths.BLOCKS,
    **check_search.BLOCKS,
    **check_estimators.BLOCKS,
    **draw_figures.BLOCKS,
}


def main() -> int:
    """Write or check the document; the exit code."""
    parser = argparse.ArgumentParser(description="numbers of docs/paper.md")
    parser.add_argument("--check", action="store_true", help="change nothing, 1 if it differs")
    parser.add_argument("--all", action="store_true", help="the end-to-end blocks too")
    asked = parser.parse_args()
    blocks = dict(QUICK)
    if asked.all:
        from docs.paper.end_to_end import BLOCKS  # noqa: PLC0415 - needs the whole project

        blocks |= BLOCKS
    return write_or_check(DOCUMENT, blocks, asked.check, "python docs/paper/write.py")


if __name__ == "__main__":
    sys.exit(main())
