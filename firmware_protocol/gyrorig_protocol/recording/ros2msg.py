"""Parse `ros2msg` schema text into fields, from files that may be hostile.

What to use when: `parse_definitions` for the fields of a type and of everything it
needs; `same_definition` to ask whether two texts describe the same bytes.

Source: the MCAP registry on `ros2msg`; the ROS 2 interface definition language.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

from gyrorig_protocol.errors import InputError

_SEPARATOR_LINE = re.compile(r"^={80}\s*$", re.MULTILINE)
_HEAD = re.compile(r"\s*MSG:\s*(\S+)\s*\n?")
_FIELD = re.compile(
    r"(?P<type>[A-Za-z][\w/]*(?:<=\d+)?)(?P<array>\[(?:<=)?\d*\])?\s+(?P<name>[A-Za-z]\w*)(?P<rest>\s.*)?"
)
_CONSTANT = re.compile(r"[A-Za-z][\w/]*(?:<=\d+)?(?:\[[^\]]*\])?\s+[A-Za-z]\w*\s*=")

MAX_TEXT = 1 << 20  # far above any real definition


@dataclass(frozen=True, slots=True)
class Field:
    """One field: its type, its array length (None: no array, -1: length varies), its name."""

    type: str
    length: int | None
    name: str


Definitions = Mapping[str, tuple[Field, ...]]


def short_name(type_name: str) -> str:
    """`pkg/msg/Type` and `pkg/Type` are the same; the second form of it."""
    return type_name.replace("/msg/", "/")


@lru_cache(maxsize=64)
def parse_definitions(type_name: str, text: str) -> Definitions:
    """The fields of `type_name` and of each dependency in `text`, by short name.

    Raises:
        InputError: the text is no such definition.
    """
    if len(text) > MAX_TEXT:
        raise InputError(f"schema of {type_name} has {len(text)} characters")
    own, *dependencies = _SEPARATOR_LINE.split(text)
    package = type_name.partition("/")[0]
    found = {short_name(type_name): _fields(own, package)}
    for part in dependencies:
        head = _HEAD.match(part)
        if head is None:
            raise InputError(f"schema of {type_name}: a dependency without its name")
        name = short_name(head.group(1))
        found[name] = _fields(part[head.end() :], name.split("/")[0])
    return found


def same_definition(type_name: str, one: str, other: str) -> bool:
    """True when both texts give `type_name` the same fields, all the way down.

    Comments, constants and the order of dependencies do not matter.

    Raises:
        InputError: one of the texts is no definition.
    """
    sides = parse_definitions(type_name, one), parse_definitions(type_name, other)
    waiting, seen = [short_name(type_name)], set[str]()
    while waiting:
        name = waiting.pop()
        if name in seen:
            continue
        seen.add(name)
        if sides[0].get(name) != sides[1].get(name):
            return False
        waiting += [field.type for field in sides[0].get(name, ()) if "/" in field.type]
    return True


def _fields(text: str, package: str) -> tuple[Field, ...]:
    found = []
    for raw in text.splitlines():
        line = raw.split("#", 1)[0].strip()
        if not line or _CONSTANT.match(line):
            continue
        match = _FIELD.fullmatch(line)
        if match is None:
            raise InputError(f"schema line {line[:60]!r} is no field")
        found.append(Field(_full(match["type"], package), _length(match["array"]), match["name"]))
    return tuple(found)


def _full(type_name: str, package: str) -> str:
    """Give a type of the same package its package; primitives are lower case."""
    if "/" in type_name:
        return short_name(type_name)
    if type_name == "Header":
        return "std_msgs/Header"
    return f"{package}/{type_name}" if type_name[0].isupper() else type_name


def _length(array: str | None) -> int | None:
    if array is None:
        return None
    inside = array[1:-1]
    return int(inside) if inside.isdigit() else -1
