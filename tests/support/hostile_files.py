"""Files that were made to cost memory, time or a crash, in families and sizes.

What to use when: `FAMILIES` maps the name of a family to a function that writes one file of about a
given size. The size is a wish: a family whose cost does not depend on it can write a smaller file.
Recordings end with `.mcap`, tables with `.csv`, archives with `.npz`, documents with `.yaml`.
"""

import io
import json
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, Header, Metadata, Schema
from mcap.writer import Writer

from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.encoding.message_schemas import SCHEMAS
from gyrorig_protocol.recording.messages import (
    PTU_POSITION_TOPIC,
    SESSION_EVENT_TOPIC,
    EventKind,
    PtuPosition,
    SessionEvent,
)
from gyrorig_protocol.recording.writer import Attachment, RecordingWriter

BOARD = BoardId("B-1")
START_NS = 1_790_000_000_000_000_000
SECOND_NS = 1_000_000_000
MAGIC = b"\x89MCAP0\r\n"
SAMPLE_BYTES = 35  # of a packed sample with noise, measured
_UNIT_KEYS = (
    *("model", "pan_resolution_arcsec", "tilt_resolution_arcsec", "pan_acceleration"),
    *("tilt_acceleration", "pan_base_speed", "tilt_base_speed"),
)


def metadata() -> dict[str, dict[str, str]]:
    """Plain metadata of a recording with one board."""
    return {
        "gyrorig": {
            "format": "1",
            "session": "s-1",
            "rig": "rig-1",
            "anchor_utc_ns": str(START_NS),
            "anchor_monotonic_raw_ns": "5000000000",
        },
        "gyrorig.ptu": dict.fromkeys(_UNIT_KEYS, "185.142857"),
        f"gyrorig.board.{BOARD}": {
            **{"uid": "u", "sensor": "L3G4200D", "link": "serial", "tick_hz": "1000000"},
            **{"gyro_scale_rad_s": "0.000153", "counter_bits": "32", "odr_hz": "100"},
        },
    }


def _samples_written(
    path: Path,
    host_s: np.ndarray,
    *,
    ticks: np.ndarray | None = None,
    sequence: np.ndarray | None = None,
    gyro: np.ndarray | None = None,
    changed: dict[str, dict[str, str]] | None = None,
    attachments: list[Attachment] | None = None,
) -> Path:
    records = metadata()
    for name, entries in (changed or {}).items():
        records[name] = records.get(name, {}) | entries
    count = host_s.size
    host_ns = START_NS + np.rint(host_s * 1e9).astype(np.int64)
    counts = np.random.default_rng(1).integers(-500, 500, (count, 3)) if gyro is None else gyro
    numbers = np.arange(count) if sequence is None else sequence
    tick = np.rint(host_s * 1e6).astype(np.int64) % 2**32 if ticks is None else ticks
    del records["gyrorig"]["format"]
    with RecordingWriter(path, records, attachments or []) as out:
        for kind, time_ns in (
            (EventKind.PHASE_BEGIN, START_NS),
            (EventKind.PHASE_END, host_ns[-1]),
        ):
            event = SessionEvent(int(time_ns), kind, "static", "")
            out.write(SESSION_EVENT_TOPIC, event, int(time_ns))
        for start in range(0, count, 5000):
            part = slice(start, start + 5000)
            out.write_imu_array(
                BOARD,
                host_time_ns=host_ns[part],
                publish_time_ns=None,
                device_time=tick[part],
                sequence=numbers[part] % 2**32,
                status=np.zeros(count, np.int64)[part],
                temperature=np.zeros(count, np.int64)[part],
                gyro=counts[part],
            )
            out.flush()
    return path


def _even(size: int) -> np.ndarray:
    return np.arange(max(200, size // SAMPLE_BYTES)) / 100.0


def far_stamp(path: Path, size: int) -> Path:
    """One sample far after the others."""
    host_s = _even(size)
    host_s[-1] = 3.0e8
    return _samples_written(path, host_s)


def doubled_samples(path: Path, size: int) -> Path:
    """Each sample twice."""
    host_s = np.repeat(_even(size // 2), 2)
    return _samples_written(path, host_s, sequence=np.arange(host_s.size) // 2)


def sparse_samples(path: Path, size: int) -> Path:
    """Pairs of samples in quick succession, then 2 s without any."""
    pairs = max(100, size // SAMPLE_BYTES // 2)
    host_s = np.repeat(np.arange(pairs) * 1.9, 2)
    host_s[1::2] += 1e-5
    return _samples_written(path, host_s, sequence=np.rint(host_s * 1e5).astype(np.int64))


def equal_counts(path: Path, size: int) -> Path:
    """All counts and the counter are the largest number."""
    host_s = _even(size)
    full = np.full(host_s.size, 2**32 - 1)
    return _samples_written(
        path, host_s, sequence=full, ticks=full, gyro=np.full((host_s.size, 3), 2**31 - 1)
    )


def restless_clock(path: Path, size: int) -> Path:
    """The device clock jumps at each sample."""
    host_s = _even(size)
    jumps = np.random.default_rng(2).integers(0, 2**32, host_s.size)
    return _samples_written(path, host_s, ticks=jumps, sequence=jumps)


def hostile_settings(path: Path, size: int) -> Path:
    """Settings of the board that no board has."""
    extreme = {"tick_hz": "1e-300", "bandwidth_hz": "1e300", "odr_hz": "1e300"}
    return _samples_written(path, _even(size), changed={f"gyrorig.board.{BOARD}": extreme})


def large_metadata(path: Path, size: int) -> Path:
    """Very many entries of metadata."""
    entries = {f"{number:x}": "" for number in range(max(10, size // 12))}
    return _samples_written(path, _even(20_000), changed={"other": entries})


def large_attachments(path: Path, size: int) -> Path:
    """Attachments instead of data."""
    data = np.random.default_rng(3).bytes(max(100, size // 8))
    parts = [Attachment(f"a{number}", "text/x", data) for number in range(8)]
    return _samples_written(path, _even(20_000), attachments=parts)


def many_events(path: Path, size: int) -> Path:
    """Empty events, packed well."""
    with RecordingWriter(path, _own_metadata(), []) as out:
        for number in range(min(1_000_000, size // 20 + 100)):
            time_ns = START_NS + number
            out.write(SESSION_EVENT_TOPIC, SessionEvent(time_ns, EventKind.NOTE, "", ""), time_ns)
    return path


def many_positions(path: Path, size: int) -> Path:
    """Equal positions of the unit, packed well."""
    message = PtuPosition(0, 0, 0, 0, 0, 0.0, 0.0, 0, 0, 0).encode()
    with RecordingWriter(path, _own_metadata(), []) as out:
        for number in range(min(1_500_000, size // 18 + 100)):
            out.write_encoded(
                PTU_POSITION_TOPIC, PtuPosition.TYPE, message, START_NS, START_NS + number
            )
    return path


def _own_metadata() -> dict[str, dict[str, str]]:
    records = metadata()
    del records["gyrorig"]["format"]
    return records


def _head() -> bytes:
    builder = RecordBuilder()
    Header(profile="ros2", library="").write(builder)
    for name, entries in metadata().items():
        Metadata(name=name, metadata=entries).write(builder)
    return MAGIC + bytes(builder.end())  # type: ignore[no-untyped-call]


def chunk_bomb(path: Path, size: int) -> Path:
    """Sound chunks that each unpack to 190 times their size."""
    schema, channel = RecordBuilder(), RecordBuilder()
    Schema(id=1, name="a/B", encoding="ros2msg", data=b"uint8[] x").write(schema)
    Channel(id=1, topic="/x", message_encoding="cdr", metadata={}, schema_id=1).write(channel)
    message = struct.pack("<BQHIQQ", 5, 22 + 60_000, 1, 0, 0, 0) + bytes(60_000)
    declared = schema.end() + channel.end()  # type: ignore[no-untyped-call]
    inner = declared + message * 100
    noise = np.random.default_rng(4).bytes(len(inner) // 190)
    inner += struct.pack("<BQHIQQ", 5, 22 + len(noise), 1, 0, 0, 0) + noise
    packed = zstandard.compress(inner)
    builder = RecordBuilder()
    Chunk(
        message_start_time=0,
        message_end_time=0,
        uncompressed_size=len(inner),
        uncompressed_crc=zlib.crc32(inner),
        compression="zstd",
        data=packed,
    ).write(builder)
    chunk = builder.end()  # type: ignore[no-untyped-call]
    path.write_bytes(_head() + chunk * max(1, size // len(chunk)))
    return path


def landmarks(path: Path, size: int) -> Path:
    """Beginnings of copies, each of which seems to have a megabyte."""
    candidate = struct.pack("<BQQQI", 9, 1_000_000, 0, 0, 10) + b"gyrorig.xx"
    candidate += struct.pack("<I", 900_000)
    path.write_bytes(MAGIC + b"\xff" * 9 + candidate * (size // len(candidate) + 1))
    return path


def nested_landmarks(path: Path, size: int) -> Path:
    """The same, each with lengths that fit, so that its checksum is computed."""
    step, body = 64, 900_000
    parts = []
    for _ in range(size // step + 1):
        content = body - 8 - 8 - 4 - 10 - 4 - 8 - 4
        start = struct.pack("<BQQQI", 9, body, 0, 0, 10) + b"gyrorig.xx"
        start += struct.pack("<IQ", 0, content)
        parts.append(start.ljust(step, b"\x01"))
    path.write_bytes(_head() + b"\xff" * 9 + b"".join(parts))
    return path


def many_schemas(path: Path, size: int) -> Path:
    """Schemas of nested arrays, each used by a message."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="")
        for name, entries in metadata().items():
            writer.add_metadata(name, entries)
        for number in range(min(60_000, size // 250 + 1)):
            text = f"B[160] x{number}\n" + "".join(
                f"{'=' * 80}\nMSG: a/{kind}\n{inner}\n"
                for kind, inner in (("B", "C[100] y"), ("C", "D[2] z"), ("D", "uint8 a\nuint8 b"))
            )
            schema = writer.register_schema(f"a/T{number}", "ros2msg", text.encode())
            channel = writer.register_channel(f"/t{number}", "cdr", schema)
            writer.add_message(channel, START_NS, b"\x00\x01\x00\x00", START_NS)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def many_channels(path: Path, size: int) -> Path:
    """A channel for each message."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="")
        for name, entries in metadata().items():
            writer.add_metadata(name, entries)
        text = SCHEMAS[SessionEvent.TYPE].encode()
        schema = writer.register_schema(SessionEvent.TYPE, "ros2msg", text)
        message = SessionEvent(START_NS, EventKind.NOTE, "", "").encode()
        for number in range(min(65_000, size // 150 + 1)):
            channel = writer.register_channel(f"/t{number}", "cdr", schema)
            writer.add_message(channel, START_NS, message, START_NS)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def random_bytes(path: Path, size: int) -> Path:
    """The beginning of a recording, then noise."""
    path.write_bytes(_head() + np.random.default_rng(5).bytes(size))
    return path


def zeros(path: Path, size: int) -> Path:
    """The beginning of a recording, then zeros: records of no length."""
    path.write_bytes(_head() + bytes(size))
    return path


def wide_table(path: Path, size: int) -> Path:
    """A table with one line."""
    path.write_bytes(b"time,x,y,z\n" + b"1," * (size // 2))
    return path


def long_table(path: Path, size: int) -> Path:
    """A table of the shortest lines."""
    path.write_bytes(b"time,x,y,z\n" + b"1,1,1,1\n" * (size // 8))
    return path


def unclosed_quote(path: Path, size: int) -> Path:
    """A table with a quote that does not end."""
    path.write_bytes(b'time,x,y,z\n1,"2' + b"3,4\n" * (size // 4))
    return path


def archive_bomb(path: Path, size: int) -> Path:
    """Arrays of zeros that are packed a thousand times."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("time", "gyro"):
            head = io.BytesIO()
            rows = min(600_000_000, size * 60)
            shape: tuple[int, ...] = (rows,) if name == "time" else (rows // 3, 3)
            description = {"descr": "<f8", "fortran_order": False, "shape": shape}
            np.lib.format.write_array_header_1_0(head, description)
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                file.write(head.getvalue())
                for _ in range(max(1, min(rows * 8, size * 400) // 1_000_000)):
                    file.write(bytes(1_000_000))
    return path


def lying_archive(path: Path, size: int) -> Path:
    """An array whose header promises a terabyte."""
    head = io.BytesIO()
    description = {"descr": "<f8", "fortran_order": False, "shape": (10**12, 3)}
    np.lib.format.write_array_header_1_0(head, description)
    with zipfile.ZipFile(path, "w") as archive:
        for name in ("time", "gyro"):
            archive.writestr(f"{name}.npy", head.getvalue() + bytes(size // 2))
    return path


def json_log(path: Path, size: int) -> Path:
    """A log of a phone with deep lists."""
    depth = min(size // 4, 200_000)
    text = json.dumps([{"sensor": "Gyroscope", "time": "1"}])[:-1] + ","
    path.write_text(text + "[" * depth + "]" * depth + "]")
    return path


Maker = Callable[[Path, int], Path]
RECORDING_FAMILIES: dict[str, Maker] = {
    make.__name__: make
    for make in (
        *(far_stamp, doubled_samples, sparse_samples, equal_counts, restless_clock),
        *(hostile_settings, large_metadata, large_attachments, many_events, many_positions),
        *(chunk_bomb, landmarks, nested_landmarks, many_schemas, many_channels),
        *(random_bytes, zeros),
    )
}
IMPORT_FAMILIES: dict[str, tuple[Maker, str]] = {
    "wide_table": (wide_table, ".csv"),
    "long_table": (long_table, ".csv"),
    "unclosed_quote": (unclosed_quote, ".csv"),
    "archive_bomb": (archive_bomb, ".npz"),
    "lying_archive": (lying_archive, ".npz"),
    "json_log": (json_log, ".json"),
}
IMPORT_MAP = """schema: gyrorig/import/1
board: "B-1"
sensor: "L3G4200D"
source: "hostile"
time: {key: time, unit: s}
gyro: {keys: [x, y, z], unit: deg/s}
"""
