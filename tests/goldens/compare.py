"""Compare two results: numbers within a tolerance, structure and names exactly.

What to use when: `differences` of a stored result and a new one. An empty list is agreement.
"""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from tests.goldens.collect import NUMBER
from tests.goldens.fields import is_text

RELATIVE = 1e-9
# Below this size two numbers count as equal: it is far below the rounding of any quantity here
# but p-values, which are then zero for every use.
FLOOR = 1e-15
_TOKEN_NUMBER = re.compile(rf"({NUMBER.pattern})[fFlLuU]?")
Path = tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Rules:
    """What counts as a difference.

    Attributes:
        relative: tolerance of numbers, relative to the larger one.
        texts: compare sentences, too.
    """

    relative: float = RELATIVE
    texts: bool = False


@dataclass(frozen=True, slots=True)
class Difference:
    """One value that is not as it was.

    Attributes:
        path: keys from the result's top to the value.
        old: stored value.
        new: value of the tree under test.
    """

    path: Path
    old: object
    new: object

    def __str__(self) -> str:
        where = ".".join(self.path).replace(".[", "[")
        return f"{where}: {_short(self.old)} -> {_short(self.new)}"


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 160 else text[:157] + "..."


def _is_close(old: float, new: float, rules: Rules) -> bool:
    """Return whether two numbers are equal within the tolerance; NaN equals NaN."""
    if math.isnan(old) or math.isnan(new):
        return math.isnan(old) and math.isnan(new)
    return math.isclose(old, new, rel_tol=rules.relative, abs_tol=FLOOR)


def differences(old: Any, new: Any, rules: Rules, path: Path = ()) -> list[Difference]:
    """Return where two results differ.

    Args:
        old: stored result.
        new: result to judge.
        rules: what counts as a difference.
        path: keys above both.
    """
    return list(_walk(old, new, rules, path))


def _walk(old: Any, new: Any, rules: Rules, path: Path) -> Iterator[Difference]:
    if type(old) is not type(new):
        yield Difference(path, old, new)
    elif isinstance(old, dict):
        yield from _walk_mapping(old, new, rules, path)
    elif isinstance(old, list):
        yield from _walk_list(old, new, rules, path)
    elif isinstance(old, float):
        if not _is_close(old, new, rules):
            yield Difference(path, old, new)
    elif isinstance(old, str):
        yield from _walk_string(old, new, rules, path)
    elif old != new:
        yield Difference(path, old, new)


def _walk_mapping(
    old: dict[str, Any], new: dict[str, Any], rules: Rules, path: Path
) -> Iterator[Difference]:
    for key in [*old, *(key for key in new if key not in old)]:
        if key not in new:
            yield Difference((*path, key), old[key], "<missing>")
        elif key not in old:
            yield Difference((*path, key), "<missing>", new[key])
        else:
            yield from _walk(old[key], new[key], rules, (*path, key))
    if set(old) == set(new) and list(old) != list(new):
        yield Difference((*path, "<order of keys>"), list(old), list(new))


def _walk_list(old: list[Any], new: list[Any], rules: Rules, path: Path) -> Iterator[Difference]:
    is_output = path in (("stdout", "text"), ("stderr", "text"))
    if len(old) != len(new) and (rules.texts or not is_output):
        yield Difference((*path, "<length>"), len(old), len(new))
    for k, (left, right) in enumerate(zip(old, new, strict=False)):
        yield from _walk(left, right, rules, (*path, f"[{k}]"))


def _walk_string(old: str, new: str, rules: Rules, path: Path) -> Iterator[Difference]:
    if is_text(path):
        if rules.texts and old != new:
            yield Difference(path, old, new)
    elif path and path[-1] == "tokens":
        yield from _walk_tokens(old.split(), new.split(), rules, path)
    elif old != new:
        yield Difference(path, old, new)


def _walk_tokens(old: list[str], new: list[str], rules: Rules, path: Path) -> Iterator[Difference]:
    if len(old) != len(new):
        yield Difference((*path, "<length>"), len(old), len(new))
    for k, (left, right) in enumerate(zip(old, new, strict=False)):
        numbers = _TOKEN_NUMBER.fullmatch(left), _TOKEN_NUMBER.fullmatch(right)
        if numbers[0] and numbers[1]:
            is_equal = _is_close(float(numbers[0][1]), float(numbers[1][1]), rules)
        else:
            is_equal = left == right
        if not is_equal:
            yield Difference((*path, f"[{k}]"), left, right)
