"""Compare the output that a page shows with the real output of a command.

Lines must agree in words and order. Several spaces count as one. A number may differ by one unit of
its last printed digit, because another processor rounds differently. A simulated recording can
differ by the noise of some samples on another processor, so that a page can permit more units. In
the page, a line `...` matches any lines, and `*` matches any characters, for example in a file name
with a date.
"""

import re
from collections.abc import Sequence

_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w.]*[A-Za-z_])")
SKIPPED = "..."
ANY = "*"


def first_difference(expected: str, printed: str, last_digits: int = 1) -> str:
    """Return where the output differs from the page, or an empty text if it agrees.

    Args:
        expected: the output block of the page.
        printed: the standard output of the commands above the block.
        last_digits: by which a number may differ, in units of its last printed digit.
    """
    wanted, lines = _lines(expected), _lines(printed)
    position, may_skip = 0, False
    for line in wanted:
        if line == SKIPPED:
            may_skip = True
            continue
        candidates = range(position, len(lines) if may_skip else min(position + 1, len(lines)))
        match = next((k for k in candidates if lines_agree(line, lines[k], last_digits)), None)
        if match is None:
            shown = lines[position] if position < len(lines) else "nothing more"
            return f"the page has {line!r}, the command printed {shown!r}"
        position, may_skip = match + 1, False
    if position < len(lines) and not may_skip:
        return f"the command printed {lines[position]!r} too"
    return ""


def lines_agree(expected: str, printed: str, last_digits: int = 1) -> bool:
    """Return whether two lines agree: words exactly, numbers within the tolerance."""
    if not re.fullmatch(_pattern(expected), printed):
        return False
    if ANY in expected:
        return True
    pairs = zip(_NUMBER.findall(expected), _NUMBER.findall(printed), strict=True)
    return all(_numbers_agree(wanted, printed, last_digits) for wanted, printed in pairs)


def _lines(text: str) -> Sequence[str]:
    return [" ".join(line.split()) for line in text.splitlines() if line.strip()]


def _pattern(line: str) -> str:
    """Return a regular expression that matches the line with any numbers."""
    pieces = [re.escape(piece).replace(re.escape(ANY), ".*") for piece in _NUMBER.split(line)]
    return _NUMBER.pattern.join(pieces)


def _numbers_agree(wanted: str, printed: str, last_digits: int) -> bool:
    mantissa, _, exponent = wanted.partition("e")
    decimals = len(mantissa.partition(".")[2])
    last_digit = 10.0 ** (int(exponent or 0) - decimals)
    if wanted == printed:
        return True
    return (
        "." in mantissa
        and abs(float(wanted) - float(printed)) <= (last_digits + 0.001) * last_digit
    )
