"""Suggestions for a mistyped word: the nearest of the words that are known."""

import difflib
from collections.abc import Iterable, Sequence


def closest_words(word: str, known: Iterable[str], count: int = 3) -> list[str]:
    """Return up to `count` known words that resemble `word`, the nearest first."""
    spellings = {name.casefold(): name for name in known}
    matches = difflib.get_close_matches(word.casefold(), spellings, count)
    return [spellings[match] for match in matches]


def did_you_mean(word: str, known: Iterable[str], count: int = 3) -> str:
    """Return "did you mean a, b or c?", or an empty text where nothing resembles `word`."""
    words = closest_words(word, known, count)
    if not words:
        return ""
    listed = words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"
    return f"did you mean {listed}?"


def list_closest(word: str, known: Sequence[str], count: int = 3) -> str:
    """Return the `count` known words that resemble `word` most, and how many others there are.

    Where nothing resembles `word`, these are the first known words: "C1, C2, C3, or one of 13
    others".
    """
    words = closest_words(word, known, count) or list(known[:count])
    others = len(known) - len(words)
    return ", ".join(words) + (f", or one of {others} others" if others else "")
