"""The blocks of the pages, and how each is to be taken.

What to use when: `pages` lists what somebody may follow, `blocks` what one page asks for. A block
is what stands between ```sh and ```, or ```python and ```. Lines before it may say how it is
taken:

    <!-- test: look: elsewhere -->   only looked up, because of one of `REASONS`
    <!-- test: serve rig/sock -->    goes on until the page ends, begun when that path is there
                                     (or HOST:PORT answers); told to end it has to leave with 0
    <!-- test: save table.yaml -->   the reader saves it (```yaml blocks too)
    <!-- test: in clone -->          where it is run, one of `PLACES`; else an empty folder
    <!-- test: after COMMAND -->     what the page takes for done; several in their order
    <!-- test: output -->            before a ```text block: what the block above it prints

tests/unit/output/test_docs.py looks up all commands.
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
# Lines that a reader would type, in a block that nobody runs
_TYPED = re.compile(
    r"^(\$ )?(sudo )?(gyrorigd?|make|pip|python3?|git|openssl|dask|ssh|systemctl) [-\w]",
    re.MULTILINE,
)
REASONS = {
    "bench": "takes minutes; tests/unit/fleet/test_synthetic_fleet does less of it",
    "ci": "takes minutes, and .ci/run begins with it in a fresh clone",
    "data": "measured data that are not here",
    "elsewhere": "another computer",
    "packages": "tests/packages does the same with the wheel of this checkout",
}
PLACES = {
    "bucket": "a network of its own, in which https://objects.example has a bucket",
    "clone": "a fresh clone of this checkout, without its virtual environment",
    "rig": "a container with an emulated rig on the ports of config/rig-raspberrypi.yaml, as root",
    "wheel": "a virtual environment to which the wheel can be installed",
}
HOWS = ("run", "look", "serve", "save")
# Decisions say what was. The page of measured data is made anew, commands and all, by
# `make test-pages`; some of its commands are there to be refused.
PASSED_OVER = ("decisions", "measured-data.md")


class DocumentError(Exception):
    """A page says something that cannot be carried out, or that fails."""


@dataclass(frozen=True, slots=True)
class Block:
    """Lines that a page asks its reader to run or to save."""

    page: Path
    line: int
    kind: str
    body: str
    how: str = "run"
    detail: str = ""  # the reason, the path, or the name
    place: str = ""  # "" is an empty folder
    before: tuple[str, ...] = ()  # commands
    output: str | None = None  # what the page says that the commands print

    @property
    def where(self) -> str:
        """Page and line, for an error."""
        return f"{self.page.name}:{self.line}"

    @property
    def count(self) -> int:
        """How many commands it has."""
        if self.how == "save" or self.kind == "yaml":
            return 0
        if self.kind == "python":
            return 1
        return sum(bool(line.strip()) for line in self.body.splitlines())


def blocks(page: Path) -> Iterator[Block]:
    """Yield a page's blocks in order; data that nobody is asked to save are none.

    Raises:
        DocumentError: how a block is to be taken is not said as above, or commands stand in a
            block that nobody would run.
    """
    text = page.read_text(encoding="utf-8")
    pending: Block | None = None
    for match in _BLOCK.finditer(text):
        line = text.count("\n", 0, match.start("body")) + 1
        marks = re.findall(_MARK, match["marks"])
        if marks == ["output"]:
            if pending is None or pending.kind != "sh" or pending.output is not None:
                raise DocumentError(f"{page.name}:{line}: output follows a block of commands")
            pending = replace(pending, output=match["body"])
            continue
        if pending is not None:
            yield pending
            pending = None
        block = _block(page, line, match["kind"], match["body"], marks)
        if block.kind in ("sh", "python") or block.how == "save":
            pending = block
        elif block.kind != "yaml" and _TYPED.search(block.body):
            raise DocumentError(f"{block.where}: commands stand in ```sh, to be run")
    if pending is not None:
        yield pending


def _block(page: Path, line: int, kind: str, body: str, marks: list[str]) -> Block:
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
        elif head in HOWS and rest:
            how, detail = head, rest
        else:
            raise DocumentError(f"{where}: how is it to be taken: {mark!r}?")
    if how == "look" and detail not in REASONS:
        raise DocumentError(f"{where}: look {detail!r}: say one of {', '.join(REASONS)}")
    if place and place not in PLACES:
        raise DocumentError(f"{where}: in {place!r}: say one of {', '.join(PLACES)}")
    return Block(page, line, kind, body, how, detail, place, tuple(before))


def pages() -> list[Path]:
    """Return the pages that somebody may follow."""
    paths = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
    paths += [ROOT / "systemd" / "README.md"]
    return [page for page in paths if not set(page.parts) & set(PASSED_OVER)]
