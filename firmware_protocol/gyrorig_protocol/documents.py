"""YAML documents: hostile text in, plain values out; and plain YAML out.

What to use when: `parse_yaml` for any document that a person or another program
wrote; `read_as` to turn its values into a typed structure with unknown keys and wrong
types refused; `dump_yaml` for every document that this project writes.
"""

import math
from collections.abc import Mapping
from typing import Any, TypeVar

import msgspec
import yaml

from gyrorig_protocol.errors import GyrorigError, UsageError

T = TypeVar("T")

MAX_DOCUMENT_BYTES = 4_000_000
MAX_DEPTH = 20

_Loader: type[Any] = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_Dumper: type[Any] = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


def parse_yaml(text: str | bytes, name: str, error: type[GyrorigError] = UsageError) -> Any:
    """Return the value of one YAML document.

    Aliases, tags, several documents, more than 20 levels and more than 4 MB are
    refused, and so are numbers that are not finite. PyYAML's safe loader expands
    aliases without a limit: a bomb of 306 bytes has 3.9e8 leaves.

    Args:
        text: the document.
        name: what to call it in an error, usually its file name.
        error: the class raised, by who must act.

    Raises:
        GyrorigError: of the given class; the text is not such a document.
    """
    if len(text) > MAX_DOCUMENT_BYTES:
        raise error(f"{name} is larger than {MAX_DOCUMENT_BYTES // 1_000_000} MB", "refused")
    try:
        depth = 0
        for event in yaml.parse(text, Loader=_Loader):
            if isinstance(event, yaml.AliasEvent):
                raise error(f"{name} uses a YAML alias", "write the value out")
            if isinstance(event, yaml.ScalarEvent) and _is_not_finite(event):
                raise error(f"{name} holds {event.value}", "write a finite number")
            if isinstance(event, yaml.CollectionStartEvent):
                depth += 1
            elif isinstance(event, yaml.CollectionEndEvent):
                depth -= 1
            if depth > MAX_DEPTH:
                raise error(f"{name} is nested deeper than {MAX_DEPTH} levels", "refused")
        return yaml.load(text, Loader=_Loader)  # noqa: S506 - a safe loader by construction
    except (yaml.YAMLError, ValueError, RecursionError) as fault:
        line = " ".join(str(fault).split())[:200]
        raise error(f"{name} is not a YAML document", line) from fault


def read_as(value: object, kind: type[T], name: str, error: type[GyrorigError] = UsageError) -> T:
    """Return `value` as a `kind`, a msgspec structure with `forbid_unknown_fields`.

    Raises:
        GyrorigError: of the given class; a key is unknown or missing, or a type is wrong.
            The text names the place as a path such as `$.ptu.port`.
    """
    try:
        return msgspec.convert(value, type=kind, strict=True)
    except (msgspec.ValidationError, ValueError) as fault:
        raise error(f"{name}", " ".join(str(fault).split())) from fault


def dump_yaml(document: Mapping[str, Any]) -> str:
    """Return `document` as YAML that version 1.1 and 1.2 readers take alike.

    Strings are quoted, floats have a point, mappings keep their order, and there are
    no aliases and no tags.

    Raises:
        TypeError: a value is neither a mapping, sequence, string, number, bool nor None.
    """
    return str(
        yaml.dump(
            _plain(document), Dumper=_PlainDumper, sort_keys=False, width=1000, allow_unicode=True
        )
    )


def _is_not_finite(event: yaml.ScalarEvent) -> bool:
    return bool(event.implicit[0]) and event.value.lower().lstrip("+-") in (".nan", ".inf")


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


_PlainDumper.add_representer(_Quoted, _quoted)
_PlainDumper.add_representer(float, _float)


def _plain(value: object) -> Any:
    """Return `value` made of the dumper's own kinds, keys as they are, strings quoted."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, str):
        return _Quoted(value)
    if value is None or isinstance(value, bool | int | float):
        return value
    raise TypeError(f"{type(value).__name__} has no place in a document")
