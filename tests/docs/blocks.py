"""Read the code blocks of the pages, and how the test treats each block.

What to use when: `pages` lists the pages with instructions, `blocks` yields the blocks of one
page. A block is the text between ```sh and ```, or between ```python and ```. Marks before a
block set how the test treats it:

    <!-- test: look: elsewhere -->   do not run it; the reason is one of `REASONS`
    <!-- test: serve rig/sock -->    run it until the page ends; continue when this path exists
                                     (or HOST:PORT answers); it must exit with 0 after SIGTERM
    <!-- test: save table.yaml -->   save it in this file (```yaml blocks too)
    <!-- test: in clone -->          run it in one of `PLACES`; without a mark, an empty folder
    <!-- test: after COMMAND -->     run this command first; several commands run in their order
    <!-- test: output -->            before a ```text block: the output of the block above it
    <!-- test: output within 9 -->   its numbers may differ by 9 units of their last digits

tests/unit/output/test_docs.py looks up all commands in the help of the programs.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
_MARK = r"<!-- test: (.*?) -->\n"
_BLOCK = re.compile(
    rf"(?P<marks>(?:^{_MARK})*)^```(?P<kind>[\w-]*)[^\n]*\n(?P<body>.*?)^```",
    re.MULTILINE | re.DOTALL,
)
_OUTPUT_MARK = re.compile(r"output(?: within (?P<last_digits>[1-9]\d?))?")
# Command lines in a block that the test does not run
_COMMAND_LINE = re.compile(
    r"^(\$ )?(sudo )?(gyrorigd?|make|pip|python3?|git|openssl|dask|ssh|systemctl) [-\w]",
    re.MULTILINE,
)
REASONS = {
    "bench": "takes minutes; tests/unit/fleet/test_synthetic_fleet does less of it",
    "ci": "takes minutes, and .ci/run runs it first in a fresh clone",
    "data": "needs measured data that are not available",
    "elsewhere": "for another computer",
    "packages": "tests/packages does the same with the wheel of this checkout",
}
PLACES = {
    "bucket": "a separate network in which https://objects.example serves a bucket",
    "clone": "a fresh clone of this checkout, without its virtual environment",
    "rig": "a container with an emulated rig on the ports of config/rig-raspberrypi.yaml, as root",
    "wheel": "a virtual environment into which a page can install the wheel",
}
TREATMENTS = ("run", "look", "serve", "save")
# Decisions describe earlier versions. `make test-pages` runs the commands of the page of measured
# data and generates the page; some of these commands must fail.
SKIPPED_PAGES = ("decisions", "measured-data.md")


class DocumentError(Exception):
    """A mark of a page is invalid, or a command of the page fails."""


@dataclass(frozen=True, slots=True)
class Block:
    """Lines that the reader of a page runs or saves."""

    page: Path
    line: int
    kind: str
    body: str
    how: str = "run"
    detail: str = ""  # the reason, the path, or the name
    place: str = ""  # "" is an empty folder
    before: tuple[str, ...] = ()  # commands that run first
    output: str | None = None  # the output of the commands according to the page
    last_digits: int = 1  # by which a number of the output may differ

    @property
    def where(self) -> str:
        """Return the page and the line for an error message."""
        return f"{self.page.name}:{self.line}"

    @property
    def count(self) -> int:
        """Return the number of commands."""
        if self.how == "save" or self.kind == "yaml":
            return 0
        if self.kind == "python":
            return 1
        return sum(bool(line.strip()) for line in self.body.splitlines())


def blocks(page: Path) -> Iterator[Block]:
    """Yield the blocks of a page in order, without data that the reader does not save.

    Raises:
        DocumentError: a mark is invalid, or a block contains commands but is not an ```sh block.
    """
    text = page.read_text(encoding="utf-8")
    pending: Block | None = None
    for match in _BLOCK.finditer(text):
        line = text.count("\n", 0, match.start("body")) + 1
        marks = re.findall(_MARK, match["marks"])
        if len(marks) == 1 and (permitted := _OUTPUT_MARK.fullmatch(marks[0])):
            if pending is None or pending.kind != "sh" or pending.output is not None:
                raise DocumentError(f"{page.name}:{line}: output follows a block of commands")
            last_digits = int(permitted["last_digits"] or 1)
            pending = replace(pending, output=match["body"], last_digits=last_digits)
            continue
        if pending is not None:
            yield pending
            pending = None
        block = _parse_block(page, line, match["kind"], match["body"], marks)
        if block.kind in ("sh", "python") or block.how == "save":
            pending = block
        elif block.kind != "yaml" and _COMMAND_LINE.search(block.body):
            raise DocumentError(f"{block.where}: commands must be in a block ```sh")
    if pending is not None:
        yield pending


def _parse_block(page: Path, line: int, kind: str, body: str, marks: list[str]) -> Block:
    where = f"{page.name}:{line}"
    how, detail, place = "run", "", ""
    before: list[str] = []
    for mark in marks:
        head, _, rest = mark.partition(" ")
        head = head.rstrip(":")
        if head == "after":
            before.append(rest)
        elif head == "in":
            place = rest
        elif head in TREATMENTS and rest:
            how, detail = head, rest
        else:
            raise DocumentError(f"{where}: unknown mark {mark!r}")
    if how == "look" and detail not in REASONS:
        raise DocumentError(f"{where}: look {detail!r}: use one of {', '.join(REASONS)}")
    if place and place not in PLACES:
        raise DocumentError(f"{where}: in {place!r}: use one of {', '.join(PLACES)}")
    return Block(page, line, kind, body, how, detail, place, tuple(before))


def pages() -> list[Path]:
    """Return the pages with instructions."""
    paths = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
    paths += [ROOT / "systemd" / "README.md"]
    return [page for page in paths if not set(page.parts) & set(SKIPPED_PAGES)]
