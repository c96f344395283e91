"""The index of a store: append-only Parquet files, and the journals not yet folded into them.

What to use when: `Index.done` before a batch, `fold` to turn a journal into a Parquet
file, `ask` for any question in SQL about the table `rows`. DuckDB reads the same files by
itself: `SELECT * FROM 'STORE/index/*.parquet'`.

A file of the index has its journal's name. A fold that was cut off between the file and
the journal's end is therefore seen, and done once.
"""

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any
from uuid import uuid4

import duckdb
import msgspec

from gyrorig_protocol.errors import InputError, MachineError
from gyrorig_solver.fleet.journal import FOLDER as JOURNALS
from gyrorig_solver.fleet.journal import SUFFIX, left_behind, told_of_disk, whole_lines
from gyrorig_solver.fleet.rows import Row, flat, sql_columns

FOLDER = "index"
# A batch killed between a version and its row leaves the row to be written twice; and work that
# is done again has another end, which counts: a calibration before all, else the latest.
# Asked in three, so that a question about one board looks at that board's rows alone.
_ONE_A_BOARD = """CREATE VIEW rows AS
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


class Index:
    """The rows of one store. Used by one thread."""

    def __init__(self, store: Path) -> None:
        self._store = store
        self._folder = store / FOLDER

    def fold(self, journal: Path) -> None:
        """Make a Parquet file of a journal that nobody writes to any more, and end that.

        Raises:
            MachineError: the disk refuses; the journal stays.
            InputError: the journal is damaged; it stays.
        """
        final = self._folder / (journal.name.removesuffix(SUFFIX) + ".parquet")
        try:
            text = whole_lines(journal)
        except FileNotFoundError:  # folded by another, a moment ago
            return
        if text and not final.exists():
            self._write(text, journal, final)
        journal.unlink(missing_ok=True)

    def fold_left_behind(self) -> int:
        """Fold the journals of batches that have ended; return how many."""
        with left_behind(self._store) as journals:
            for journal in journals:
                self.fold(journal)
        return len(journals)

    def sweep(self) -> None:
        """Remove what folds that were killed left behind; only while nobody else folds."""
        for folder in (self._folder, self._store / JOURNALS):
            for path in folder.glob(".*"):
                path.unlink(missing_ok=True)

    def done(self, retry: Sequence[str] = ()) -> set[str]:
        """Return the keys of all work that has come to its end.

        Args:
            retry: statuses that do not count as one.
        """
        sql = "SELECT key FROM rows GROUP BY key HAVING NOT bool_or(list_contains(?, status))"
        return {key for (key,) in self.ask(sql, [list(retry)])}

    def ask(self, sql: str, values: Sequence[Any] = ()) -> list[tuple[Any, ...]]:
        """Return the answer to a question about the table `rows`.

        Args:
            sql: its columns are those of `rows.sql_columns`.
            values: for its question marks.

        Raises:
            InputError: a file of the index is damaged, or is none.
        """
        with self.connect() as database:
            try:
                return database.execute(sql, list(values)).fetchall()
            except duckdb.Error as fault:
                raise _damaged(self._folder, fault) from fault

    def rebuild(self, rows: Iterable[Row], name: str) -> None:
        """Make the index anew out of these rows and of what it knows of other work.

        Args:
            rows: of all calibrations.
            name: of the new file.

        Raises:
            MachineError: the disk refuses; the old index stays.
        """
        old = [*self._folder.glob("*.parquet"), *(self._store / JOURNALS).glob(f"*{SUFFIX}")]
        lines = self._store / JOURNALS / f".{name}{SUFFIX}"
        with told_of_disk(lines):
            lines.parent.mkdir(exist_ok=True)
        with told_of_disk(lines), lines.open("wb") as file:
            file.writelines(msgspec.json.encode(flat(row)) + b"\n" for row in rows)
        try:
            with self._known() as database:
                made = _lines(database, [lines], torn=False)
                others = database.sql("SELECT * FROM rows WHERE status <> 'ok'")
                self._put(made.union(others), self._folder / f"{name}.parquet")
        finally:
            lines.unlink(missing_ok=True)
        for path in old:
            path.unlink(missing_ok=True)

    def _known(self) -> duckdb.DuckDBPyConnection:
        """Return the old index, or an empty one where it cannot be read."""
        try:
            database = self.connect()
            database.execute("SELECT * FROM rows").fetchall()
        except (InputError, duckdb.Error):
            database = _database()
            _no_rows(database).create_view("rows")
        return database

    def connect(self) -> duckdb.DuckDBPyConnection:
        """Return a database in memory in which `rows` is the whole index.

        Raises:
            InputError: as `ask`.
        """
        database = _database()
        try:
            files = self._take_journals(database)
            rows = _no_rows(database).union(database.table("fresh"))
            if files:
                # Files of an older version lack columns, those of a newer one have more.
                named = [str(file) for file in files]
                rows = rows.union(_ordered(database.read_parquet(named, union_by_name=True)))
            rows.create_view("all_rows")
            database.execute(_ONE_A_BOARD)
        except duckdb.Error as fault:
            database.close()
            raise _damaged(self._folder, fault) from fault
        return database

    def _take_journals(self, database: duckdb.DuckDBPyConnection) -> list[Path]:
        """Copy what is not folded yet into the table `fresh`; return the files of the index.

        Batches fold meanwhile. Journals are listed before files, so that each row is in one of
        the lists; a journal that is gone when it is read is in a file by then.
        """
        while True:
            journals = sorted((self._store / JOURNALS).glob(f"*{SUFFIX}"))
            files = sorted(self._folder.glob("*.parquet"))
            folded = {path.stem for path in files}
            fresh = [path for path in journals if path.stem not in folded]
            try:
                begun = [path for path in fresh if path.stat().st_size]
                # Their last line may be in the making: what is no whole line is passed over.
                rows = _lines(database, begun, torn=True) if begun else _no_rows(database)
                rows.create("fresh")
            except (duckdb.Error, FileNotFoundError):
                if all(path.exists() for path in fresh):
                    raise
            else:
                return files

    def _write(self, text: bytes, journal: Path, final: Path) -> None:
        whole = journal.with_name(f".{journal.name}.{uuid4().hex}")
        try:
            with told_of_disk(whole):
                whole.write_bytes(text)
            with _database() as database:
                self._put(_lines(database, [whole], torn=False), final)
        finally:
            whole.unlink(missing_ok=True)

    def _put(self, rows: duckdb.DuckDBPyRelation, final: Path) -> None:
        """Write a file of the index, whole and synced, or not at all."""
        temporary = final.with_name(f".{final.name}.{uuid4().hex}")
        try:
            with told_of_disk(final):
                self._folder.mkdir(exist_ok=True)
                rows.order("board, created").write_parquet(str(temporary), compression="zstd")
                _sync(temporary)
                temporary.rename(final)
                _sync(self._folder)
        except duckdb.IOException as fault:
            raise MachineError(
                f"cannot write {final}, {_line(fault)}", "make room for the store"
            ) from fault
        except duckdb.Error as fault:
            raise _damaged(self._store, fault) from fault
        finally:
            temporary.unlink(missing_ok=True)


def _database() -> duckdb.DuckDBPyConnection:
    database = duckdb.connect(":memory:")
    database.execute("SET TimeZone = 'UTC'")
    return database


def _no_rows(database: duckdb.DuckDBPyConnection) -> duckdb.DuckDBPyRelation:
    fields = ", ".join(f'NULL::{kind} AS "{name}"' for name, kind in sql_columns().items())
    return database.sql(f"SELECT {fields} LIMIT 0")


def _ordered(rows: duckdb.DuckDBPyRelation) -> duckdb.DuckDBPyRelation:
    """Return our columns in our order: a union goes by position. One that lacks is NULL."""
    there = set(rows.columns)
    return rows.select(
        *(
            duckdb.ColumnExpression(name)
            if name in there
            else duckdb.ConstantExpression(None).cast(kind).alias(name)
            for name, kind in sql_columns().items()
        )
    )


def _lines(
    database: duckdb.DuckDBPyConnection, paths: Sequence[Path], *, torn: bool
) -> duckdb.DuckDBPyRelation:
    names: Any = [str(path) for path in paths]  # the stub knows one name only
    return database.read_json(
        names, columns=sql_columns(), format="newline_delimited", ignore_errors=torn
    )


def _damaged(path: Path, fault: duckdb.Error) -> InputError:
    return InputError(
        f"the index of {path} cannot be read, {_line(fault)}",
        "`gyrorig store rebuild-index STORE` makes it anew from the calibrations",
    )


def _line(fault: BaseException) -> str:
    return " ".join(str(fault).split())[:200]


def _sync(path: Path) -> None:
    fd = os.open(path, os.O_RDONLY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
