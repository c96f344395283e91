"""Blocks of a document that scripts write: between `<!-- begin: name -->` and `<!-- end -->`.

What to use when: `replace_blocks` to make blocks again, `write_or_check` as the end of a script
that writes one document, `describe_difference` if a number may differ in its last digits.
"""

import re
from collections.abc import Mapping
from pathlib import Path

from docs.markdown import Block

BLOCK = re.compile(
    r"(<!-- begin: (?P<name>[a-z0-9-]+) -->\n)(?P<body>.*?)(<!-- end -->)", re.DOTALL
)
NUMBER = re.compile(r"-?\d+(?:\.\d+)?")


def read_block_names(text: str) -> list[str]:
    """Return the names of the blocks in a document, in order."""
    return [match["name"] for match in BLOCK.finditer(text)]


def read_block_bodies(text: str) -> dict[str, str]:
    """Return the text of each block by its name."""
    return {match["name"]: match["body"] for match in BLOCK.finditer(text)}


def replace_blocks(text: str, blocks: Mapping[str, Block]) -> str:
    """Return the document with new text in each of `blocks`; other blocks do not change."""

    def make_block(match: re.Match[str]) -> str:
        block = blocks.get(match["name"])
        if block is None:
            return match[0]
        return f"{match[1]}{block()}\n{match[4]}"

    return BLOCK.sub(make_block, text)


def write_or_check(document: Path, blocks: Mapping[str, Block], check: bool, script: str) -> int:
    """Write the blocks into a document, or with `check` only report whether they differ.

    Returns:
        The exit code: 1 if a checked block differs.
    """
    old_text = document.read_text(encoding="utf-8")
    new_text = replace_blocks(old_text, blocks)
    if check:
        if new_text != old_text:
            print(f"docs/{document.name} differs from its scripts: run {script}")
        return int(new_text != old_text)
    document.write_text(new_text, encoding="utf-8")
    return 0


def describe_difference(old: str, new: str, relative: float, last_digits: float) -> str:
    """Return the first difference of two bodies: a word, or a number beyond the tolerance.

    The tolerance is necessary because processors round the last digits differently.

    Args:
        old: the stored body.
        new: the body that the script makes.
        relative: tolerance as a fraction of a number.
        last_digits: tolerance in steps of a number's last digit.

    Returns:
        The first difference; empty if there is no difference.
    """
    if NUMBER.sub("#", new) != NUMBER.sub("#", old):
        return f"other words: {new!r}, stored {old!r}"
    for old_number, new_number in zip(NUMBER.findall(old), NUMBER.findall(new), strict=True):
        step = 10.0 ** -len(old_number.partition(".")[2])
        allowed = max(relative * abs(float(old_number)), (last_digits + 0.01) * step)
        if abs(float(new_number) - float(old_number)) > allowed:
            return f"{new_number}, stored {old_number}"
    return ""
