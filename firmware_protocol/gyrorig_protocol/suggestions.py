"""Suggestions for a mistyped word: the nearest of the words that are known."""

import difflib
from collections.abc import Iterable


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
