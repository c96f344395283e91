"""YAML parser and writer for untrusted documents.

What to use when: `parse_yaml` for any document that a person or another program wrote;
`convert_document` to convert its values to a typed structure, with unknown keys and wrong types
rejected; `parse_result_document` for both, when the key `schema` is required; `dump_yaml` for
every document that this project writes.
"""

import datetime
import math
import re
from collections.abc import Mapping
from typing import Any, TypeVar

import msgspec
import yaml

from gyrorig_protocol.errors import GyrorigError, InputError, UsageError
from gyrorig_protocol.file_kinds import (
    CSV_TABLE,
    EMPTY_FILE,
    HEAD_BYTES,
    NEVER_YAML,
    describe_file_kind,
    explain_wrong_kind,
    explain_wrong_schema,
)

T = TypeVar("T")
Part = TypeVar("Part", bound=msgspec.Struct)

MAX_DOCUMENT_BYTES = 4_000_000
MAX_DEPTH = 20
MAX_INTEGER_BITS = 64

# Octal by a leading zero, base 60, underscores and the merge key are in YAML 1.1, not in 1.2.
_VERSION_DEPENDENT_SCALAR = re.compile(
    r"[-+]?(?:0[0-9_]+|[0-9][0-9_]*(?::[0-5]?[0-9])+(?:\.[0-9_]*)?|[0-9]+_[0-9_]*(?:\.[0-9_]*)?)|<<"
)

_Loader: type[Any] = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_Dumper: type[Any] = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


def parse_yaml(
    text: str | bytes, name: str, error: type[GyrorigError] = UsageError, schema: str = ""
) -> Any:
    """Parse one YAML document and return its value.

    These are rejected: aliases, tags, several documents, more than 20 levels, more than 4 MB,
    a key twice in one mapping, dates, numbers that are not finite or need more than 64 bits,
    and values that YAML 1.1 and 1.2 read differently: `010` (8 or 10), `1:30` (90 or a text),
    `1_000`, merge keys.

    Reason: PyYAML's safe loader expands aliases without a limit; a document of 306 bytes
    can have 3.9e8 leaves. A tag can make it raise an error that is not a YAML error. The time
    for `1:1:1...` grows with the square of its length.

    Args:
        text: the document.
        name: the document's name in an error, usually its file name.
        error: the class of error to raise, by who must act.
        schema: the expected schema, to name the expected kind if the file is no YAML document.

    Raises:
        GyrorigError: of the given class; the text is not such a document.
    """
    head = text[:HEAD_BYTES]
    kind = describe_file_kind(head.encode(errors="replace") if isinstance(head, str) else head)
    is_too_large = len(text) > MAX_DOCUMENT_BYTES
    # Only a text that is no YAML mapping is certain to be a table.
    is_table = kind == CSV_TABLE and is_too_large
    if kind in NEVER_YAML or is_table or (schema and kind == EMPTY_FILE):
        raise error(*explain_wrong_kind(name, kind, schema))
    if is_too_large:
        raise error(
            f"{name} is larger than {MAX_DOCUMENT_BYTES // 1_000_000} MB, the largest document "
            "that can be read",
            "give the right file",
        )
    try:
        rejection = _find_unsupported_syntax(text)
        value = None if rejection else _construct_value(text)
    except _RepeatedKeyError as fault:
        rejection = (f"has the key {fault} twice", "write the key once")
    except (yaml.YAMLError, ValueError, OverflowError, RecursionError) as fault:
        if kind == CSV_TABLE:
            raise error(*explain_wrong_kind(name, kind, schema)) from fault
        raise error(
            f"{name} is not a YAML document{_error_position(fault)} ({_parser_message(fault)})",
            "correct the document, or give another file",
        ) from fault
    if kind == CSV_TABLE and isinstance(value, str):
        raise error(*explain_wrong_kind(name, kind, schema))
    rejection = rejection or _find_unsupported_value(value)
    if rejection:
        problem, remedy = rejection
        raise error(f"{name} {problem}", remedy)
    return value


def convert_document(
    value: object, kind: type[T], name: str, error: type[GyrorigError] = UsageError
) -> T:
    """Convert `value` to a `kind`, a msgspec structure with `forbid_unknown_fields`.

    Raises:
        GyrorigError: of the given class; a key is unknown or missing, or a type is wrong. The
            text names the place, as in `rig.yaml: ptu: baud`, and the values allowed there.
    """
    if value is None or isinstance(value, str | int | float | list):
        raise error(
            f"{name} is not a valid document, because it has no lines of the form `key: value`",
            "give a YAML document, such as the examples in the folder config/",
        )
    try:
        return msgspec.convert(value, type=kind, strict=True)
    except (msgspec.ValidationError, ValueError) as fault:
        from gyrorig_protocol import schema_errors  # noqa: PLC0415 - msgspec.inspect, seldom

        expected = schema_errors.find_expected_schema(kind)
        if isinstance(value, dict) and expected is not None and "schema" in value:
            wrong_schema = explain_wrong_schema(name, value["schema"], expected)
            if wrong_schema is not None:
                raise error(*wrong_schema) from fault
        schema_error = schema_errors.find_schema_error(value, kind)
        if schema_error is None:
            raise error(
                f"the document {name} is not valid ({_single_line(fault)})", "correct the document"
            ) from fault
        location = f"{name}: {schema_error.location}" if schema_error.location else name
        raise error(f"{location} {schema_error.problem}", schema_error.remedy) from fault


def parse_result_document(text: str | bytes, name: str, kind: type[T], schema: str) -> T:
    """Parse a document whose key `schema` is required, such as a calibration.

    Args:
        text: the document.
        name: the document's name in an error, usually its file name.
        kind: a msgspec structure with `forbid_unknown_fields`.
        schema: the required value of the key `schema`.

    Raises:
        InputError: it is not YAML, has another schema, or does not follow the schema.
    """
    value = parse_yaml(text, name, InputError, schema)
    found_schema = value.get("schema") if isinstance(value, dict) else None
    wrong_schema = explain_wrong_schema(name, found_schema, schema)
    if wrong_schema is not None:
        raise InputError(*wrong_schema)
    return convert_document(value, kind, name, InputError)


def dump_yaml(document: Mapping[str, Any]) -> str:
    """Format `document` as YAML that readers of version 1.1 and of 1.2 read in the same way.

    Strings are quoted, floats have a point, lists of numbers are on one line, mappings keep
    their order, and there are no aliases and no tags.

    Raises:
        TypeError: a value is neither a mapping, sequence, string, number, bool nor None.
    """
    return str(
        yaml.dump(
            _to_plain_types(document),
            Dumper=_PlainDumper,
            sort_keys=False,
            width=1000,
            allow_unicode=True,
        )
    )


def finite_values(value: Any) -> Any:
    """Return numbers, sequences, arrays or mappings with None for each number that is not finite.

    Sequences and arrays become lists; -0.0 becomes 0.0.
    """
    if isinstance(value, Mapping):
        return {key: finite_values(item) for key, item in value.items()}
    if isinstance(value, float):
        return float(value) + 0.0 if math.isfinite(value) else None
    if isinstance(value, list | tuple):
        return [finite_values(item) for item in value]
    return finite_values(value.tolist()) if hasattr(value, "tolist") else value


def document_part(kind: type[Part], result: object, **others: Any) -> Part:
    """Return a part of a document from the attributes of a result that have the same names.

    Args:
        kind: a msgspec struct. A field that the result does not have keeps its default.
        result: its numbers that are not finite become None.
        others: fields with other names or units in the result.

    Raises:
        TypeError: a field without a default is missing.
    """
    names = [field.name for field in msgspec.structs.fields(kind)]
    same = {name: getattr(result, name) for name in names if hasattr(result, name)}
    return kind(**finite_values({**same, **others}))


class _RepeatedKeyError(Exception):
    """A mapping has a key twice; the text is the key."""


def _single_line(fault: Exception) -> str:
    """Return a library's message on one line, cut to 200 characters."""
    return " ".join(str(fault).split())[:200]


def _error_position(fault: Exception) -> str:
    mark = fault.problem_mark if isinstance(fault, yaml.MarkedYAMLError) else None
    return "" if mark is None else f", line {mark.line + 1}, column {mark.column + 1}"


def _parser_message(fault: Exception) -> str:
    """Return a parser's message without its own name for the text."""
    if not isinstance(fault, yaml.MarkedYAMLError):
        return _single_line(fault)
    context = ""
    if fault.context and fault.context_mark is not None:
        context = f" {fault.context} that begins in line {fault.context_mark.line + 1}"
    return _single_line(Exception(f"{fault.problem}{context}"))


def _find_unsupported_syntax(text: str | bytes) -> tuple[str, str] | None:
    """Return why a document is rejected before it is constructed, and the remedy."""
    depth = 0
    for event in yaml.parse(text, Loader=_Loader):
        if isinstance(event, yaml.AliasEvent):
            return "uses a YAML alias, which is not supported", (
                "write the value itself in place of the alias"
            )
        tag = getattr(event, "tag", None)
        if tag is not None:
            return f"uses the YAML tag {tag[:40]}, which is not supported", (
                "write the value without the tag"
            )
        if isinstance(event, yaml.ScalarEvent) and event.implicit[0]:
            if _VERSION_DEPENDENT_SCALAR.fullmatch(event.value):
                return (
                    f"contains the value {event.value[:40]}, which YAML 1.1 and YAML 1.2 "
                    "read differently",
                    "write the value as a plain decimal number, or put it in quotes",
                )
        elif isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        if depth > MAX_DEPTH:
            return f"has more than {MAX_DEPTH} levels of nested keys", "reduce the number of levels"
    return None


def _construct_value(text: str | bytes) -> Any:
    loader = _Loader(text)
    try:
        node = loader.get_single_node()
        _reject_repeated_keys(node)
        return None if node is None else loader.construct_document(node)
    finally:
        loader.dispose()


def _reject_repeated_keys(node: yaml.Node | None) -> None:
    if isinstance(node, yaml.SequenceNode):
        for item in node.value:
            _reject_repeated_keys(item)
    elif isinstance(node, yaml.MappingNode):
        seen_keys = set()
        for key, item in node.value:
            if isinstance(key, yaml.ScalarNode):
                if (key.tag, key.value) in seen_keys:
                    raise _RepeatedKeyError(_single_line(Exception(key.value))[:40])
                seen_keys.add((key.tag, key.value))
            _reject_repeated_keys(item)


def _find_unsupported_value(value: object) -> tuple[str, str] | None:
    """Return why a constructed value is rejected, and the remedy."""
    if isinstance(value, dict):
        rejections = (_find_unsupported_value(part) for item in value.items() for part in item)
        return next((rejection for rejection in rejections if rejection), None)
    if isinstance(value, list):
        return next(filter(None, map(_find_unsupported_value, value)), None)
    if isinstance(value, float) and not math.isfinite(value):
        return f"contains the value {value}, which is not a finite number", "write a finite number"
    if isinstance(value, int) and value.bit_length() > MAX_INTEGER_BITS:
        return (
            f"contains an integer of {value.bit_length()} bits, which is too large",
            "write a smaller number",
        )
    if isinstance(value, datetime.date):
        return f"contains the date {value}, but dates are not supported", ("put the date in quotes")
    return None


class _NumberList(list[Any]):
    """A list of numbers, written on one line."""


class _QuotedString(str):
    """A string, written in quotes."""


class _PlainDumper(_Dumper):  # type: ignore[misc] # PyYAML's C dumper has no stub
    def ignore_aliases(self, data: object) -> bool:
        return True


def _represent_string(dumper: Any, text: _QuotedString) -> Any:
    return dumper.represent_scalar("tag:yaml.org,2002:str", str(text), style='"')


def _represent_float(dumper: Any, number: float) -> Any:
    text = repr(number)
    if not math.isfinite(number):
        raise TypeError(f"{text} cannot be written to a document; use null")
    if "e" in text and "." not in text:
        text = text.replace("e", ".0e", 1)
    if "e" in text and "e-" not in text and "e+" not in text:
        text = text.replace("e", "e+", 1)
    return dumper.represent_scalar("tag:yaml.org,2002:float", text)


def _represent_number_list(dumper: Any, numbers: "_NumberList") -> Any:
    return dumper.represent_sequence("tag:yaml.org,2002:seq", list(numbers), flow_style=True)


_PlainDumper.add_representer(_NumberList, _represent_number_list)
_PlainDumper.add_representer(_QuotedString, _represent_string)
_PlainDumper.add_representer(float, _represent_float)


def _to_plain_types(value: object) -> Any:
    """Convert `value` to the dumper's types: keys unquoted, strings quoted."""
    if isinstance(value, Mapping):
        return {str(key): _to_plain_types(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        items = [_to_plain_types(item) for item in value]
        is_numeric = all(item is None or isinstance(item, int | float) for item in items)
        return _NumberList(items) if is_numeric else items
    if isinstance(value, str):
        return _QuotedString(value)
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, int | float):  # also enumerations and NumPy's float64
        return int(value) if isinstance(value, int) else float(value)
    raise TypeError(f"{type(value).__name__} cannot be written to a document")
