"""Untrusted files: recordings, chunks with a valid checksum, tables."""

import functools
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import zstandard
from tests.fuzz.target import Target, check_single_line, expect_rejection
from tests.support.flight_log_writers import write_blackbox, write_dataflash, write_ulog
from tests.support.handheld_session import (
    HandheldSession,
    simulate_session,
    write_sensor_logger,
    write_xsens,
)

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.messages import (
    PTU_POSITION_TOPIC,
    SESSION_EVENT_TOPIC,
    EventKind,
    ImuRaw,
    PtuPosition,
    SessionEvent,
    imu_raw_topic,
)
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.writer import RecordingWriter
from gyrorig_solver.importers import ImportOptions, formats
from gyrorig_solver.importers.map_keys import TableLayout
from gyrorig_solver.importers.measurement_columns import open_columns
from gyrorig_solver.importers.phone_log import read_phone_log

MAGIC = b"\x89MCAP0\r\n"
CHUNK = 0x06
START_NS = 1_790_000_000_000_000_000
BOARD = BoardId("B-1")
_MEMORY = Path("/dev/shm")  # noqa: S108 - a file that is read once and never reaches a disk


@functools.cache
def folder() -> Path:
    """A folder of this process's own, in memory where there is such a place."""
    return Path(tempfile.mkdtemp(prefix="gyrorig-fuzz-", dir=_MEMORY if _MEMORY.is_dir() else None))


def recording(data: bytes) -> None:
    """A recording is rejected with one line, or all of its data can be read."""
    path = folder() / "fuzz.mcap"
    path.write_bytes(data)
    expect_rejection(lambda _: _read_all(path), InputError, data)


def _read_all(path: Path) -> None:
    actual = read_recording(path)
    for topic in actual.topics:
        try:
            actual.messages(topic)
        except InputError as fault:
            check_single_line(fault)


def chunk(data: bytes) -> None:
    """As `recording`, of a chunk whose checksum is right: none keeps a liar out."""
    head = struct.pack("<QQQII", START_NS, 2**62, len(data), zlib.crc32(data), 0)
    body = head + struct.pack("<Q", len(data)) + data
    recording(_before_chunks() + struct.pack("<BQ", CHUNK, len(body)) + body + MAGIC)


def table(data: bytes) -> None:
    """A table of numbers is rejected with one line, or its columns can be read."""
    path = folder() / "fuzz.csv"
    path.write_bytes(data)
    expect_rejection(
        lambda _: open_columns(path, ["t", "x", "y"]).matrix(["x", "y"], 2), InputError, data
    )


def layout(data: bytes) -> None:
    """As `table`, of a table with two header lines, comments and decimal commas."""
    path = folder() / "fuzz.csv"
    path.write_bytes(data)
    made = TableLayout(header_rows=2, comment="#", decimal="comma")
    keys: list[str | int] = ["gyro x", "x#2", 3]
    expect_rejection(lambda _: open_columns(path, keys, made).matrix(keys, 3), InputError, data)


def archive(data: bytes) -> None:
    """An archive is rejected with one line, or its arrays can be read."""
    path = folder() / "fuzz.npz"
    path.write_bytes(data)
    keys = ["t", "log[1]"]
    expect_rejection(lambda _: open_columns(path, keys).matrix(keys, 2), InputError, data)


@functools.cache
def small_archive() -> bytes:
    """An archive that is not compressed, so that damage reaches the arrays."""
    path = folder() / "seed.npz"
    np.savez(path, t=np.arange(3), log=np.zeros((3, 2)))
    return path.read_bytes()


def array(data: bytes) -> None:
    """As `archive`, of an array in an archive whose checksums are right."""
    with zipfile.ZipFile(folder() / "fuzz.npz", "w") as out:
        out.writestr("t.npy", data)
        out.writestr("log.npy", data)
    archive((folder() / "fuzz.npz").read_bytes())


@functools.cache
def small_array() -> bytes:
    """One array, as `numpy.save` writes it."""
    path = folder() / "seed.npy"
    np.save(path, np.zeros((3, 2)))
    return path.read_bytes()


@functools.cache
def small_recording() -> bytes:
    """A recording of samples, positions and an event, in two chunks."""
    axis = "pan_resolution_arcsec tilt_resolution_arcsec pan_acceleration tilt_acceleration"
    names = ["model", *axis.split(), "pan_base_speed", "tilt_base_speed"]
    metadata = {
        "gyrorig": {
            "session": "s-1",
            "rig": "rig-1",
            "anchor_utc_ns": str(START_NS),
            "anchor_monotonic_raw_ns": "5000000000",
        },
        "gyrorig.ptu": dict.fromkeys(names, "185.142857"),
        f"gyrorig.board.{BOARD}": {
            "uid": "u", "sensor": "L3G4200D", "link": "serial", "gyro_scale_rad_s": "0.000153",
        },
    }  # fmt: skip
    path = folder() / "seed.mcap"
    with RecordingWriter(path, metadata, []) as out:
        for number in range(6):
            now_ns = START_NS + number * 10_000_000
            sample = ImuRaw(now_ns, number, number, 3, 20, (1, 2, number), (0, 0, 256))
            out.write(imu_raw_topic(BOARD), sample, now_ns)
            location = PtuPosition(
                now_ns, now_ns + 3, now_ns + 5, number, -number, 0.1, -0.1, 7, number, 3
            )
            out.write(PTU_POSITION_TOPIC, location, now_ns + 5)
            out.write(SESSION_EVENT_TOPIC, SessionEvent(now_ns, EventKind.NOTE, "s", "x"), now_ns)
            if number == 3:
                out.flush()
    return path.read_bytes()


def _records(whole: bytes) -> Iterator[tuple[int, int, int]]:
    """Opcode, begin and end of each record in the data section."""
    index = len(MAGIC)
    while index + 9 <= len(whole) - len(MAGIC):
        end = index + 9 + int.from_bytes(whole[index + 1 : index + 9], "little")
        yield whole[index], index, end
        index = end


@functools.cache
def _before_chunks() -> bytes:
    complete = small_recording()
    return complete[: next(begin for opcode, begin, _ in _records(complete) if opcode == CHUNK)]


def _contents() -> list[bytes]:
    """The content of the chunks, unpacked."""
    complete, contents = small_recording(), []
    for opcode, begin, end in _records(complete):
        if opcode == CHUNK:
            name = int.from_bytes(complete[begin + 37 : begin + 41], "little")
            packed = complete[begin + 41 + name + 8 : end]
            unpacked = zstandard.ZstdDecompressor().decompressobj().decompress(packed)
            contents.append(unpacked if name else packed)
    return contents


def phone(data: bytes) -> None:
    """A phone's log is rejected with one line, or its samples can be read in order."""
    path = folder() / "Gyroscope.csv"
    path.write_bytes(data)
    expect_rejection(lambda _: read_phone_log(path), InputError, data)


PHONE_LOGS = (
    b"time,seconds_elapsed,z,y,x\n1665,0.00,1,2,3\n1666,0.01,1,2,3\n1667,0.02,1,2,3\n",
    b"GYRO;0.1;1.000;0.1;0.2;0.3;3\nACCE;0.1;1.001;0.1;0.2;9.8;3\n"
    b"GYRO;0.2;1.010;0.1;0.2;0.3;3\nGYRO;0.3;1.020;0.1;0.2;0.3;3\n",
    b"UncalGyro,1,1000000,0.1,0.2,0.3,0,0,0\nUncalGyro,2,11000000,0.1,0.2,0.3,0,0,0\n"
    b"UncalGyro,3,21000000,0.1,0.2,0.3,0,0,0\n",
    b"Timestamp[nanosec], gx[rad/s], gy[rad/s], gz[rad/s]\n1000000, 1, 2, 3\n"
    b"6000000, 1, 2, 3\n11000000, 1, 2, 3\n",
)


def _format_target(name: str, suffix: str) -> Callable[[bytes], None]:
    """Return the check of one format: rejected with one line, or its streams can be read."""

    def run(data: bytes) -> None:
        path = folder() / f"fuzz{suffix}"
        path.write_bytes(data)
        chosen = formats()[name]
        chosen.detect(path)
        expect_rejection(lambda _: chosen.read(path, ImportOptions()), InputError, data)

    return run


@functools.cache
def _short_session() -> HandheldSession:
    whole = simulate_session(1, moves=1)
    arrays = ("time_s", "rate_rad_s", "accel_m_s2", "orientation_xyzw", "temperature_degc")
    return replace(whole, **{name: getattr(whole, name)[:5] for name in arrays})


def _written(write: Callable[[Path, HandheldSession], Path]) -> Callable[[], list[bytes]]:
    return lambda: [write(folder(), _short_session()).read_bytes()]


def phyphox_tables(data: bytes) -> None:
    """As a format, of tables in an archive whose checksums are right: data and events."""
    path = folder() / "fuzz.zip"
    with zipfile.ZipFile(path, "w") as out:
        out.writestr("Gyroscope.csv", b'"Time (s)","Gyroscope x (rad/s)","Gyroscope y (rad/s)",'
                     b'"Gyroscope z (rad/s)"\n' + data)  # fmt: skip
        out.writestr("meta/time.csv", data)
    for name in ("phyphox", "sensor-logger"):
        formats()[name].detect(path)
    expect_rejection(lambda _: formats()["phyphox"].read(path, ImportOptions()), InputError, data)


def sensor_logger_tables(data: bytes) -> None:
    """As `phyphox_tables`, of Sensor Logger."""
    path = folder() / "fuzz.zip"
    with zipfile.ZipFile(path, "w") as out:
        out.writestr("Gyroscope.csv", b"time,seconds_elapsed,z,y,x\n" + data)
        out.writestr("Metadata.csv", data)
    chosen = formats()["sensor-logger"]
    expect_rejection(lambda _: chosen.read(path, ImportOptions()), InputError, data)


TARGETS = (
    Target("recording", recording, lambda: [small_recording()], 16384),
    Target("chunk", chunk, _contents, 8192),
    Target("phone", phone, lambda: list(PHONE_LOGS), 2048),
    Target("archive", archive, lambda: [small_archive()], 4096),
    Target("array", array, lambda: [small_array()], 1024),
    Target(
        "layout", layout, lambda: [b'gyro,,\nx,x,y\n# a\n"1,5",2,3\n', b"gyro;;\nx;x;y\n1,5;2;3"]
    ),
    Target("ulog", _format_target("ulog", ".ulg"), _written(write_ulog), 8192),
    Target("dataflash", _format_target("dataflash", ".bin"), _written(write_dataflash), 4096),
    Target("blackbox", _format_target("blackbox", ".bbl"), _written(write_blackbox), 8192),
    Target("xsens", _format_target("xsens", ".txt"), _written(write_xsens), 4096),
    Target(
        "sensor-logger",
        _format_target("sensor-logger", ".zip"),
        _written(write_sensor_logger),
        8192,
    ),
    Target(
        "phyphox",
        phyphox_tables,
        lambda: [
            b"0.0,1,2,3\n0.1,1,2,3\n0.2,1,2,3\n",
            b"START,0,1000\nPAUSE,5,1005\nSTART,5,1010\n",
        ],
        1024,
    ),
    Target(
        "sensor-logger-tables",
        sensor_logger_tables,
        lambda: [b"1000000000,0.0,1,2,3\n2000000000,1.0,1,2,3\n3000000000,2.0,1,2,3\n"],
        1024,
    ),
    Target("table", table, lambda: [b"t,x,y\n0,1,2\n1,3,4\n", b"t\tx\ty\n1\t2\t3\n"], 1024),
)
