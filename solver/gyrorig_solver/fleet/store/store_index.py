"""Index of a store: append-only Parquet files, and the journals not yet merged into them.

What to use when: `StoreIndex.finished_keys` before a batch, `merge_batch` and `merge_ended_batches`
to turn journals into Parquet files, `query` for any question in SQL about the table `rows`. DuckDB
reads the same files without this program: `SELECT * FROM 'STORE/index/*.parquet'`.

A file of the index has the name of its batch and the digest of its rows. If two batches merge one
journal at the same time, or a merge is interrupted and repeated, they write the same file.
"""

import hashlib
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

import duckdb
import numpy.typing as npt

from gyrorig_protocol.errors import InputError, MachineError
from gyrorig_solver.fleet.store.coordination import (
    INDEX_FOLDER,
    JOURNAL_FOLDER,
    journal_files,
    live_batches,
)
from gyrorig_solver.fleet.store.index_rows import IndexRow, json_lines, sql_columns
from gyrorig_solver.storage import Storage, storage_at

ROWS_PER_REBUILT_FILE = 50_000  # of which one is in memory at a time
_DIGEST_CHARS = 12  # of a digest, in a file's name
# A batch killed between a version and its row causes a second row later, and a repeated job has
# another result. One row per job and board counts: a calibration, else the latest row. The view
# has three parts, so that a query for one board reads the rows of that board only.
_ROWS_VIEW_SQL = """CREATE VIEW rows AS
    SELECT * FROM all_rows WHERE status = 'ok'
    QUALIFY row_number() OVER (PARTITION BY key, board, file) = 1
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

    def __init__(self, store: Path | Storage) -> None:
        self._storage = storage_at(store)

    def merge_batch(self, batch: str) -> None:
        """Write the journal of a batch as a file of the index, and remove the journal.

        Raises:
            MachineError: the store refuses; the journal stays.
            InputError: the journal is damaged; it stays.
        """
        self._merge(batch, journal_files(self._storage).get(batch, []))

    def merge_ended_batches(self) -> int:
        """Merge the journals of batches that have ended; return their number.

        Raises:
            MachineError: the store refuses; the journals stay.
            InputError: a journal is damaged; it stays.
        """
        journals = journal_files(self._storage)
        ended = sorted(set(journals) - live_batches(self._storage)) if journals else []
        for batch in ended:
            self._merge(batch, journals[batch])
        return len(ended)

    def _merge(self, batch: str, names: Sequence[str]) -> None:
        text = b"".join(_complete_lines(self._storage.read(name)) for name in names)
        if text:  # else it has no row, or another batch has merged it meanwhile
            self._add_file(batch, text)
        self._storage.remove(names)

    def finished_keys(self, retry: Sequence[str] = ()) -> set[str]:
        """Return the keys of finished jobs; a job whose status is in `retry` is not finished."""
        sql = "SELECT key FROM rows GROUP BY key HAVING NOT bool_or(list_contains(?, status))"
        return {key for (key,) in self.query(sql, [list(retry)])}

    def query(self, sql: str, values: Sequence[Any] = ()) -> list[tuple[Any, ...]]:
        """Return the result of a query on the table `rows`.

        The columns are those of `index_rows.sql_columns`.

        Raises:
            InputError: a file of the index is damaged, or not a Parquet file.
            MachineError: the store does not answer.
        """
        with self.connect() as database, self._report_damage():
            return database.execute(sql, list(values)).fetchall()

    def query_columns(self, sql: str) -> dict[str, npt.NDArray[Any]]:
        """Return the result of a query as columns; millions of rows as objects take gigabytes.

        Raises:
            InputError: as `query`.
            MachineError: as `query`.
        """
        with self.connect() as database, self._report_damage():
            columns: dict[str, npt.NDArray[Any]] = database.execute(sql).fetchnumpy()
            return columns

    def rebuild(self, rows: Iterable[IndexRow], name: str) -> None:
        """Write the index again, from these rows and its own rows of unsuccessful jobs.

        Raises:
            MachineError: the store refuses; the old index stays.
        """
        old_files = [
            entry.name
            for folder in (INDEX_FOLDER, JOURNAL_FOLDER)
            for entry in self._storage.list_files(folder)
        ]
        with self._previous_index() as database:
            unsuccessful = database.sql("SELECT * FROM rows WHERE status <> 'ok'")
            new_files = {self._write_relation(name, unsuccessful)}
        remaining = iter(rows)
        while chunk := list(islice(remaining, ROWS_PER_REBUILT_FILE)):
            new_files.add(self._add_file(name, json_lines(chunk)))
        self._storage.remove(file for file in old_files if file not in new_files)

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
            MachineError: as `query`.
        """
        journal_text, files = self._snapshot()
        database = _database()
        try:
            with self._report_damage():
                rows = _empty_rows(database)
                if journal_text:
                    with _relation(database, journal_text) as fresh:
                        fresh.create("fresh")
                    rows = rows.union(database.table("fresh"))
                if files:
                    # Files of older versions lack columns, those of newer ones have more.
                    parquet = database.read_parquet(list(map(str, files)), union_by_name=True)
                    rows = rows.union(_in_column_order(parquet))
                rows.create_view("all_rows")
                database.execute(_ROWS_VIEW_SQL)
        except BaseException:
            database.close()
            raise
        return database

    def _snapshot(self) -> tuple[bytes, list[Path]]:
        """Return the rows not yet merged, and the files of the index.

        Batches can merge meanwhile. Journals are listed before files, so that each row is in one
        of the lists; a journal that is missing when it is read is in a file by then.
        """
        while True:
            names = [name for files in journal_files(self._storage).values() for name in files]
            files = index_files(self._storage)
            texts = [self._storage.read(name) for name in names]
            if None not in texts:
                break
        text = b"".join(map(_complete_lines, texts))
        return text, [self._storage.cached_copy(name) for name in files]

    def _add_file(self, batch: str, text: bytes) -> str:
        """Write rows as a file of the index; return its name."""
        with _database() as database, self._report_damage(), _relation(database, text) as rows:
            return self._write_relation(batch, rows)

    def _write_relation(self, batch: str, rows: duckdb.DuckDBPyRelation) -> str:
        try:
            with tempfile.TemporaryDirectory(prefix="gyrorig-") as folder:
                path = Path(folder) / "rows.parquet"
                rows.order("board, created").write_parquet(str(path), compression="zstd")
                data = path.read_bytes()
        except (OSError, duckdb.IOException) as fault:
            raise MachineError(
                f"the temporary file with rows of the index cannot be written ({_one_line(fault)})",
                "free some space on the disk for temporary files",
            ) from fault
        digest = hashlib.sha256(data).hexdigest()[:_DIGEST_CHARS]
        name = f"{INDEX_FOLDER}/{batch}-{digest}.parquet"
        self._storage.write_new(name, data)
        return name

    @contextmanager
    def _report_damage(self) -> Iterator[None]:
        """Turn errors of DuckDB into an InputError with the remedy."""
        try:
            yield
        except duckdb.Error as fault:
            location = self._storage.location
            raise InputError(
                f"the index of the store {location} cannot be read ({_one_line(fault)})",
                "write the index again from the calibrations with `gyrorig store rebuild-index "
                f"{location}`",
            ) from fault


def index_files(storage: Storage) -> list[str]:
    """Return the names of the files of the index.

    Raises:
        MachineError: the store does not answer.
    """
    names = (Path(entry.name) for entry in storage.list_files(INDEX_FOLDER))
    return [str(name) for name in names if name.suffix == ".parquet" and name.name[0] != "."]


def _complete_lines(data: bytes | None) -> bytes:
    """Return a journal up to its last complete line: older versions could leave a partial one."""
    return data[: data.rfind(b"\n") + 1] if data else b""


@contextmanager
def _relation(database: duckdb.DuckDBPyConnection, text: bytes) -> Iterator[Any]:
    """Provide JSON lines as a relation."""
    with tempfile.NamedTemporaryFile(prefix="gyrorig-", suffix=".jsonl") as file:
        file.write(text)
        file.flush()
        yield database.read_json(
            file.name, columns=sql_columns(), format="newline_delimited", ignore_errors=False
        )


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


def _one_line(fault: BaseException) -> str:
    return " ".join(str(fault).split())[:200]
