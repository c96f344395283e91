"""A planned program as the document that `gyrorigd record` carries out."""

import os
import tempfile
from pathlib import Path
from typing import Any

import msgspec

from gyrorig_protocol.documents import dump_yaml
from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.program import MotionProgram
from gyrorig_protocol.program.document import SCHEMA


def program_text(program: MotionProgram) -> str:
    """Return a program as YAML; what has its default is left out."""
    return dump_yaml({"schema": SCHEMA, **_set(program)})


def check_new(path: Path) -> None:
    """Refuse a name that cannot be written to, before the minutes that a search takes.

    Raises:
        UsageError: there is such a file already, or its folder is not there.
    """
    if path.exists():
        raise UsageError(f"{path} is there already", "give --out another name")
    if not path.parent.is_dir():
        raise UsageError(
            f"there is no folder {path.parent}", "make it first, or give --out another name"
        )


def write_new(path: Path, text: str) -> None:
    """Write a file whole, under a name that is not taken.

    Raises:
        UsageError: as `check_new`.
    """
    check_new(path)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    written = Path(name)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        written.chmod(0o644)
        path.hardlink_to(written)  # unlike a rename, this never writes over another's file
    except FileExistsError as fault:
        raise UsageError(f"{path} is there already", "give --out another name") from fault
    finally:
        written.unlink()


def _set(part: msgspec.Struct) -> dict[str, Any]:
    """Return the fields of a structure that differ from their defaults, as plain values."""
    out: dict[str, Any] = {}
    for field in msgspec.structs.fields(part):
        value = getattr(part, field.name)
        if value == field.default:
            continue
        if isinstance(value, msgspec.Struct):
            value = _set(value)
        elif isinstance(value, tuple):
            value = [_set(item) for item in value]
        out[field.name] = value
    return out
