"""Parser of `ros2msg` schemas in untrusted files.

What to use when: `parse_definitions` for the fields of a type and of its dependencies;
`have_same_fields` to check whether two schemas describe the same bytes.

Source: the MCAP registry on `ros2msg`; the ROS 2 interface definition language.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

from gyrorig_protocol.errors import InputError

_SEPARATOR_PATTERN = re.compile(r"^={80}\s*$", re.MULTILINE)
_DEPENDENCY_HEAD_PATTERN = re.compile(r"\s*MSG:\s*(\S+)\s*\n?")
_FIELD_PATTERN = re.compile(
    r"(?P<type>[A-Za-z][\w/]*(?:<=\d+)?)(?P<array>\[(?:<=)?\d*\])?\s+(?P<name>[A-Za-z]\w*)(?P<rest>\s.*)?"
)
_CONSTANT_PATTERN = re.compile(r"[A-Za-z][\w/]*(?:<=\d+)?(?:\[[^\]]*\])?\s+[A-Za-z]\w*\s*=")

_SCHEMA_REMEDY = "correct the message schema in the program that wrote the file"
MAX_SCHEMA_CHARS = 1 << 20  # far more than in any real definition


@dataclass(frozen=True, slots=True)
class MessageField:
    """One field: its type, its array length (None: no array, -1: length varies), its name."""

    type: str
    length: int | None
    name: str


Definitions = Mapping[str, tuple[MessageField, ...]]


def short_name(type_name: str) -> str:
    """Return the short form `pkg/Type` of `pkg/msg/Type`."""
    return type_name.replace("/msg/", "/")


@lru_cache(maxsize=64)
def parse_definitions(type_name: str, text: str) -> Definitions:
    """Return the fields of `type_name` and of each dependency in `text`, by short name.

    Raises:
        InputError: the text is not a definition.
    """
    if len(text) > MAX_SCHEMA_CHARS:
        raise InputError(
            f"the schema of the message type {type_name} has {len(text)} characters, but at most "
            f"{MAX_SCHEMA_CHARS} are allowed",
            _SCHEMA_REMEDY,
        )
    main_text, *dependencies = _SEPARATOR_PATTERN.split(text)
    package = type_name.partition("/")[0]
    definitions = {short_name(type_name): _parse_fields(main_text, package)}
    for part in dependencies:
        head = _DEPENDENCY_HEAD_PATTERN.match(part)
        if head is None:
            raise InputError(
                f"the schema of the message type {type_name} uses another type that has no name",
                _SCHEMA_REMEDY,
            )
        name = short_name(head.group(1))
        definitions[name] = _parse_fields(part[head.end() :], name.split("/")[0])
    return definitions


def have_same_fields(type_name: str, text: str, other_text: str) -> bool:
    """Return whether both texts give `type_name` the same fields, including dependencies.

    Comments, constants and the order of dependencies do not matter.

    Raises:
        InputError: one of the texts is not a definition.
    """
    definitions = parse_definitions(type_name, text), parse_definitions(type_name, other_text)
    pending, compared = [short_name(type_name)], set[str]()
    while pending:
        name = pending.pop()
        if name in compared:
            continue
        compared.add(name)
        if definitions[0].get(name) != definitions[1].get(name):
            return False
        pending += [field.type for field in definitions[0].get(name, ()) if "/" in field.type]
    return True


def _parse_fields(text: str, package: str) -> tuple[MessageField, ...]:
    fields = []
    for raw_line in text.splitlines():
        line = raw_line.split("#", 1)[0].strip()
        if not line or _CONSTANT_PATTERN.match(line):
            continue
        match = _FIELD_PATTERN.fullmatch(line)
        if match is None:
            raise InputError(
                f"the line {line[:60]!r} in a message schema of the MCAP file does not define a "
                "field",
                _SCHEMA_REMEDY,
            )
        fields.append(
            MessageField(
                _qualify_type(match["type"], package), _parse_length(match["array"]), match["name"]
            )
        )
    return tuple(fields)


def _qualify_type(type_name: str, package: str) -> str:
    """Add the package to a type of the same package; primitives are in lower case."""
    if "/" in type_name:
        return short_name(type_name)
    if type_name == "Header":
        return "std_msgs/Header"
    return f"{package}/{type_name}" if type_name[0].isupper() else type_name


def _parse_length(array: str | None) -> int | None:
    if array is None:
        return None
    length_text = array[1:-1]
    return int(length_text) if length_text.isdigit() else -1
