"""The page of all keys of an import map, made from the structures that define them.

What to use when: `import_map_page` is the page; `key_meanings` are the meanings of one structure.
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


def import_map_page() -> str:
    """Every key of an import map, with its meaning."""
    out = [HEAD]
    known: list[Any] = [ImportMap]
    for struct in known:  # grows while it is read
        out += ["", f"## {struct.__name__}", "", _escape(_summary(struct)), ""]
        out += ["| key | type | default | meaning |", "|---|---|---|---|"]
        meanings = key_meanings(struct)
        for field in msgspec.structs.fields(struct):
            name = field.encode_name
            default = "required" if field.required else _default(field.default)
            meaning = _escape(meanings[name])
            out.append(f"| `{name}` | {_type_words(field.type, known)} | {default} | {meaning} |")
    return "\n".join([*out, ""])


def key_meanings(struct: Any) -> dict[str, str]:
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


def _summary(struct: Any) -> str:
    return (inspect.getdoc(struct) or "").partition("Keys:\n")[0].strip()


def _type_words(kind: Any, known: list[Any]) -> str:
    """Return a type in words; may append a structure to `known`."""
    origin, inner = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        return " or ".join(_type_words(part, known) for part in inner if part is not NoneType)
    if origin is Literal:
        return ", ".join(f"`{value}`" for value in inner)
    if origin in (Annotated, list, dict):
        words = {Annotated: "", list: "list of ", dict: "names with "}[origin]
        return words + _type_words(inner[origin is dict], known)
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        if kind not in known:
            known.append(kind)
        return f"[{kind.__name__}](#{kind.__name__.lower()})"
    return {str: "text", int: "whole number", float: "number"}[kind]


def _default(value: Any) -> str:
    is_plain = isinstance(value, str | int | float)
    return f"`{value}`" if is_plain else ""


def _escape(text: str) -> str:
    """Keep what Markdown would swallow, outside of code."""
    parts = " ".join(text.split()).split("`")
    for at in range(0, len(parts), 2):
        parts[at] = re.sub(r"([<>*_|])", r"\\\1", parts[at])
    return "`".join(parts)
