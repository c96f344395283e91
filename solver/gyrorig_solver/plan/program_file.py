"""A planned program as the document that `gyrorigd record` executes."""

from pathlib import Path
from typing import Any

import msgspec

from gyrorig_protocol.atomic_files import write_atomically
from gyrorig_protocol.documents import dump_yaml
from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.program import MotionProgram
from gyrorig_protocol.program.program_document import SCHEMA


def program_text(program: MotionProgram) -> str:
    """Return a program as YAML without the fields that have their defaults."""
    return dump_yaml({"schema": SCHEMA, **_non_default_fields(program)})


def require_new_path(path: Path, option: str = "--output") -> None:
    """Raise an error if a file cannot be written, before a search that takes minutes.

    `option`: the option that gives the file name.

    Raises:
        UsageError: the file exists, or its folder does not.
    """
    if path.exists():
        raise UsageError(f"{path} exists", f"give another name with {option}")
    if not path.parent.is_dir():
        raise UsageError(
            f"the folder {path.parent} does not exist",
            f"create it, or give another name with {option}",
        )


def write_new_file(path: Path, text: str) -> None:
    """Write a new file atomically; never replace an existing file.

    Raises:
        UsageError: see `require_new_path`.
    """
    require_new_path(path)
    if not write_atomically(path, text.encode(), replace=False):
        raise UsageError(f"{path} exists", "give another name with --output")


def _non_default_fields(part: msgspec.Struct) -> dict[str, Any]:
    """Return the fields of a structure that differ from their defaults, as plain values."""
    out: dict[str, Any] = {}
    for field in msgspec.structs.fields(part):
        value = getattr(part, field.name)
        if value == field.default:
            continue
        if isinstance(value, msgspec.Struct):
            value = _non_default_fields(value)
        elif isinstance(value, tuple):
            value = [_non_default_fields(item) for item in value]
        out[field.name] = value
    return out
