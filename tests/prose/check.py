"""Prose checker: private words and long sentences in the documentation and in the program's texts.

    python -m tests.prose.check             list what is new, exit with status 1 if anything is
    python -m tests.prose.check --all       list every hit, also those that are known
    python -m tests.prose.check --long      list also the long sentences, which are only a warning
    python -m tests.prose.check --write     record the present number of hits of each file

`words.toml` has the words, `known.toml` the number of known hits of each file. A file may have
fewer hits than recorded, never more, and a file that is not recorded has none.
"""

import argparse
import re
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from tests.unit.output.spoken import texts

ROOT = Path(__file__).resolve().parents[2]
FOLDER = Path(__file__).parent
PAGES = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "tests/README.md", "systemd/README.md")
PAGE_FOLDERS = ("docs", "docs/how-to", "docs/explain")
MAX_WORDS = 40

_BLOCKS = re.compile(r"```.*?```|~~~.*?~~~|<!--.*?-->|\$\$.*?\$\$", re.DOTALL)
_CODE = re.compile(r"``.+?``|`[^`\n]+`")
_LINK = re.compile(r"!?\[([^]]*)\]\([^)]*\)")
_SENTENCE_END = re.compile(r"(?<=[.!?])\s+(?=[A-Z*\"(])|\n{2,}")
_NOT_PROSE = re.compile(r"^\s*(?:\||#|<|---|\{)")
_WHAT_IS = re.compile(r"What\b[^?]*\bis\b[^?]*\.")


class Hit(NamedTuple):
    """One place to rewrite."""

    path: str
    line: int
    text: str
    instead: str


def strip_code(text: str) -> str:
    """Blank out code, comments and link targets; the line numbers do not change."""
    text = _BLOCKS.sub(lambda match: re.sub(r"[^\n]", " ", match[0]), text)
    return _LINK.sub(lambda match: match[1], _CODE.sub("CODE", text))


def newest_section(changelog: str) -> str:
    """Return the change log up to its second version."""
    headings = [match.start() for match in re.finditer(r"^## ", changelog, re.MULTILINE)]
    return changelog[: headings[1]] if len(headings) > 1 else changelog


def pages() -> Iterator[tuple[str, str]]:
    """Yield the path and the text of every page that is checked."""
    paths = [ROOT / name for name in PAGES]
    for folder in PAGE_FOLDERS:
        paths += sorted((ROOT / folder).glob("*.md"))
    for path in paths:
        if path.exists():
            text = path.read_text(encoding="utf-8")
            if path.name == "CHANGELOG.md":
                text = newest_section(text)
            yield path.relative_to(ROOT).as_posix(), text


def program_texts() -> Iterator[tuple[str, int, str]]:
    """Yield path, line and text of every string in the product that people can read."""
    for text in texts():
        path, _, line = text.place.rpartition(":")
        yield path, int(line), text.text


class Words:
    """The words to avoid, and their legitimate uses."""

    def __init__(self, path: Path = FOLDER / "words.toml") -> None:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
        self._avoid = [(re.compile(p, re.IGNORECASE), t) for p, t in content["avoid"].items()]
        self._allow = [(use["in"], use["text"]) for use in content["allow"] if use["reason"]]

    def hits(self, path: str, line: int, text: str) -> Iterator[Hit]:
        """Yield the words to avoid in one line of prose."""
        if any(path.startswith(place) and part in text for place, part in self._allow):
            return
        for pattern, instead in self._avoid:
            for match in pattern.finditer(text):
                yield Hit(path, line, match[0], instead)


def page_hits(path: str, text: str, words: Words) -> Iterator[Hit]:
    """Yield the hits of one page: words, and sentences of the form "What ... is ..."."""
    prose = strip_code(text)
    for number, line in enumerate(prose.splitlines(), 1):
        yield from words.hits(path, number, line)
    for number, sentence in sentences(prose):
        if _WHAT_IS.match(sentence):
            yield Hit(path, number, sentence[:40], "begin with a person or a component")


def sentences(prose: str) -> Iterator[tuple[int, str]]:
    """Yield line number and text of each sentence outside tables and headings."""
    lines = [" " if _NOT_PROSE.match(line) else line for line in prose.splitlines()]
    text = "\n".join(re.sub(r"^(\s*)(?:[-*]|\d+\.)\s", r"\n\1", line) for line in lines)
    position = 0
    for sentence in _SENTENCE_END.split(text):
        position = text.index(sentence, position)
        yield prose.count("\n", 0, position) + 1, " ".join(sentence.split())
        position += len(sentence)


def find_all() -> list[Hit]:
    """Return every hit in the pages and in the program's texts."""
    words = Words()
    hits = [hit for path, text in pages() for hit in page_hits(path, text, words)]
    for path, line, text in program_texts():
        hits += words.hits(path, line, _CODE.sub("CODE", text))
    return sorted(set(hits))


def long_sentences() -> list[Hit]:
    """Return the sentences of more than `MAX_WORDS` words; a warning, not an error."""
    return [
        Hit(path, number, sentence[:60], f"{len(sentence.split())} words: split it")
        for path, text in pages()
        for number, sentence in sentences(strip_code(text))
        if len(sentence.split()) > MAX_WORDS
    ]


def known_counts() -> dict[str, int]:
    """Return the recorded number of hits by file."""
    return dict(tomllib.loads((FOLDER / "known.toml").read_text(encoding="utf-8"))["hits"])


def find_new(hits: list[Hit], known: dict[str, int]) -> list[Hit]:
    """Return all hits of the files that have more than recorded."""
    counts = Counter(hit.path for hit in hits)
    return [hit for hit in hits if counts[hit.path] > known.get(hit.path, 0)]


def main() -> int:
    """Print the hits; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--all", action="store_true", help="also list the known hits")
    parser.add_argument("--long", action="store_true", help="also list the long sentences")
    parser.add_argument("--write", action="store_true", help="record the present hits")
    options = parser.parse_args()
    hits = find_all()
    if options.write:
        counts = sorted(Counter(hit.path for hit in hits).items())
        text = "".join(f'"{path}" = {count}\n' for path, count in counts)
        (FOLDER / "known.toml").write_text(
            f"# Hits that are still to be rewritten; made by check.py --write.\n[hits]\n{text}",
            encoding="utf-8",
        )
    new = find_new(hits, known_counts())
    for hit in (hits if options.all else new) + (long_sentences() if options.long else []):
        sys.stdout.write(f"{hit.path}:{hit.line}: {hit.text!r}; use: {hit.instead}\n")
    return 1 if new else 0


if __name__ == "__main__":
    raise SystemExit(main())
