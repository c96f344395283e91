"""Columns of numbers from a text table.

What to use when: `TextColumns`, by `measurement_columns.open_columns`. A column is given by its
name or by its number. A name that occurs twice is refused; `name#2` is the second of them. Rows
are read in blocks, and only the requested columns are kept.
"""

import csv
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from io import StringIO, TextIOWrapper
from typing import IO, TextIO

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.suggestions import did_you_mean
from gyrorig_solver.data import FloatArray
from gyrorig_solver.importers.map_keys import Column, TableLayout

# A row takes about 200 bytes (measured on 2 million rows): ten million rows take 2 GB.
MAX_ROWS = 10_000_000
ROWS_AT_A_TIME = 200_000
CHARACTERS_AT_A_TIME = 100_000_000
MAX_LINE_CHARS = 100_000
MAX_LISTED_NAMES = 12  # names listed in an error
DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "space": None}
_OCCURRENCE = re.compile(r"(.*)#(\d{1,5})")
_DECIMAL_COMMA = re.compile(r"\s*[-+]?\d*,\d+([eE][-+]?\d+)?\s*")


class TextColumns:
    """A text table, read in blocks; only the requested columns are kept."""

    def __init__(
        self, lines: TextIO, name: str, wanted: Sequence[Column], layout: TableLayout
    ) -> None:
        """Read a table.

        Args:
            lines: the text; `open_text` opens it.
            name: the file, for errors.
            wanted: the columns by name or by number from 1.
            layout: how the table is written.

        Raises:
            InputError: the table lacks a column, is not valid or is too large.
        """
        self._name = name
        header = _read_header(lines, layout)
        text = "".join(header)
        self._delimiter = (
            DELIMITERS[layout.delimiter] if layout.delimiter else max(",;\t", key=text.count)
        )
        rows = [[cell.strip() for cell in _split(line, self._delimiter)] for line in header]
        self._header = _HeaderNames(rows, name)
        self._index = {key: self._header.find(key) for key in wanted}
        data = self._read_rows(lines, layout)
        unique = sorted(set(self._index.values()))
        self._columns = {at: data[:, unique.index(at)] for at in unique}

    def matrix(self, keys: Sequence[Column], width: int) -> FloatArray:
        """Return `width` single columns joined, shape (n, width)."""
        data = np.stack([self._columns[self._index[key]] for key in keys], axis=1)
        return check_matrix(data, keys, width, self._name)

    def _read_rows(self, lines: TextIO, layout: TableLayout) -> FloatArray:
        """Return the requested columns of all rows, in the order of the table."""
        unique = sorted(set(self._index.values()))
        cells = {at: str(key) for key, at in self._index.items()}
        blocks = []
        rows = 0
        for given in _blocks(lines, self._name):
            self._check_width(given, layout, rows)
            has_comma = layout.decimal == "comma"
            block = [line.replace(",", ".") for line in given] if has_comma else given
            if layout.comment is not None:
                block = [line for line in block if not line.startswith(layout.comment)]
            try:
                blocks.append(_parse_rows(block, self._delimiter, unique))
            except (ValueError, IndexError) as error:
                raise self._bad_cell_error(given, layout, cells, rows) from error
            rows += len(block)
            if rows > MAX_ROWS:
                raise InputError(
                    f"the file {self._name} has more than {MAX_ROWS} rows",
                    "split the file, and import each part",
                )
        if not sum(len(part) for part in blocks):
            raise InputError(
                f"the table {self._name} has a header, but no rows", "give a file with measurements"
            )
        return np.concatenate(blocks)

    def _check_width(self, block: Sequence[str], layout: TableLayout, rows_before: int) -> None:
        """Check that no row has more cells than the header, which would shift its columns."""
        width = self._header.width
        if not width or self._delimiter is None:
            return
        for number, line in enumerate(block, start=rows_before + 1):
            if line.count(self._delimiter) < width:
                continue
            if layout.comment is not None and line.startswith(layout.comment):
                continue
            row = _split(line, self._delimiter)
            if any(cell.strip() for cell in row[width:]):
                raise InputError(
                    f"row {number} of the table {self._name} has {len(row)} columns, but the "
                    f"header has {width}",
                    "export the table again without decimal commas; or set `header_rows: 0` and "
                    "`skip_rows` under `table` in the import map, and give the columns by number",
                )

    def _bad_cell_error(
        self, rows: Sequence[str], layout: TableLayout, cells: Mapping[int, str], rows_before: int
    ) -> InputError:
        """Return the error of the first cell that is not a number."""
        for number, line in enumerate(rows, start=rows_before + 1):
            if layout.comment is not None and line.startswith(layout.comment):
                continue
            row = _split(line, self._delimiter)
            if row and max(cells) >= len(row):
                return InputError(
                    f"row {number} of the table {self._name} has only {len(row)} columns",
                    "correct or remove the row, which may be incomplete",
                )
            for at, column in cells.items():
                cell = row[at] if row else "nan"
                try:
                    float(cell.replace(",", ".") if layout.decimal == "comma" else cell)
                except ValueError:
                    return InputError(
                        f"row {number} of the table {self._name} has {cell[:40]!r} in the column "
                        f"{column[:40]}, which is not a number",
                        _cell_remedy(cell, number),
                    )
        return InputError(
            f"the table {self._name} contains text instead of numbers",
            "write the numbers in the form 0.25 or -2.5e-3",
        )


class _HeaderNames:
    """The names of the columns: the texts of every header line, and all of them joined."""

    def __init__(self, rows: Sequence[Sequence[str]], table: str) -> None:
        self.width = max((len(row) for row in rows), default=0)
        self._table = table
        # an empty cell of a line above the last takes the text to its left, as a merged cell does
        filled = [_fill_left(row) for row in rows[:-1]] + [list(row) for row in rows[-1:]]
        cells = [[row[at] if at < len(row) else "" for row in filled] for at in range(self.width)]
        self._names = [" ".join(text for text in column if text) for column in cells]
        self._spellings = [{*column, name} for column, name in zip(cells, self._names, strict=True)]

    def find(self, key: Column) -> int:
        """Return the index of a column.

        Raises:
            InputError: the table has no such column, or several.
        """
        if isinstance(key, int):
            if self.width and key > self.width:
                raise InputError(
                    f"the table {self._table} has {self.width} columns, so it has no column {key}",
                    "count the columns from 1 in the import map",
                )
            return key - 1
        places = self._find_all(key)
        if len(places) == 1:
            return places[0]
        if places:
            numbers = " and ".join(str(at + 1) for at in places[:4])
            raise InputError(
                f"the table {self._table} has {len(places)} columns with the name {key!r}, which "
                f"are the columns {numbers}",
                f"in the import map, write {_quote(f'{key}#1')} or {_quote(f'{key}#2')} "
                f"instead of the name, or the number of the column ({places[0] + 1} or "
                f"{places[1] + 1})",
            )
        occurrence = _OCCURRENCE.fullmatch(key)
        if occurrence is not None:
            places = self._find_all(occurrence[1])
            if 1 <= int(occurrence[2]) <= len(places):
                return places[int(occurrence[2]) - 1]
        raise InputError(
            f"the table {self._table} has no column {key!r}",
            did_you_mean(key, self._names)
            or f"in the import map, choose one of the columns {list_names(self._names)}",
        )

    def _find_all(self, name: str) -> list[int]:
        full = [at for at, joined in enumerate(self._names) if joined == name]
        return full or [at for at, texts in enumerate(self._spellings) if name in texts]


def open_text(file: IO[bytes]) -> TextIO:
    """Return a file of bytes as text; a byte order mark is left out."""
    return TextIOWrapper(file, encoding="utf-8-sig", errors="replace", newline="")


def _read_header(lines: TextIO, layout: TableLayout) -> list[str]:
    """Return the header lines; lines before them and comments are left out."""
    for _ in range(layout.skip_rows):
        lines.readline(MAX_LINE_CHARS)
    header: list[str] = []
    while len(header) < layout.header_rows:
        line = lines.readline(MAX_LINE_CHARS)
        if not line:
            break
        if layout.comment is None or not line.startswith(layout.comment):
            header.append(line)
    return header


def _blocks(lines: TextIO, table: str) -> Iterator[list[str]]:
    """Yield the remaining lines, in blocks of limited size.

    Raises:
        InputError: a line is too long for a table of numbers.
    """
    block: list[str] = []
    characters = 0
    while line := lines.readline(MAX_LINE_CHARS):
        if len(line) == MAX_LINE_CHARS:
            raise InputError(
                f"the file {table} has a line of more than {MAX_LINE_CHARS - 1} characters, so it "
                "is not a table of numbers",
                "give a table with one line per sample",
            )
        block.append(line)
        characters += len(line)
        if len(block) == ROWS_AT_A_TIME or characters > CHARACTERS_AT_A_TIME:
            yield block
            block, characters = [], 0
    if block:
        yield block


def _fill_left(row: Sequence[str]) -> list[str]:
    filled: list[str] = []
    for text in row:
        filled.append(text or (filled[-1] if filled else ""))
    return filled


def _split(line: str, delimiter: str | None) -> list[str]:
    if delimiter is None:
        return line.split()
    try:
        return next(csv.reader(StringIO(line), delimiter=delimiter), [])
    except csv.Error:
        return line.split(delimiter)


def _quote(key: str) -> str:
    return f'"{key}"'


def _cell_remedy(cell: str, row: int) -> str:
    if _DECIMAL_COMMA.fullmatch(cell):
        return "set `decimal: comma` under `table` in the import map"
    if row == 1:
        return (
            "if row 1 contains units, set `header_rows: 2` under `table` in the import map; "
            "otherwise correct the cell, or write nan for a missing value"
        )
    return "correct the cell, or write nan for a missing value"


def _parse_rows(
    rows: Sequence[str], delimiter: str | None, column_indices: Sequence[int]
) -> FloatArray:
    """Return the requested columns of some rows, shape (n, k); empty rows are left out.

    Raises:
        ValueError: a cell is not a number.
        IndexError: a row is too short.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # loadtxt warns if all rows are empty
        values = np.loadtxt(
            rows,
            delimiter=delimiter,
            usecols=column_indices,
            ndmin=2,
            comments=None,
            quotechar='"',
            dtype=np.float64,
        )
    return values.reshape(-1, len(column_indices))


def check_matrix(data: FloatArray, keys: Sequence[Column], width: int, name: str) -> FloatArray:
    """Return the columns `keys` of the file `name`, shape (n, width).

    Raises:
        InputError: they have another width, or too many rows.
    """
    if data.shape[1] != width:
        raise InputError(
            f"in the file {name}, {list_names(keys)} has {data.shape[1]} columns, but "
            f"{width} columns are needed",
            f"name one array with {width} columns, or {width} single columns, in the import map",
        )
    if data.shape[0] > MAX_ROWS:
        raise InputError(
            f"the file {name} has more than {MAX_ROWS} rows", "split the file, and import each part"
        )
    return np.ascontiguousarray(data, dtype=np.float64)


def list_names(names: Iterable[Column]) -> str:
    """Return some names for the text of an error."""
    shortened = [" ".join(str(name)[:40].split()) for name in names]
    more = (
        f" and {len(shortened) - MAX_LISTED_NAMES} more"
        if len(shortened) > MAX_LISTED_NAMES
        else ""
    )
    return (", ".join(shortened[:MAX_LISTED_NAMES]) or "nothing") + more
