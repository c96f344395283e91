"""ROS 2 bags: a folder, or a single file of MCAP or SQLite."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from gyrorig_protocol.errors import InputError
from gyrorig_solver.importers.bag_limits import (
    MAX_CHUNK_BYTES,
    MCAP_MAGIC,
    check_mcap_chunks,
    parsing_errors,
)
from gyrorig_solver.importers.measured_streams import MeasuredStreams
from gyrorig_solver.importers.measurement_format import (
    BOARD_OPTIONS,
    MAX_LISTED,
    FormatMatch,
    ImportOptions,
    read_head,
)
from gyrorig_solver.importers.ros_streams import READ_TYPES, RosMessage, read_ros_streams

SQLITE_MAGIC = b"SQLite format 3\0"
_METADATA = "metadata.yaml"
_OWN_TYPES = b"gyrorig_msgs/msg/"  # a recording of this project, which is no foreign bag
SUMMARY_BYTES = 4_000_000


@dataclass(frozen=True, slots=True)
class Ros2Bag:
    """A bag of ROS 2, in MCAP or SQLite."""

    name: str = "ros2"
    title: str = "ROS 2 bag (MCAP or SQLite)"
    extra: str = "ros"
    used_options: frozenset[str] = BOARD_OPTIONS | {"topics", "stamp"}

    def detect(self, source: Path) -> FormatMatch | None:
        """Return a match for a folder with a bag's metadata or files, or one such file."""
        if source.is_dir():
            files = _bag_files(source)
            is_bag = b"rosbag2_bagfile_information" in read_head(source / _METADATA)
            if files and (is_bag or all(_is_bag_file(path) for path in files)):
                return FormatMatch(f"a ROS 2 bag with {len(files)} files")
            return None
        return FormatMatch("a ROS 2 bag") if _is_bag_file(source) else None

    def read(self, source: Path, options: ImportOptions) -> MeasuredStreams:
        """Return the IMUs, the poses and the temperature."""
        files = _bag_files(source) if source.is_dir() else [source]
        with parsing_errors(source.name, "copy the bag again from its source"):
            types: set[str] = set()
            return read_ros_streams(
                (message for path in files for message in _messages(path, types)),
                f"imported from {source.name}: a ROS 2 bag",
                options,
                types,
            )


def _bag_files(folder: Path) -> list[Path]:
    listed = islice(folder.iterdir(), MAX_LISTED)
    return sorted(path for path in listed if path.suffix in {".mcap", ".db3", ".zstd"})


def _is_bag_file(path: Path) -> bool:
    head = read_head(path)
    if head.startswith(MCAP_MAGIC):
        return b"ros2" in head[:64] and not _is_own_recording(path)
    if not head.startswith(SQLITE_MAGIC):
        return False
    try:
        return _sqlite_tables(path) >= {"messages", "topics"}
    except (sqlite3.Error, UnicodeDecodeError):  # an error can quote bytes of the file
        return False


def _is_own_recording(path: Path) -> bool:
    """Return whether the end of an MCAP file, where its summary is, names our own types."""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - SUMMARY_BYTES))
        return _OWN_TYPES in file.read(SUMMARY_BYTES)


def _sqlite_tables(path: Path) -> set[str]:
    with closing(sqlite3.connect(f"{path.resolve().as_uri()}?immutable=1", uri=True)) as database:
        database.text_factory = lambda name: name.decode("utf-8", errors="replace")
        rows = database.execute("SELECT name FROM sqlite_master WHERE type = 'table' LIMIT 100")
        return {str(name) for (name,) in rows}


def _messages(path: Path, types: set[str]) -> Iterator[RosMessage]:
    from rosbags.rosbag2.storage_mcap import McapReader  # noqa: PLC0415 - an extra
    from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader  # noqa: PLC0415 - an extra
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415 - an extra

    head = read_head(path)
    if head.startswith(MCAP_MAGIC):
        check_mcap_chunks(path)
        reader: Any = McapReader(path)
    elif head.startswith(SQLITE_MAGIC):
        _check_database(path)
        reader = Sqlite3Reader(path)
    else:
        raise InputError(
            f"the file {path.name} of the bag is compressed as a whole",
            "unpack it with `unzstd`, or convert the bag with `ros2 bag convert`",
        )
    store = get_typestore(Stores.ROS2_JAZZY)
    reader.open()
    try:
        types.update(connection.msgtype for connection in reader.connections)
        chosen = [c for c in reader.connections if c.msgtype in READ_TYPES]
        if not chosen:
            return
        for connection, log_ns, payload in reader.messages(chosen):
            message = store.deserialize_cdr(payload, connection.msgtype)
            yield connection.topic, connection.msgtype, log_ns, message
    finally:
        reader.close()


def _check_database(path: Path) -> None:
    """Check that a database has tables only, and the sizes that it states.

    A view can contain a query without an end.

    Raises:
        InputError: it has something else, or a message is too large for any message that is read.
    """
    with closing(sqlite3.connect(f"{path.resolve().as_uri()}?immutable=1", uri=True)) as database:
        (others,) = database.execute(
            "SELECT count(*) FROM sqlite_master WHERE type NOT IN ('table', 'index') "
            "OR sql LIKE 'CREATE VIRTUAL%'"
        ).fetchone()
        if others:
            raise InputError(
                f"the database {path.name} contains views, triggers or virtual tables, which a "
                "ROS 2 bag does not have",
                "copy the bag again from its source",
            )
        (largest,) = database.execute("SELECT max(length(data)) FROM messages").fetchone()
    if largest is not None and int(largest) > MAX_CHUNK_BYTES:
        raise InputError(
            f"the file {path.name} has a message of more than {MAX_CHUNK_BYTES // 1_000_000} MB",
            "record again without images, or only the topics of the IMU and of the reference",
        )


FORMAT = Ros2Bag()
