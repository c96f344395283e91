"""CDR layout: derive the numpy dtype of a payload from its schema.

What to use when: `derive_fixed_layout` for any message. None means that the size varies (strings,
sequences), and that messages must be decoded one at a time.

The rule of XCDR1: a primitive of n bytes begins at a multiple of n, counted from the byte after the
4-byte header. Structs and arrays are flattened in order. There is no padding at the end. An array
of structs whose elements have unequal strides becomes one field per element: `name[0]`, `name[1]`
"""

from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType
from typing import Any

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.encoding.ros2msg import (
    Definitions,
    MessageField,
    parse_definitions,
    short_name,
)

_PRIMITIVES = MappingProxyType(
    {
        # A bool is read as a byte, because a file can have any byte there.
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
_SCHEMA_REMEDY = "correct the message schema in the program that wrote the file"
# Limits for schemas of untrusted files; our largest message has 66 bytes.
_MAX_BYTES = 1 << 16
_MAX_FIELDS = 4096
_MAX_DEPTH = 16
_LARGEST_ALIGNMENT = 8  # of a primitive, in bytes


class _VariableSizeError(Exception):
    """The message has no fixed layout."""


@dataclass(frozen=True, slots=True)
class PayloadLayout:
    """The layout of a fixed-size message."""

    dtype: np.dtype[np.void]  # of the payload after its 4-byte header
    size_bytes: int  # of the payload with its header


@dataclass(slots=True)
class _StructLayout:
    """The fields so far of a struct that begins at payload offset `start`."""

    start: int
    depth: int
    names: list[str]
    formats: list[Any]  # formats of np.dtype
    offsets: list[int]


@lru_cache(maxsize=256)
def derive_fixed_layout(type_name: str, text: str) -> PayloadLayout | None:
    """Return the layout of a message type, None if its size varies.

    Raises:
        InputError: the text is not a definition, refers to itself, or is too large.
    """
    definitions = parse_definitions(type_name, text)
    try:
        dtype, end = _lay_out_struct(definitions, short_name(type_name), 0, 0)
    except _VariableSizeError:
        return None
    return PayloadLayout(dtype, HEADER_BYTES + end)


def _lay_out_struct(
    definitions: Definitions, name: str, start: int, depth: int
) -> tuple[np.dtype[np.void], int]:
    """Lay out struct `name` from payload offset `start`; return its dtype and its end."""
    if name not in definitions:
        raise InputError(
            f"a message schema in the MCAP file uses the type {name}, but does not define it",
            _SCHEMA_REMEDY,
        )
    if depth > _MAX_DEPTH:
        raise InputError(
            f"in a message schema of the MCAP file, the message type {name} is nested in more than "
            f"{_MAX_DEPTH} other types",
            _SCHEMA_REMEDY,
        )
    if not definitions[name]:
        raise _VariableSizeError  # the size of an empty struct depends on the ROS version
    layout = _StructLayout(start, depth, [], [], [])
    offset = start
    for field in definitions[name]:
        offset = _lay_out_field(definitions, field, layout, offset)
        if offset > _MAX_BYTES or len(layout.names) > _MAX_FIELDS:
            raise InputError(
                f"the schema of the message type {name} is too large: it describes more than "
                f"{_MAX_BYTES} bytes",
                _SCHEMA_REMEDY,
            )
    if len(set(layout.names)) != len(layout.names):
        raise InputError(
            f"the schema of the message type {name} contains two fields with the same name",
            _SCHEMA_REMEDY,
        )
    dtype = np.dtype(
        {
            "names": layout.names,
            "formats": layout.formats,
            "offsets": layout.offsets,
            "itemsize": offset - start,
        }
    )
    return dtype, offset


def _lay_out_field(
    definitions: Definitions, field: MessageField, layout: _StructLayout, offset: int
) -> int:
    """Add one field at or after payload offset `offset`; return its end."""
    if field.length == -1 or field.type.startswith(("string", "wstring")):
        raise _VariableSizeError
    if field.length == 0 or (field.length or 0) > _MAX_BYTES:
        raise InputError(
            f"the array {field.name} in a message schema of the MCAP file has the invalid length "
            f"{field.length}",
            _SCHEMA_REMEDY,
        )
    code = _PRIMITIVES.get(field.type)
    if code is not None:
        width = np.dtype(code).itemsize
        offset += -offset % width
        _add_field(
            layout, field.name, code if field.length is None else (code, (field.length,)), offset
        )
        return offset + width * (field.length or 1)
    if "/" not in field.type:
        raise InputError(
            f"the field {field.name} in a message schema of the MCAP file has the unknown type "
            f"{field.type}",
            _SCHEMA_REMEDY,
        )
    elements: list[tuple[np.dtype[np.void], int]] = []
    by_alignment: dict[int, np.dtype[np.void]] = {}
    for _ in range(field.length or 1):
        # The padding inside a struct depends on its offset modulo 8 alone.
        known = by_alignment.get(offset % _LARGEST_ALIGNMENT)
        if known is not None and offset + known.itemsize <= _MAX_BYTES:
            elements.append((known, offset))
            offset += known.itemsize
            continue
        dtype, end = _lay_out_struct(definitions, field.type, offset, layout.depth + 1)
        by_alignment[offset % _LARGEST_ALIGNMENT] = dtype
        elements.append((dtype, offset))
        offset = end
        if offset > _MAX_BYTES:
            raise InputError(
                f"the field {field.name} in a message schema of the MCAP file is too large: it has "
                f"more than {_MAX_BYTES} bytes",
                _SCHEMA_REMEDY,
            )
    _add_struct_elements(layout, field, elements)
    return offset


def _add_struct_elements(
    layout: _StructLayout, field: MessageField, elements: list[tuple[np.dtype[np.void], int]]
) -> None:
    """Add struct elements: one sub-array if strides are equal, else one field each."""
    first_dtype, first_offset = elements[0]
    if field.length is None:
        _add_field(layout, field.name, first_dtype, first_offset)
        return
    has_equal_strides = all(
        dtype == first_dtype and offset == first_offset + index * first_dtype.itemsize
        for index, (dtype, offset) in enumerate(elements)
    )
    if has_equal_strides:
        _add_field(layout, field.name, (first_dtype, (field.length,)), first_offset)
        return
    for index, (dtype, offset) in enumerate(elements):
        _add_field(layout, f"{field.name}[{index}]", dtype, offset)


def _add_field(layout: _StructLayout, name: str, field_format: object, offset: int) -> None:
    layout.names.append(name)
    layout.formats.append(field_format)
    layout.offsets.append(offset - layout.start)
