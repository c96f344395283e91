"""Layouts of the messages of format 1, from the schemas in `message_schemas`.

What to use when: `FIXED_LAYOUTS` for the numpy dtype of a message whose size never varies;
`has_fields_of_format` to check the schema of an untrusted file.

The rule of XCDR1: a primitive of n bytes begins at a multiple of n, counted from the byte after the
4-byte header. There is no padding at the end. Schemas of other types are not interpreted.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType

import numpy as np

from gyrorig_protocol.recording.encoding.message_schemas import SCHEMAS, SEPARATOR

HEADER_BYTES = 4
_TIME = np.dtype([("sec", "<i4"), ("nanosec", "<u4")])
_FORMATS: Mapping[str, np.dtype[np.generic]] = MappingProxyType(
    {
        **{f"uint{bits}": np.dtype(f"<u{bits // 8}") for bits in (8, 16, 32, 64)},
        **{f"int{bits}": np.dtype(f"<i{bits // 8}") for bits in (16, 32)},
        "float64": np.dtype("<f8"),
        "builtin_interfaces/Time": _TIME,
    }
)
_ALIGNMENT = MappingProxyType({"builtin_interfaces/Time": 4})  # of all others: the size
# Schemas of format 1 have at most 800 characters.
MAX_SCHEMA_BYTES = 1 << 16
_SECTION_PATTERN = re.compile(rf"^{SEPARATOR}\s*^MSG:[ \t]*(\S+)", re.MULTILINE)

Sections = Mapping[str, tuple[tuple[str, str], ...]]  # type and name of each field, by struct


@dataclass(frozen=True, slots=True)
class PayloadLayout:
    """The layout of a fixed-size message."""

    dtype: np.dtype[np.void]  # of the payload after its 4-byte header
    size_bytes: int  # of the payload with its header


@lru_cache(maxsize=64)
def has_fields_of_format(type_name: str, schema: bytes) -> bool:
    """Return whether the schema of a file has the fields that format 1 gives to a type.

    Comments, constants, other structs and the order of structs do not matter.
    """
    if len(schema) > MAX_SCHEMA_BYTES:
        return False
    sections = _sections(type_name, schema.decode(errors="replace"))
    own_sections = _sections(type_name, SCHEMAS[type_name])
    return all(sections.get(name) == fields for name, fields in own_sections.items())


def _sections(type_name: str, text: str) -> Sections:
    """Return the fields of a type and of each struct that its schema defines."""
    main_text, *dependencies = _SECTION_PATTERN.split(text)
    names = [type_name, *dependencies[::2]]
    texts = [main_text, *dependencies[1::2]]
    return {
        name.replace("/msg/", "/"): tuple(_fields(body, name.partition("/")[0]))
        for name, body in zip(names, texts, strict=True)
    }


def _fields(text: str, package: str) -> list[tuple[str, str]]:
    """Return the fields of a struct; a type without a package is of the same package."""
    lines = (line.split("#", 1)[0] for line in text.splitlines())
    words = [line.split() for line in lines if line.strip() and "=" not in line]
    return [(_full_type(line[0], package), " ".join(line[1:2])) for line in words]


def _full_type(name: str, package: str) -> str:
    if name == "Header":
        return "std_msgs/Header"
    is_struct_of_package = name[0].isupper() and "/" not in name
    return f"{package}/{name}" if is_struct_of_package else name.replace("/msg/", "/")


def _fixed_layout(type_name: str) -> PayloadLayout | None:
    """Return the layout of a message of format 1, None if its size varies."""
    names, formats, offsets, offset = [], [], [], 0
    for kind, name in _sections(type_name, SCHEMAS[type_name])[type_name.replace("/msg/", "/")]:
        base, _, length = kind.removesuffix("]").partition("[")
        dtype = _FORMATS.get(base)
        if dtype is None or kind.endswith("[]"):
            return None
        offset += -offset % _ALIGNMENT.get(base, dtype.itemsize)
        names.append(name)
        formats.append((dtype, (int(length),)) if length else dtype)
        offsets.append(offset)
        offset += dtype.itemsize * int(length or 1)
    dtype = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": offset})
    return PayloadLayout(dtype, HEADER_BYTES + offset)


FIXED_LAYOUTS: Mapping[str, PayloadLayout] = MappingProxyType(
    {name: layout for name in SCHEMAS if (layout := _fixed_layout(name)) is not None}
)
