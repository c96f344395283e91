"""Blocks of a document that scripts write: between `<!-- begin: name -->` and `<!-- end -->`.

What to use when: `written` to make blocks anew, `write_or_check` as the end of a script that
keeps one document, `unlike` where a number may differ in its last digits.
"""

import re
from collections.abc import Mapping
from pathlib import Path

from docs.markdown import Block

BLOCK = re.compile(
    r"(<!-- begin: (?P<name>[a-z0-9-]+) -->\n)(?P<body>.*?)(<!-- end -->)", re.DOTALL
)
NUMBER = re.compile(r"-?\d+(?:\.\d+)?")


def block_names(text: str) -> list[str]:
    """Names of the blocks in a document, in order."""
    return [match["name"] for match in BLOCK.finditer(text)]


def bodies(text: str) -> dict[str, str]:
    """What stands in each block."""
    return {match["name"]: match["body"] for match in BLOCK.finditer(text)}


def written(text: str, blocks: Mapping[str, Block]) -> str:
    """The document with each of `blocks` made anew; others stay as they are."""

    def anew(match: re.Match[str]) -> str:
        block = blocks.get(match["name"])
        if block is None:
            return match[0]
        return f"{match[1]}{block()}\n{match[4]}"

    return BLOCK.sub(anew, text)


def write_or_check(document: Path, blocks: Mapping[str, Block], check: bool, script: str) -> int:
    """Write the blocks into a document, or with `check` only say whether they differ.

    Returns:
        The exit code: 1 if a checked block differs.
    """
    text = document.read_text(encoding="utf-8")
    new = written(text, blocks)
    if check:
        if new != text:
            print(f"docs/{document.name} differs from its scripts: run {script}")
        return int(new != text)
    document.write_text(new, encoding="utf-8")
    return 0


def unlike(old: str, new: str, relative: float, last_digits: float) -> str:
    """Say where two bodies differ: in words, or in a number by more than is allowed.

    Exact digits would tie a document to one processor's rounding.

    Args:
        old: the body that is kept.
        new: the body made now.
        relative: allowed part of a number.
        last_digits: allowed steps of a number's last digit.

    Returns:
        The first difference; empty if there is none.
    """
    if NUMBER.sub("#", new) != NUMBER.sub("#", old):
        return f"other words: {new!r}, kept {old!r}"
    for was, now in zip(NUMBER.findall(old), NUMBER.findall(new), strict=True):
        step = 10.0 ** -len(was.partition(".")[2])
        allowed = max(relative * abs(float(was)), (last_digits + 0.01) * step)
        if abs(float(now) - float(was)) > allowed:
            return f"{now}, kept {was}"
    return ""
