"""The text tables of a folder or of a zip archive, without unpacking it.

What to use when: `SourceTables` for formats that write one table per sensor. The size that an
archive declares is checked before a table is read, and a table is read line by line.
"""

import csv
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import TextIO

from gyrorig_protocol.errors import InputError
from gyrorig_solver.importers.map_keys import Column, TableLayout
from gyrorig_solver.importers.text_columns import MAX_LINE_CHARS, TextColumns, open_text

MAX_MEMBERS = 2000  # files of an archive or a folder that are looked at
MAX_TABLE_BYTES = 4_000_000_000
MAX_TEXT_ROWS = 1000  # of a table of words, such as the properties of a device
_DAMAGED = (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, OSError, UnicodeDecodeError)


def find_delimiter(header: str) -> str:
    """Return what is between the cells of a header line: comma, semicolon or tab."""
    return max(",;\t", key=header.count)


class SourceTables:
    """The tables of one folder or zip archive, by their file names."""

    def __init__(self, source: Path) -> None:
        """Find the tables; the folders in an archive are left out of the names.

        Raises:
            InputError: the archive is damaged.
            OSError: the source cannot be read.
        """
        self.source = source
        self._paths: dict[str, list[str]] = {}
        for path in islice(self._list_paths(), MAX_MEMBERS):
            name = path.rsplit("/", 1)[-1]
            if not name.startswith(".") and not path.startswith("__MACOSX/"):
                self._paths.setdefault(name, []).append(path)

    def _list_paths(self) -> Iterator[str]:
        if self.source.is_dir():
            for child in islice(self.source.iterdir(), MAX_MEMBERS):
                if child.is_file():
                    yield child.name
                elif child.name == "meta" and child.is_dir():  # phyphox
                    yield from (f"meta/{c.name}" for c in islice(child.iterdir(), 100))
            return
        try:
            with zipfile.ZipFile(self.source) as archive:
                yield from archive.namelist()
        except _DAMAGED as error:
            raise InputError(
                f"the archive {self.source.name} is damaged or incomplete",
                "copy the archive again from its source",
            ) from error

    @property
    def names(self) -> list[str]:
        """Return the file names, sorted."""
        return sorted(self._paths)

    def header(self, name: str) -> str:
        """Return the first line of a table; "" if it cannot be read."""
        try:
            with self._open(name) as lines:
                return lines.readline(MAX_LINE_CHARS).strip()
        except (InputError, *_DAMAGED):
            return ""

    def columns(
        self, name: str, wanted: Sequence[Column], layout: TableLayout | None = None
    ) -> TextColumns:
        """Return columns of a table.

        Raises:
            InputError: the table lacks a column, is damaged or is too large.
        """
        try:
            with self._open(name) as lines:
                return TextColumns(lines, name, wanted, layout or TableLayout())
        except _DAMAGED as error:
            raise InputError(
                f"the table {name} in {self.source.name} is damaged or incomplete",
                "copy the file again from its source",
            ) from error

    def text_rows(self, name: str) -> list[list[str]]:
        """Return the cells of a small table of words, at most `MAX_TEXT_ROWS` rows.

        The first line shows whether comma, semicolon or tab is between the cells.
        """
        delimiter = find_delimiter(self.header(name))
        try:
            with self._open(name) as lines:
                limited = (lines.readline(MAX_LINE_CHARS) for _ in range(MAX_TEXT_ROWS))
                rows = csv.reader((line for line in limited if line), delimiter=delimiter)
                return [row for row in rows if row]
        except (csv.Error, InputError, *_DAMAGED):
            return []

    @contextmanager
    def _open(self, name: str) -> Iterator[TextIO]:
        paths = self._paths.get(name, [])
        if len(paths) != 1:
            problem = f"{len(paths)} files" if paths else "no file"
            raise InputError(
                f"{self.source.name} contains {problem} with the name {name[:60]}",
                "give the folder or the archive of one recording",
            )
        if self.source.is_dir():
            with open_text((self.source / paths[0]).open("rb")) as lines:
                yield lines
            return
        with zipfile.ZipFile(self.source) as archive:
            if archive.getinfo(paths[0]).file_size > MAX_TABLE_BYTES:
                raise InputError(
                    f"the table {name} in {self.source.name} has more than 4 GB",
                    "record shorter sessions",
                )
            with archive.open(paths[0]) as file, open_text(file) as lines:
                yield lines
