"""From a schema's text to the numpy dtype of its CDR payload.

What to use when: `fixed_layout` for any message; None means that the size varies
(strings, sequences) and that the message has to be decoded one at a time.

The rule of XCDR1: a primitive of n bytes begins at a multiple of n, counted from the
byte behind the 4-byte header; structs and arrays are flattened in order; nothing is
padded at the end. An array of structs whose elements would lie at unequal strides
becomes one field per element, named `name[0]`, `name[1]`...
"""

from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType
from typing import Any

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.ros2msg import Definitions, Field, parse_definitions, short_name

_PRIMITIVES = MappingProxyType(
    {
        # A bool is read as a byte: a file may hold any byte where a bool should be.
        **dict.fromkeys(("bool", "byte", "char", "uint8"), "u1"),
        "int8": "i1",
        **{
            f"{kind}{bits}": f"<{kind[0]}{bits // 8}"
            for kind in ("int", "uint")
            for bits in (16, 32, 64)
        },
        "float32": "<f4",
        "float64": "<f8",
    }
)

HEADER_BYTES = 4
# Bounds on what a hostile schema can make of us; the largest of ours has 66 bytes.
_MAX_BYTES = 1 << 16
_MAX_FIELDS = 4096
_MAX_DEPTH = 16


class _VariableSizeError(Exception):
    """The message has no fixed layout."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Where the fields of a fixed-size message lie."""

    dtype: np.dtype[np.void]  # of the payload behind its 4-byte header
    size: int  # of the payload with its header


@dataclass(slots=True)
class _Place:
    """Fields placed so far of a struct that begins at payload offset `start`."""

    start: int
    depth: int
    names: list[str]
    formats: list[Any]  # whatever np.dtype takes as a format
    offsets: list[int]


@lru_cache(maxsize=256)
def fixed_layout(type_name: str, text: str) -> Layout | None:
    """The layout of a message type, None when its size varies.

    Raises:
        InputError: the text is no definition, refers to itself, or is absurdly large.
    """
    definitions = parse_definitions(type_name, text)
    try:
        dtype, end = _struct(definitions, short_name(type_name), 0, 0)
    except _VariableSizeError:
        return None
    return Layout(dtype, HEADER_BYTES + end)


def _struct(
    definitions: Definitions, name: str, start: int, depth: int
) -> tuple[np.dtype[np.void], int]:
    """Lay out struct `name` from payload offset `start`; returns its dtype and its end."""
    if name not in definitions:
        raise InputError(f"schema does not define {name}")
    if depth > _MAX_DEPTH:
        raise InputError(f"schema nests more than {_MAX_DEPTH} deep at {name}")
    if not definitions[name]:
        raise _VariableSizeError  # what an empty struct takes differs between ROS versions
    place = _Place(start, depth, [], [], [])
    at = start
    for field in definitions[name]:
        at = _field(definitions, field, place, at)
        if at > _MAX_BYTES or len(place.names) > _MAX_FIELDS:
            raise InputError(f"schema of {name} describes more than {_MAX_BYTES} bytes")
    if len(set(place.names)) != len(place.names):
        raise InputError(f"schema of {name} names a field twice")
    dtype = np.dtype(
        {
            "names": place.names,
            "formats": place.formats,
            "offsets": place.offsets,
            "itemsize": at - start,
        }
    )
    return dtype, at


def _field(definitions: Definitions, field: Field, place: _Place, at: int) -> int:
    """Place one field at or behind payload offset `at`; returns its end."""
    if field.length == -1 or field.type.startswith(("string", "wstring")):
        raise _VariableSizeError
    if field.length == 0 or (field.length or 0) > _MAX_BYTES:
        raise InputError(f"schema field {field.name} has {field.length} elements")
    code = _PRIMITIVES.get(field.type)
    if code is not None:
        width = np.dtype(code).itemsize
        at += -at % width
        _put(place, field.name, code if field.length is None else (code, (field.length,)), at)
        return at + width * (field.length or 1)
    if "/" not in field.type:
        raise InputError(f"schema field {field.name} has the unknown type {field.type}")
    elements = []
    for _ in range(field.length or 1):
        dtype, end = _struct(definitions, field.type, at, place.depth + 1)
        elements.append((dtype, at))
        at = end
        if at > _MAX_BYTES:
            raise InputError(f"schema field {field.name} takes more than {_MAX_BYTES} bytes")
    _put_structs(place, field, elements)
    return at


def _put_structs(
    place: _Place, field: Field, elements: list[tuple[np.dtype[np.void], int]]
) -> None:
    """Place struct elements: one sub-array at equal strides, else one field each."""
    first, first_at = elements[0]
    if field.length is None:
        _put(place, field.name, first, first_at)
        return
    regular = all(
        dtype == first and at == first_at + i * first.itemsize
        for i, (dtype, at) in enumerate(elements)
    )
    if regular:
        _put(place, field.name, (first, (field.length,)), first_at)
        return
    for i, (dtype, at) in enumerate(elements):
        _put(place, f"{field.name}[{i}]", dtype, at)


def _put(place: _Place, name: str, form: object, at: int) -> None:
    place.names.append(name)
    place.formats.append(form)
    place.offsets.append(at - place.start)
