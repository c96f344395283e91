"""Check that a file can be a text table, before it is read as one."""

from pathlib import Path

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.file_kinds import (
    CSV_TABLE,
    EMPTY_FILE,
    HEAD_BYTES,
    describe_file_kind,
)

_POSSIBLE_TABLES = frozenset({CSV_TABLE, EMPTY_FILE, "a text file", "a document without a schema"})


def check_text_table(path: Path) -> None:
    """Check the first bytes of a file, to name the kind of a file given by mistake.

    Raises:
        InputError: the file is of another kind, such as a recording or a calibration.
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        kind = describe_file_kind(file.read(HEAD_BYTES))
    if kind not in _POSSIBLE_TABLES:
        raise InputError(
            f"the file {path.name} is {kind}, not a text table", "give a text table (CSV)"
        )
