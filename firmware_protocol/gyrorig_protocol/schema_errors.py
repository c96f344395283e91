"""Schema errors: where a document does not match its structure, in terms of its keys.

    rig.yaml: ptu: baud is 115201. Give one of 600, 1200, 2400, ...
    rig.yaml: boards, entry 2 has the unknown key 'prot'. Did you mean port? The valid keys are ...

What to use when: `find_schema_error` after msgspec has rejected a value. msgspec decides whether
a value is valid; this module finds the place and the values allowed there.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from msgspec import inspect

from gyrorig_protocol.errors import sentence
from gyrorig_protocol.suggestions import closest_words

MAX_VALUE_CHARS = 40  # of a document's value in an error
MAX_CHOICES_CHARS = 400  # of the list of keys or values in a remedy

Location = tuple[str | int, ...]  # keys, and the numbers of list entries from 1


@dataclass(frozen=True, slots=True)
class SchemaError:
    """One place of a document with a wrong key or value."""

    location: str  # "boards, entry 2: facts: odr_hz"; "" for the document itself
    problem: str  # "is 0"
    remedy: str  # "give a number above 0"


def find_schema_error(value: object, kind: object) -> SchemaError | None:
    """Return the first schema error in `value`, None if there is none.

    Args:
        value: the document's value.
        kind: the structure that it should have.
    """
    return _check(value, inspect.type_info(kind), ())


def find_expected_schema(kind: object) -> str | None:
    """Return the only value of the structure's key `schema`, None if it has no such key."""
    info = inspect.type_info(kind)
    fields = info.fields if isinstance(info, inspect.StructType) else ()
    for field in fields:
        if field.encode_name == "schema" and isinstance(field.type, inspect.LiteralType):
            return str(field.type.values[0])
    return None


def _check(value: object, info: inspect.Type, location: Location) -> SchemaError | None:
    match info:
        case inspect.StructType():
            return _check_structure(value, info, location)
        case inspect.UnionType():
            return _check_union(value, info, location)
        case inspect.ListType() | inspect.VarTupleType():
            return _check_list(value, info, location)
        case inspect.DictType():
            return _check_mapping(value, info, location)
    return None if _is_valid_scalar(value, info) else _value_error(value, info, location)


def _check_structure(
    value: object, info: inspect.StructType, location: Location
) -> SchemaError | None:
    fields = {field.encode_name: field for field in info.fields}
    if not isinstance(value, dict):
        return _value_error(value, info, location)
    for key, item in value.items():
        if not isinstance(key, str):
            return SchemaError(
                _location_text(location),
                f"has {_value_text(key)} as a key",
                _known_keys_text(fields),
            )
        if key in fields:
            error = _check(item, fields[key].type, (*location, key))
            if error is not None:
                return error
        elif info.forbid_unknown_fields:
            unused_keys = [name for name in fields if name not in value]
            return _unknown_key_error(key, unused_keys, list(fields), location)
    for name, field in fields.items():
        if field.required and name not in value:
            return SchemaError(
                _location_text(location),
                f"lacks the key {name}",
                f"add the key with {_expected_text(field.type)}",
            )
    return None


def _unknown_key_error(
    key: str, unused_keys: list[str], known_keys: list[str], location: Location
) -> SchemaError:
    shown_key = key[:MAX_VALUE_CHARS]
    similar_keys = closest_words(shown_key, unused_keys, 1) or closest_words(
        shown_key, known_keys, 1
    )
    remedy = _known_keys_text(known_keys)
    if similar_keys:
        remedy = f"did you mean {similar_keys[0]}? {sentence(remedy)}"
    return SchemaError(_location_text(location), f"has the unknown key {shown_key!r}", remedy)


def _check_union(value: object, info: inspect.UnionType, location: Location) -> SchemaError | None:
    choices = [choice for choice in info.types if not isinstance(choice, inspect.NoneType)]
    if value is None and len(choices) < len(info.types):
        return None
    errors = [_check(value, choice, location) for choice in choices]
    if None in errors:
        return None
    return errors[0] if len(errors) == 1 else _value_error(value, info, location)


def _check_list(
    value: object, info: inspect.ListType | inspect.VarTupleType, location: Location
) -> SchemaError | None:
    if not isinstance(value, list) or not _is_length_allowed(
        len(value), info.min_length, info.max_length
    ):
        return _value_error(value, info, location)
    errors = (
        _check(item, info.item_type, (*location, number)) for number, item in enumerate(value, 1)
    )
    return next((error for error in errors if error is not None), None)


def _check_mapping(value: object, info: inspect.DictType, location: Location) -> SchemaError | None:
    if not isinstance(value, dict) or not _is_length_allowed(
        len(value), info.min_length, info.max_length
    ):
        return _value_error(value, info, location)
    for key, item in value.items():
        error = _check(key, info.key_type, location) or _check(
            item, info.value_type, (*location, str(key))
        )
        if error is not None:
            return error
    return None


def _is_valid_scalar(value: object, info: inspect.Type) -> bool:
    """Return whether a scalar is valid; True for types that are not known here."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    match info:
        case inspect.BoolType():
            return isinstance(value, bool)
        case inspect.NoneType():
            return value is None
        case inspect.LiteralType():
            return any(type(allowed) is type(value) and allowed == value for allowed in info.values)
        case inspect.StrType():
            return (
                isinstance(value, str)
                and _is_length_allowed(len(value), info.min_length, info.max_length)
                and (info.pattern is None or re.search(info.pattern, value) is not None)
            )
        case inspect.IntType() | inspect.FloatType():
            return (
                is_number
                and (isinstance(value, int) or isinstance(info, inspect.FloatType))
                and _is_in_range(value, info)
            )
    return True


def _is_in_range(value: object, info: inspect.IntType | inspect.FloatType) -> bool:
    number = float(value)  # type: ignore[arg-type] # a number, as the caller knows
    return (
        (info.gt is None or number > info.gt)
        and (info.ge is None or number >= info.ge)
        and (info.lt is None or number < info.lt)
        and (info.le is None or number <= info.le)
    )


def _is_length_allowed(count: int, minimum: int | None, maximum: int | None) -> bool:
    return (minimum is None or count >= minimum) and (maximum is None or count <= maximum)


def _value_error(value: object, info: inspect.Type, location: Location) -> SchemaError:
    return SchemaError(
        _location_text(location), f"is {_value_text(value)}", f"give {_expected_text(info)}"
    )


def _location_text(location: Location) -> str:
    """Format a location: `boards, entry 2: facts: odr_hz`."""
    text = ""
    for part in location:
        if isinstance(part, int):
            text += f", entry {part}"
        else:
            text += f": {part[:MAX_VALUE_CHARS]}" if text else part[:MAX_VALUE_CHARS]
    return text.removeprefix(", ")


def _value_text(value: object) -> str:
    """Format a wrong value, shortened, so that it shows how it differs from a right one."""
    match value:
        case None:
            text = "empty"
        case bool():
            text = str(value).lower()
        case str():
            text = f"the text {value[:MAX_VALUE_CHARS]!r}" + (
                "..." if len(value) > MAX_VALUE_CHARS else ""
            )
        case list():
            text = f"a list of {len(value)}"
        case dict() if not value:
            text = "without entries"
        case dict():
            text = "keys with values"
        case _:
            text = repr(value)
    return text


def _expected_text(info: inspect.Type) -> str:
    """Describe the values that are allowed."""
    match info:
        case inspect.StructType():
            text = (
                f"keys with values: {_join_shortened([field.encode_name for field in info.fields])}"
            )
        case inspect.DictType():
            text = "names with values"
        case inspect.ListType() | inspect.VarTupleType():
            count_text = _count_text(info.min_length, info.max_length, "entries")
            text = f"a list{count_text}, each {_expected_text(info.item_type)}"
        case inspect.UnionType():
            choices = [choice for choice in info.types if not isinstance(choice, inspect.NoneType)]
            optional_text = ", or leave it out" if len(choices) < len(info.types) else ""
            text = " or ".join(map(_expected_text, choices)) + optional_text
        case inspect.LiteralType():
            prefix = "one of " if len(info.values) > 1 else ""
            text = prefix + _join_shortened([str(choice) for choice in info.values])
        case inspect.BoolType():
            text = "true or false"
        case inspect.IntType():
            text = f"a whole number{_range_text(info)}"
        case inspect.FloatType():
            text = f"a number{_range_text(info)}"
        case inspect.StrType():
            pattern_text = "" if info.pattern is None else f" of the form {info.pattern}"
            text = (
                f"a text{_count_text(info.min_length, info.max_length, 'characters')}{pattern_text}"
            )
        case _:
            text = "another value"
    return text


def _range_text(info: inspect.IntType | inspect.FloatType) -> str:
    words = [
        f"{word} {bound:g}" if isinstance(bound, float) else f"{word} {bound}"
        for word, bound in (
            ("above", info.gt),
            ("from", info.ge),
            ("below", info.lt),
            ("to" if info.ge is not None else "up to", info.le),
        )
        if bound is not None
    ]
    suffix = " on" if info.ge is not None and info.le is None and info.lt is None else ""
    return f" {' '.join(words)}{suffix}" if words else ""


def _count_text(minimum: int | None, maximum: int | None, noun: str) -> str:
    if minimum is not None and minimum == maximum:
        return f" of {minimum} {noun}"
    if minimum and maximum is not None:
        return f" of {minimum} to {maximum} {noun}"
    if minimum:
        return f" of {minimum} {noun} or more"
    return "" if maximum is None else f" of at most {maximum} {noun}"


def _known_keys_text(known_keys: Iterable[str]) -> str:
    return f"the valid keys are {_join_shortened(list(known_keys))}"


def _join_shortened(words: Sequence[str]) -> str:
    text = ", ".join(words)
    if len(text) <= MAX_CHOICES_CHARS:
        return text
    return f"{text[:MAX_CHOICES_CHARS].rpartition(',')[0]}, ..."
