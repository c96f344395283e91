"""Put the numbers of the scripts into docs/paper.md, or check that they are there.

    python docs/paper/write.py            write every block that its script can make now
    python docs/paper/write.py --check    change nothing; 1 if a block differs
    python docs/paper/write.py --all      also the end-to-end blocks (a minute; the emulator)

A block of the document stands between `<!-- begin: name -->` and `<!-- end -->`. The name is
that of a function in the BLOCKS of one script here. The document has nothing in a block that
its script did not print.
"""

import argparse
import re
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from docs.paper import (
    check_estimators,
    check_paths,
    check_search,
    check_tables,
    draw_figures,
)
from docs.paper.markdown import Block

DOCUMENT = Path(__file__).resolve().parents[1] / "paper.md"
QUICK: dict[str, Block] = {
    **check_tables.BLOCKS,
    **check_paths.BLOCKS,
    **check_search.BLOCKS,
    **check_estimators.BLOCKS,
    **draw_figures.BLOCKS,
}
BLOCK = re.compile(
    r"(<!-- begin: (?P<name>[a-z0-9-]+) -->\n)(?P<body>.*?)(<!-- end -->)", re.DOTALL
)


def block_names(text: str) -> list[str]:
    """Names of the blocks in a document, in order."""
    return [match["name"] for match in BLOCK.finditer(text)]


def written(text: str, blocks: dict[str, Block]) -> str:
    """The document with each of `blocks` made anew; others stay as they are."""

    def anew(match: re.Match[str]) -> str:
        block = blocks.get(match["name"])
        if block is None:
            return match[0]
        return f"{match[1]}{block()}\n{match[4]}"

    return BLOCK.sub(anew, text)


def main() -> int:
    """Write or check the document; the exit code."""
    parser = argparse.ArgumentParser(description="numbers of docs/paper.md")
    parser.add_argument("--check", action="store_true", help="change nothing, 1 if it differs")
    parser.add_argument("--all", action="store_true", help="the end-to-end blocks too")
    asked = parser.parse_args()
    text = DOCUMENT.read_text(encoding="utf-8")
    blocks = dict(QUICK)
    if asked.all:
        from docs.paper.end_to_end import BLOCKS  # noqa: PLC0415 - needs the whole project

        blocks |= BLOCKS
    new = written(text, blocks)
    if asked.check:
        if new != text:
            print("docs/paper.md differs from its scripts: run python docs/paper/write.py")
        return int(new != text)
    DOCUMENT.write_text(new, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
