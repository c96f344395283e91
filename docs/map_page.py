"""Page of all keys of an import map, from the structures that define the keys.

What to use when: `make_import_map_page` for the page, `read_key_meanings` for the keys of one
structure.
"""

import inspect
import re
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import msgspec

from gyrorig_solver.importers import ImportMap

HEAD = """# Import map

An import map, `gyrorig/import/1`, describes the columns of a text table or of a NumPy archive. A
key that is not on this page is an error. The page [Import a format](../how-to/import.md) has
examples.

## Names of columns

| you write | it means |
|---|---|
| `gyro_x` | the column with this name, or the array with this name |
| `3` | the third column of a table |
| `x#2` | the second column with the name `x`. A name that occurs twice is an error |
| `log[0]` | the first column of the array `log` of an archive |
"""


def make_import_map_page() -> str:
    """Return the page with every key of an import map and its meaning."""
    lines = [HEAD]
    structs: list[Any] = [ImportMap]
    for struct in structs:  # the loop appends to this list
        lines += ["", f"## {struct.__name__}", "", _escape(_read_summary(struct)), ""]
        lines += ["| key | type | default | meaning |", "|---|---|---|---|"]
        meanings = read_key_meanings(struct)
        for field in msgspec.structs.fields(struct):
            name = field.encode_name
            default = "required" if field.required else _format_default(field.default)
            meaning = _escape(meanings[name])
            lines.append(
                f"| `{name}` | {_describe_type(field.type, structs)} | {default} | {meaning} |"
            )
    return "\n".join([*lines, ""])


def read_key_meanings(struct: Any) -> dict[str, str]:
    """Return the meaning of each key, from the section "Keys" of a docstring."""
    _, _, section = (inspect.getdoc(struct) or "").partition("Keys:\n")
    meanings: dict[str, str] = {}
    key = ""
    for line in section.splitlines():
        start = re.fullmatch(r"    (\w+): (.*)", line)
        if start:
            key = start[1]
            meanings[key] = start[2]
        elif line.startswith("        "):
            meanings[key] += f" {line.strip()}"
    return meanings


def _read_summary(struct: Any) -> str:
    return (inspect.getdoc(struct) or "").partition("Keys:\n")[0].strip()


def _describe_type(kind: Any, structs: list[Any]) -> str:
    """Return a type in words, and append a new structure to `structs`."""
    origin, inner = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        return " or ".join(_describe_type(part, structs) for part in inner if part is not NoneType)
    if origin is Literal:
        return ", ".join(f"`{value}`" for value in inner)
    if origin in (Annotated, list, dict):
        words = {Annotated: "", list: "list of ", dict: "names with "}[origin]
        return words + _describe_type(inner[origin is dict], structs)
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        if kind not in structs:
            structs.append(kind)
        return f"[{kind.__name__}](#{kind.__name__.lower()})"
    return {str: "text", int: "whole number", float: "number"}[kind]


def _format_default(value: Any) -> str:
    is_plain = isinstance(value, str | int | float)
    return f"`{value}`" if is_plain else ""


def _escape(text: str) -> str:
    """Escape the characters that Markdown would interpret, outside of code."""
    parts = " ".join(text.split()).split("`")
    for at in range(0, len(parts), 2):
        parts[at] = re.sub(r"([<>*_|])", r"\\\1", parts[at])
    return "`".join(parts)
