"""What is wrong in a document, in the words of the person who wrote it.

    rig.yaml: ptu: baud is 115201: give one of 600, 1200, 2400, ...
    rig.yaml: boards, entry 2 has the unknown key 'prot': did you mean port? the keys there are ...

What to use when: `first_misfit` once msgspec has refused a value: msgspec decides what fits,
this says where it does not, and what does. Where it finds nothing it says nothing.
"""

import difflib
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from msgspec import inspect

MAX_SHOWN = 40  # characters of what stands in the document
MAX_CHOICES = 400  # characters of keys or values that a remedy lists

Place = tuple[str | int, ...]  # keys, and entries of lists from 1


@dataclass(frozen=True, slots=True)
class Misfit:
    """One place of a document that does not hold what belongs there."""

    place: str  # "boards, entry 2: facts: odr_hz"; "" for the document itself
    what: str  # "is 0"
    remedy: str  # "give a number above 0"


def first_misfit(value: object, kind: object) -> Misfit | None:
    """Return what first does not fit in `value`, None where nothing is found.

    Args:
        value: what the document holds.
        kind: the structure that it should be.
    """
    return _look(value, inspect.type_info(kind), ())


def _look(value: object, info: inspect.Type, place: Place) -> Misfit | None:
    match info:
        case inspect.StructType():
            return _in_structure(value, info, place)
        case inspect.UnionType():
            return _in_union(value, info, place)
        case inspect.ListType() | inspect.VarTupleType():
            return _in_list(value, info, place)
        case inspect.DictType():
            return _in_mapping(value, info, place)
    return None if _fits(value, info) else _wrong(value, info, place)


def _in_structure(value: object, info: inspect.StructType, place: Place) -> Misfit | None:
    fields = {field.encode_name: field for field in info.fields}
    if not isinstance(value, dict):
        return _wrong(value, info, place)
    for key, item in value.items():
        if not isinstance(key, str):
            return Misfit(_said(place), f"has {_shown(key)} for a key", _keys(fields))
        if key in fields:
            found = _look(item, fields[key].type, (*place, key))
            if found is not None:
                return found
        elif info.forbid_unknown_fields:
            free = [name for name in fields if name not in value]
            return _unknown(key, free, list(fields), place)
    for name, field in fields.items():
        if field.required and name not in value:
            return Misfit(_said(place), f"lacks the key {name}", f"give it {_wanted(field.type)}")
    return None


def _unknown(key: str, free: list[str], known: list[str], place: Place) -> Misfit:
    shown = key[:MAX_SHOWN]
    near = difflib.get_close_matches(shown, free, 1) or difflib.get_close_matches(shown, known, 1)
    hint = f"did you mean {near[0]}? " if near else ""
    return Misfit(_said(place), f"has the unknown key {shown!r}", hint + _keys(known))


def _in_union(value: object, info: inspect.UnionType, place: Place) -> Misfit | None:
    choices = [one for one in info.types if not isinstance(one, inspect.NoneType)]
    if value is None and len(choices) < len(info.types):
        return None
    found = [_look(value, one, place) for one in choices]
    if None in found:
        return None
    return found[0] if len(found) == 1 else _wrong(value, info, place)


def _in_list(
    value: object, info: inspect.ListType | inspect.VarTupleType, place: Place
) -> Misfit | None:
    if not isinstance(value, list) or not _in_bounds(len(value), info.min_length, info.max_length):
        return _wrong(value, info, place)
    looked = (_look(item, info.item_type, (*place, k)) for k, item in enumerate(value, 1))
    return next((one for one in looked if one is not None), None)


def _in_mapping(value: object, info: inspect.DictType, place: Place) -> Misfit | None:
    if not isinstance(value, dict) or not _in_bounds(len(value), info.min_length, info.max_length):
        return _wrong(value, info, place)
    for key, item in value.items():
        found = _look(key, info.key_type, place) or _look(item, info.value_type, (*place, str(key)))
        if found is not None:
            return found
    return None


def _fits(value: object, info: inspect.Type) -> bool:
    """Return whether a value without parts is of a kind; of what is not known here, True."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    match info:
        case inspect.BoolType():
            return isinstance(value, bool)
        case inspect.NoneType():
            return value is None
        case inspect.LiteralType():
            return any(type(one) is type(value) and one == value for one in info.values)
        case inspect.StrType():
            return (
                isinstance(value, str)
                and _in_bounds(len(value), info.min_length, info.max_length)
                and (info.pattern is None or re.search(info.pattern, value) is not None)
            )
        case inspect.IntType() | inspect.FloatType():
            return (
                is_number
                and (isinstance(value, int) or isinstance(info, inspect.FloatType))
                and _is_between(value, info)
            )
    return True


def _is_between(value: object, info: inspect.IntType | inspect.FloatType) -> bool:
    number = float(value)  # type: ignore[arg-type] # a number, as the caller knows
    return (
        (info.gt is None or number > info.gt)
        and (info.ge is None or number >= info.ge)
        and (info.lt is None or number < info.lt)
        and (info.le is None or number <= info.le)
    )


def _in_bounds(count: int, least: int | None, most: int | None) -> bool:
    return (least is None or count >= least) and (most is None or count <= most)


def _wrong(value: object, info: inspect.Type, place: Place) -> Misfit:
    return Misfit(_said(place), f"is {_shown(value)}", f"give {_wanted(info)}")


def _said(place: Place) -> str:
    """Return a place: `boards, entry 2: facts: odr_hz`."""
    text = ""
    for piece in place:
        if isinstance(piece, int):
            text += f", entry {piece}"
        else:
            text += f": {piece[:MAX_SHOWN]}" if text else piece[:MAX_SHOWN]
    return text.removeprefix(", ")


def _shown(value: object) -> str:
    """Return what stands there, cut short, and told apart from what would be right."""
    match value:
        case None:
            said = "empty"
        case bool():
            said = str(value).lower()
        case str():
            said = f"the text {value[:MAX_SHOWN]!r}" + ("..." if len(value) > MAX_SHOWN else "")
        case list():
            said = f"a list of {len(value)}"
        case dict():
            said = "keys with values"
        case _:
            said = repr(value)
    return said


def _wanted(info: inspect.Type) -> str:
    """Return what belongs at a place."""
    match info:
        case inspect.StructType():
            said = f"keys with values: {_listed([field.encode_name for field in info.fields])}"
        case inspect.DictType():
            said = "names with values"
        case inspect.ListType() | inspect.VarTupleType():
            many = _count(info.min_length, info.max_length, "entries")
            said = f"a list{many}, each {_wanted(info.item_type)}"
        case inspect.UnionType():
            choices = [one for one in info.types if not isinstance(one, inspect.NoneType)]
            left_out = ", or leave it out" if len(choices) < len(info.types) else ""
            said = " or ".join(map(_wanted, choices)) + left_out
        case inspect.LiteralType():
            several = "one of " if len(info.values) > 1 else ""
            said = several + _listed([str(one) for one in info.values])
        case inspect.BoolType():
            said = "true or false"
        case inspect.IntType():
            said = f"a whole number{_range(info)}"
        case inspect.FloatType():
            said = f"a number{_range(info)}"
        case inspect.StrType():
            form = "" if info.pattern is None else f" of the form {info.pattern}"
            said = f"a text{_count(info.min_length, info.max_length, 'characters')}{form}"
        case _:
            said = "another value"
    return said


def _range(info: inspect.IntType | inspect.FloatType) -> str:
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
    more = " on" if info.ge is not None and info.le is None and info.lt is None else ""
    return f" {' '.join(words)}{more}" if words else ""


def _count(least: int | None, most: int | None, of: str) -> str:
    if least is not None and least == most:
        return f" of {least} {of}"
    if least and most is not None:
        return f" of {least} to {most} {of}"
    if least:
        return f" of {least} {of} or more"
    return "" if most is None else f" of at most {most} {of}"


def _keys(known: Iterable[str]) -> str:
    return f"the keys there are {_listed(list(known))}"


def _listed(words: Sequence[str]) -> str:
    text = ", ".join(words)
    return text if len(text) <= MAX_CHOICES else f"{text[:MAX_CHOICES].rpartition(',')[0]}, ..."
