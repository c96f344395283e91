"""YAML documents: hostile text in, plain values out; and plain YAML out.

What to use when: `parse_yaml` for any document that a person or another program
wrote; `read_as` to turn its values into a typed structure with unknown keys and wrong
types refused; `dump_yaml` for every document that this project writes.
"""

import datetime
import math
import re
from collections.abc import Mapping
from typing import Any, TypeVar

import msgspec
import yaml

from gyrorig_protocol.errors import GyrorigError, InputError, UsageError

T = TypeVar("T")

MAX_DOCUMENT_BYTES = 4_000_000
MAX_DEPTH = 20
MAX_INTEGER_BITS = 64

# Octal by a leading zero, base 60, underscores and the merge key: in YAML 1.1, not in 1.2.
_TWO_MEANINGS = re.compile(
    r"[-+]?(?:0[0-9_]+|[0-9][0-9_]*(?::[0-5]?[0-9])+(?:\.[0-9_]*)?|[0-9]+_[0-9_]*(?:\.[0-9_]*)?)|<<"
)

_Loader: type[Any] = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_Dumper: type[Any] = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


def parse_yaml(text: str | bytes, name: str, error: type[GyrorigError] = UsageError) -> Any:
    """Return the value of one YAML document.

    Refused are: aliases, tags, several documents, more than 20 levels, more than 4 MB,
    a key twice in one mapping, dates, numbers that are not finite or need more than 64
    bits, and what YAML 1.1 and 1.2 read differently: `010` (8 or 10), `1:30` (90 or a
    text), `1_000`, merge keys.

    PyYAML's safe loader expands aliases without a limit: a bomb of 306 bytes has 3.9e8
    leaves. A tag can make it raise what is no YAML error, and `1:1:1...` takes it a time
    that grows with the square of the length.

    Args:
        text: the document.
        name: what to call it in an error, usually its file name.
        error: the class raised, by who must act.

    Raises:
        GyrorigError: of the given class; the text is not such a document.
    """
    if len(text) > MAX_DOCUMENT_BYTES:
        raise error(
            f"{name} is larger than {MAX_DOCUMENT_BYTES // 1_000_000} MB",
            "no document of this project is: name the right file",
        )
    try:
        objection = _objection_to_text(text)
        value = None if objection else _construct(text)
    except _RepeatedKeyError as fault:
        objection = (f"has the key {fault} twice", "write it once")
    except (yaml.YAMLError, ValueError, OverflowError, RecursionError) as fault:
        raise error(f"{name} is not a YAML document{_where(fault)}", _said(fault)) from fault
    objection = objection or _objection_to_value(value)
    if objection:
        what, remedy = objection
        raise error(f"{name} {what}", remedy)
    return value


def read_as(value: object, kind: type[T], name: str, error: type[GyrorigError] = UsageError) -> T:
    """Return `value` as a `kind`, a msgspec structure with `forbid_unknown_fields`.

    Raises:
        GyrorigError: of the given class; a key is unknown or missing, or a type is wrong.
            The text names the place, as in `rig.yaml: ptu: baud`, and what belongs there.
    """
    if value is None or isinstance(value, str | int | float | list):
        raise error(
            f"{name} holds no keys with values, `key: value`",
            "name the right file, or see config/ and the documentation for examples",
        )
    try:
        return msgspec.convert(value, type=kind, strict=True)
    except (msgspec.ValidationError, ValueError) as fault:
        from gyrorig_protocol.misfits import first_misfit  # noqa: PLC0415 - msgspec.inspect, seldom

        found = first_misfit(value, kind)
        if found is None:
            raise error(name, _one_line(fault)) from fault
        place = f"{name}: {found.place}" if found.place else name
        raise error(f"{place} {found.what}", found.remedy) from fault


def parse_schema(text: str | bytes, name: str, kind: type[T], schema: str, what: str) -> T:
    """Return the result document that hostile YAML holds.

    Args:
        text: the document.
        name: what to call it in an error, usually its file name.
        kind: a msgspec structure with `forbid_unknown_fields`.
        schema: what its key `schema` has to say.
        what: such a document in an error: "is no calibration".

    Raises:
        InputError: it is not YAML, of another schema, or does not keep the contract.
    """
    value = parse_yaml(text, name, InputError)
    found = value.get("schema") if isinstance(value, dict) else None
    if found != schema:
        said = "it has no key schema" if found is None else f"its schema is {str(found)[:40]!r}"
        raise InputError(f"{name} {what}: {said}", f"name one whose schema is {schema!r}")
    return read_as(value, kind, name, InputError)


def dump_yaml(document: Mapping[str, Any]) -> str:
    """Return `document` as YAML that version 1.1 and 1.2 readers take alike.

    Strings are quoted, floats have a point, lists of numbers stand on one line, mappings
    keep their order, and there are no aliases and no tags.

    Raises:
        TypeError: a value is neither a mapping, sequence, string, number, bool nor None.
    """
    return str(
        yaml.dump(
            _plain(document), Dumper=_PlainDumper, sort_keys=False, width=1000, allow_unicode=True
        )
    )


class _RepeatedKeyError(Exception):
    """A mapping has a key twice; the text is the key."""


def _one_line(fault: Exception) -> str:
    """Return what a library says, without line ends and without end."""
    return " ".join(str(fault).split())[:200]


def _where(fault: Exception) -> str:
    """Return the place in a text that a parser stopped at, where it knows one."""
    mark = fault.problem_mark if isinstance(fault, yaml.MarkedYAMLError) else None
    return "" if mark is None else f", line {mark.line + 1}, column {mark.column + 1}"


def _said(fault: Exception) -> str:
    """Return what a parser says is wrong, without its own name for the text."""
    if not isinstance(fault, yaml.MarkedYAMLError):
        return _one_line(fault)
    begun = ""
    if fault.context and fault.context_mark is not None:
        begun = f" {fault.context} that begins in line {fault.context_mark.line + 1}"
    return _one_line(Exception(f"{fault.problem}{begun}; mend it there"))


def _objection_to_text(text: str | bytes) -> tuple[str, str] | None:
    """Return why a document is not even to be constructed, and what to do about it."""
    depth = 0
    for event in yaml.parse(text, Loader=_Loader):
        if isinstance(event, yaml.AliasEvent):
            return "uses a YAML alias", "write the value out"
        tag = getattr(event, "tag", None)
        if tag is not None:
            return f"uses the YAML tag {tag[:40]}", "write the value without it"
        if isinstance(event, yaml.ScalarEvent) and event.implicit[0]:
            if _TWO_MEANINGS.fullmatch(event.value):
                return (
                    f"holds {event.value[:40]}, which YAML 1.1 and 1.2 read differently",
                    "write it in full as a plain decimal number, or put it in quotes",
                )
        elif isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        if depth > MAX_DEPTH:
            return f"is nested deeper than {MAX_DEPTH} levels", "take levels out"
    return None


def _construct(text: str | bytes) -> Any:
    """Return the value of a document; raises `_RepeatedKeyError`."""
    loader = _Loader(text)
    try:
        node = loader.get_single_node()
        _refuse_repeated_keys(node)
        return None if node is None else loader.construct_document(node)
    finally:
        loader.dispose()


def _refuse_repeated_keys(node: yaml.Node | None) -> None:
    if isinstance(node, yaml.SequenceNode):
        for item in node.value:
            _refuse_repeated_keys(item)
    elif isinstance(node, yaml.MappingNode):
        seen = set()
        for key, item in node.value:
            if isinstance(key, yaml.ScalarNode):
                if (key.tag, key.value) in seen:
                    raise _RepeatedKeyError(_one_line(Exception(key.value))[:40])
                seen.add((key.tag, key.value))
            _refuse_repeated_keys(item)


def _objection_to_value(value: object) -> tuple[str, str] | None:
    """Return why a constructed value is refused, and what to do about it."""
    if isinstance(value, dict):
        inner = (_objection_to_value(part) for item in value.items() for part in item)
        return next((objection for objection in inner if objection), None)
    if isinstance(value, list):
        return next(filter(None, map(_objection_to_value, value)), None)
    if isinstance(value, float) and not math.isfinite(value):
        return f"holds {value}", "write a finite number"
    if isinstance(value, int) and value.bit_length() > MAX_INTEGER_BITS:
        return f"holds an integer of {value.bit_length()} bits", "write a smaller one"
    if isinstance(value, datetime.date):
        return f"holds the date {value}", "put it in quotes"
    return None


class _Row(list[Any]):
    """A list of numbers: written on one line, as a person reads a vector."""


class _Quoted(str):
    """A string that is written in quotes."""


class _PlainDumper(_Dumper):  # type: ignore[misc] # PyYAML's C dumper has no stub
    def ignore_aliases(self, data: object) -> bool:
        return True


def _quoted(dumper: Any, text: _Quoted) -> Any:
    return dumper.represent_scalar("tag:yaml.org,2002:str", str(text), style='"')


def _float(dumper: Any, number: float) -> Any:
    text = repr(number)
    if not math.isfinite(number):
        raise TypeError(f"{text} has no place in a document: use null")
    if "e" in text and "." not in text:
        text = text.replace("e", ".0e", 1)
    if "e" in text and "e-" not in text and "e+" not in text:
        text = text.replace("e", "e+", 1)
    return dumper.represent_scalar("tag:yaml.org,2002:float", text)


def _row(dumper: Any, row: "_Row") -> Any:
    return dumper.represent_sequence("tag:yaml.org,2002:seq", list(row), flow_style=True)


_PlainDumper.add_representer(_Row, _row)
_PlainDumper.add_representer(_Quoted, _quoted)
_PlainDumper.add_representer(float, _float)


def _plain(value: object) -> Any:
    """Return `value` made of the dumper's own kinds, keys as they are, strings quoted."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        items = [_plain(item) for item in value]
        numbers = all(item is None or isinstance(item, int | float) for item in items)
        return _Row(items) if numbers else items
    if isinstance(value, str):
        return _Quoted(value)
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, int | float):  # also enumerations and NumPy's float64
        return int(value) if isinstance(value, int) else float(value)
    raise TypeError(f"{type(value).__name__} has no place in a document")
