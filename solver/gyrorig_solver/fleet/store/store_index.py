"""Index of a store: append-only Parquet files, and the journals not yet merged into them.

What to use when: `StoreIndex.finished_keys` before a batch, `merge_journal` to turn a journal into
a Parquet file, `query` for any question in SQL about the table `rows`. DuckDB reads the same
files without this program: `SELECT * FROM 'STORE/index/*.parquet'`.

A file of the index has the name of its journal. A merge that was interrupted after the file was
written and before the journal was removed is therefore recognised, and not done twice.
"""

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any
from uuid import uuid4

import duckdb
import msgspec

from gyrorig_protocol.errors import InputError, MachineError
from gyrorig_solver.fleet.store.folder_journal import JOURNAL_FOLDER as JOURNALS
from gyrorig_solver.fleet.store.folder_journal import (
    JOURNAL_SUFFIX,
    abandoned_journals,
    complete_lines,
    report_disk_errors,
)
from gyrorig_solver.fleet.store.index_rows import IndexRow, row_columns, sql_columns

INDEX_FOLDER = "index"
# A batch killed between a version and its row causes a second row later, and a repeated job has
# another result. One row per job and board counts: a calibration, else the latest row. The view
# has three parts, so that a query for one board reads the rows of that board only.
_ROWS_VIEW_SQL = """CREATE VIEW rows AS
    SELECT * FROM all_rows WHERE status = 'ok'
    QUALIFY row_number() OVER (PARTITION BY key, board) = 1
    UNION ALL
    SELECT * FROM (
        SELECT * FROM all_rows WHERE status <> 'ok' AND board <> ''
        QUALIFY row_number() OVER (PARTITION BY key, board ORDER BY created DESC) = 1
    ) ANTI JOIN (SELECT key, board FROM all_rows WHERE status = 'ok') USING (key, board)
    UNION ALL
    SELECT * FROM (
        SELECT * FROM all_rows WHERE status <> 'ok' AND board = ''
        QUALIFY row_number() OVER (PARTITION BY key, board ORDER BY created DESC) = 1
    ) ANTI JOIN (SELECT key FROM all_rows WHERE board <> '') USING (key)"""


class StoreIndex:
    """The rows of one store. Used by one thread."""

    def __init__(self, store: Path) -> None:
        self._store = store
        self._folder = store / INDEX_FOLDER

    def merge_journal(self, journal: Path) -> None:
        """Write a journal that no batch uses any more as a Parquet file, and remove the journal.

        Raises:
            MachineError: the disk refuses; the journal stays.
            InputError: the journal is damaged; it stays.
        """
        final = self._folder / (journal.name.removesuffix(JOURNAL_SUFFIX) + ".parquet")
        try:
            text = complete_lines(journal)
        except FileNotFoundError:  # merged by another batch a moment ago
            return
        if text and not final.exists():
            self._write_journal_rows(text, journal, final)
        journal.unlink(missing_ok=True)

    def merge_abandoned_journals(self) -> int:
        """Merge the journals of batches that have ended; return their number."""
        with abandoned_journals(self._store) as journals:
            for journal in journals:
                self.merge_journal(journal)
        return len(journals)

    def remove_temporary_files(self) -> None:
        """Remove temporary files of killed merges; only while no other batch merges."""
        for folder in (self._folder, self._store / JOURNALS):
            for path in folder.glob(".*"):
                path.unlink(missing_ok=True)

    def finished_keys(self, retry: Sequence[str] = ()) -> set[str]:
        """Return the keys of finished jobs; a job whose status is in `retry` is not finished."""
        sql = "SELECT key FROM rows GROUP BY key HAVING NOT bool_or(list_contains(?, status))"
        return {key for (key,) in self.query(sql, [list(retry)])}

    def query(self, sql: str, values: Sequence[Any] = ()) -> list[tuple[Any, ...]]:
        """Return the result of a query on the table `rows`.

        The columns are those of `index_rows.sql_columns`.

        Raises:
            InputError: a file of the index is damaged, or not a Parquet file.
        """
        with self.connect() as database:
            try:
                return database.execute(sql, list(values)).fetchall()
            except duckdb.Error as fault:
                raise _damaged_index_error(self._folder, fault) from fault

    def rebuild(self, rows: Iterable[IndexRow], name: str) -> None:
        """Write the index again, from these rows and its own rows of unsuccessful jobs.

        Raises:
            MachineError: the disk refuses; the old index stays.
        """
        old_files = [
            *self._folder.glob("*.parquet"),
            *(self._store / JOURNALS).glob(f"*{JOURNAL_SUFFIX}"),
        ]
        lines = self._store / JOURNALS / f".{name}{JOURNAL_SUFFIX}"
        with report_disk_errors(lines):
            lines.parent.mkdir(exist_ok=True)
        with report_disk_errors(lines), lines.open("wb") as file:
            file.writelines(msgspec.json.encode(row_columns(row)) + b"\n" for row in rows)
        try:
            with self._previous_index() as database:
                new_rows = _read_json_lines(database, [lines], torn=False)
                other_rows = database.sql("SELECT * FROM rows WHERE status <> 'ok'")
                self._write_parquet(new_rows.union(other_rows), self._folder / f"{name}.parquet")
        finally:
            lines.unlink(missing_ok=True)
        for path in old_files:
            path.unlink(missing_ok=True)

    def _previous_index(self) -> duckdb.DuckDBPyConnection:
        """Return the old index, or an empty one where it cannot be read."""
        try:
            database = self.connect()
            database.execute("SELECT * FROM rows").fetchall()
        except (InputError, duckdb.Error):
            database = _database()
            _empty_rows(database).create_view("rows")
        return database

    def connect(self) -> duckdb.DuckDBPyConnection:
        """Return a database in memory with the view `rows` of the whole index.

        Raises:
            InputError: as `query`.
        """
        database = _database()
        try:
            files = self._load_journals(database)
            rows = _empty_rows(database).union(database.table("fresh"))
            if files:
                # Files of older versions lack columns, those of newer ones have more.
                named = [str(file) for file in files]
                rows = rows.union(
                    _in_column_order(database.read_parquet(named, union_by_name=True))
                )
            rows.create_view("all_rows")
            database.execute(_ROWS_VIEW_SQL)
        except duckdb.Error as fault:
            database.close()
            raise _damaged_index_error(self._folder, fault) from fault
        return database

    def _load_journals(self, database: duckdb.DuckDBPyConnection) -> list[Path]:
        """Copy the rows not yet merged into the table `fresh`; return the files of the index.

        Batches can merge meanwhile. Journals are listed before files, so that each row is in one
        of the lists; a journal that is missing when it is read is in a file by then.
        """
        while True:
            journals = sorted((self._store / JOURNALS).glob(f"*{JOURNAL_SUFFIX}"))
            files = sorted(self._folder.glob("*.parquet"))
            merged = {path.stem for path in files}
            unmerged = [path for path in journals if path.stem not in merged]
            try:
                not_empty = [path for path in unmerged if path.stat().st_size]
                # The last line may be incomplete; it is skipped.
                rows = (
                    _read_json_lines(database, not_empty, torn=True)
                    if not_empty
                    else _empty_rows(database)
                )
                rows.create("fresh")
            except (duckdb.Error, FileNotFoundError):
                if all(path.exists() for path in unmerged):
                    raise
            else:
                return files

    def _write_journal_rows(self, text: bytes, journal: Path, final: Path) -> None:
        temporary = journal.with_name(f".{journal.name}.{uuid4().hex}")
        try:
            with report_disk_errors(temporary):
                temporary.write_bytes(text)
            with _database() as database:
                self._write_parquet(_read_json_lines(database, [temporary], torn=False), final)
        finally:
            temporary.unlink(missing_ok=True)

    def _write_parquet(self, rows: duckdb.DuckDBPyRelation, final: Path) -> None:
        """Write a file of the index, complete and synced, or not at all."""
        temporary = final.with_name(f".{final.name}.{uuid4().hex}")
        try:
            with report_disk_errors(final):
                self._folder.mkdir(exist_ok=True)
                rows.order("board, created").write_parquet(str(temporary), compression="zstd")
                _fsync_path(temporary)
                temporary.rename(final)
                _fsync_path(self._folder)
        except duckdb.IOException as fault:
            raise MachineError(
                f"the index {final} of the store cannot be written ({_one_line(fault)})",
                "free some disk space for the store",
            ) from fault
        except duckdb.Error as fault:
            raise _damaged_index_error(self._store, fault) from fault
        finally:
            temporary.unlink(missing_ok=True)


def _database() -> duckdb.DuckDBPyConnection:
    database = duckdb.connect(":memory:")
    database.execute("SET TimeZone = 'UTC'")
    return database


def _empty_rows(database: duckdb.DuckDBPyConnection) -> duckdb.DuckDBPyRelation:
    fields = ", ".join(f'NULL::{kind} AS "{name}"' for name, kind in sql_columns().items())
    return database.sql(f"SELECT {fields} LIMIT 0")


def _in_column_order(rows: duckdb.DuckDBPyRelation) -> duckdb.DuckDBPyRelation:
    """Return the columns in the order of `sql_columns`; missing ones are NULL."""
    present = set(rows.columns)
    return rows.select(
        *(
            duckdb.ColumnExpression(name)
            if name in present
            else duckdb.ConstantExpression(None).cast(kind).alias(name)
            for name, kind in sql_columns().items()
        )
    )


def _read_json_lines(
    database: duckdb.DuckDBPyConnection, paths: Sequence[Path], *, torn: bool
) -> duckdb.DuckDBPyRelation:
    names: Any = [str(path) for path in paths]  # the type stub allows one name only
    return database.read_json(
        names, columns=sql_columns(), format="newline_delimited", ignore_errors=torn
    )


def _damaged_index_error(path: Path, fault: duckdb.Error) -> InputError:
    return InputError(
        f"the index of the store {path} cannot be read ({_one_line(fault)})",
        "write the index again from the calibrations with `gyrorig store rebuild-index STORE`",
    )


def _one_line(fault: BaseException) -> str:
    return " ".join(str(fault).split())[:200]


def _fsync_path(path: Path) -> None:
    fd = os.open(path, os.O_RDONLY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
