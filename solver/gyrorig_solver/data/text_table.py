"""Text tables: checks of a file, its header and its rows, and aligned columns to print."""

from collections.abc import Collection, Sequence
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
    """Check the first bytes of a file, and name the kind of a file that was given by mistake.

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


def check_column_names(names: Sequence[str], used: Sequence[str], table: str) -> None:
    """Check that each used column occurs once in the header of a table.

    Raises:
        InputError: a column occurs more than once.
    """
    for name in used:
        if names.count(name) > 1:
            raise InputError(
                f"the table {table} has {names.count(name)} columns with the name {name!r}",
                "give each column in the header of the table another name",
            )


def check_row_width(cell_count: int, width: int, number: int, table: str) -> None:
    """Check that a row has the cells of the header; another number shifts the values.

    Raises:
        InputError: it has more or fewer.
    """
    if cell_count != width:
        raise InputError(
            f"row {number} of the table {table} has {cell_count} columns, but the header has "
            f"{width}",
            "correct or remove the row, or export the table without decimal commas",
        )


def format_table(rows: Sequence[Sequence[str]], right: Collection[int] = ()) -> list[str]:
    """Return rows as lines with aligned columns.

    The columns with the numbers in `right` are aligned at the right.
    """
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return [
        "  ".join(
            text.rjust(width) if column in right else text.ljust(width)
            for column, (text, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
