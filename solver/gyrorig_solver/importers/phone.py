"""A phone's log becomes a recording: by itself, or beside what a unit did meanwhile.

What to use when: `import_phone`. By itself the recording's time is the phone's, from 0 on.
Beside a unit's recording its clock is found from the motion (`phone_clock`), and the new
recording holds what the unit's held and the phone as one more board.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gyrorig_protocol.errors import GyrorigError, InputError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.copies import NAMES as COPIES
from gyrorig_protocol.recording.messages import (
    SESSION_EVENT_TOPIC,
    EventKind,
    ImuStatus,
    Message,
    SessionEvent,
)
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording
from gyrorig_protocol.recording.writer import Attachment, RecordingWriter
from gyrorig_solver.arrays import FloatArray, IntArray
from gyrorig_solver.importers.android import PhoneLog, read_log
from gyrorig_solver.importers.phone_clock import GRID_S, FoundClock, find_clock
from gyrorig_solver.importers.streams import ACCEL_COUNT_M_S2, GYRO_COUNT_RAD_S
from gyrorig_solver.importers.times import at_samples
from gyrorig_solver.importers.writing import ImportSummary
from gyrorig_solver.reference.ptu_recording import ptu_reference

NS = 1_000_000_000
AROUND_S = 2.0  # of the phone's samples, before the unit's first word and after its last
ROWS = 4096

_Dated = tuple[int, int, str, Message]


def import_phone(
    source: Path, out: Path, board: str, sensor: str, beside: Path | None = None
) -> ImportSummary:
    """Turn a phone's log into a recording.

    Args:
        source: the log; see `android` for the kinds.
        out: the recording, `.mcap`; it must not exist.
        board: the phone's name.
        sensor: its part, for the data sheet: MPU-6515 in a Nexus 5.
        beside: a recording of the unit that turned the phone meanwhile.

    Raises:
        InputError: no log, or not of what the unit did; nothing is written.
        UsageError: `out` exists or is not named `.mcap`, or the name is taken.
        MachineError: the disk refused; nothing is left.
    """
    if out.suffix != ".mcap":
        raise UsageError(f"{out.name} is no name for a recording", "end it in .mcap")
    name = BoardId(board)
    log = read_log(source)
    notes = [f"imported from {source.name}: {log.shape}", *log.notes]
    metadata = {
        "sensor": sensor,
        "uid": "unknown",
        "link": "file",
        "gyro_scale_rad_s": repr(GYRO_COUNT_RAD_S),
        "tick_hz": "1000000000.0",
        "counter_bits": "64",
    }
    if log.accel_m_s2 is not None:
        metadata["accel_scale_m_s2"] = repr(ACCEL_COUNT_M_S2)
    since_s = (log.stamp_ns - log.stamp_ns[0]) * 1e-9
    if beside is None:
        host_ns = log.stamp_ns - log.stamp_ns[0]
        records = {
            "gyrorig": {
                "session": out.stem,
                "rig": "import",
                "anchor_utc_ns": "0",
                "anchor_monotonic_raw_ns": "0",
            }
        }
        end = int(host_ns[-1])
        others = [
            _event(0, EventKind.PHASE_BEGIN, ""),
            *(_event(0, EventKind.NOTE, note) for note in notes),
            _event(end, EventKind.PHASE_END, ""),
        ]
        attachments: list[Attachment] = []
        keep = slice(None)
    else:
        unit = read_recording(beside)
        if str(name) in map(str, unit.board_ids):
            raise UsageError(f"{beside.name} has a board {name} already", "name it with --board")
        clock = _clock(log, since_s, unit)
        notes.append(_said(clock))
        host_ns = unit.start_ns + np.rint(clock.capture_s(since_s) * NS).astype(np.int64)
        around = (host_ns >= max(0, unit.start_ns - int(AROUND_S * NS))) & (
            host_ns <= unit.end_ns + int(AROUND_S * NS)
        )
        keep = slice(int(np.argmax(around)), around.size - int(np.argmax(around[::-1])))
        records = {key: dict(value) for key, value in unit.metadata.items()}
        records["gyrorig"]["session"] = out.stem
        others = _copied(unit) + [_event(unit.start_ns, EventKind.NOTE, note) for note in notes]
        attachments = [
            Attachment(one.name, one.media_type, one.data)
            for one in unit.attachments
            if one.name not in COPIES
        ]
    records[f"gyrorig.board.{name}"] = metadata
    others.sort(key=lambda one: one[0])
    writer = RecordingWriter(out, records, attachments)
    try:
        _write(writer, name, log, host_ns, keep, others, notes)
        path = writer.close()
    except (GyrorigError, ValueError, KeyboardInterrupt):
        writer.path.unlink(missing_ok=True)
        raise
    kept = host_ns[keep]
    return ImportSummary(
        path=path,
        board=str(name),
        samples=kept.size,
        duration_s=float(kept[-1] - kept[0]) * 1e-9,
        attitudes=0,
        attitudes_lost=0,
        rests=0,
        turns=0,
        notes=tuple(notes),
    )


def _clock(log: PhoneLog, since_s: FloatArray, unit: Recording) -> FoundClock:
    if "/ptu/position" not in unit.topics:
        raise InputError(
            f"{unit.path.name} holds no pan-tilt unit", "give the recording made by gyrorigd"
        )
    reference = ptu_reference(unit, unit.start_ns)
    edges_s = np.arange(0.0, (unit.end_ns - unit.start_ns) * 1e-9, GRID_S)
    rate = reference.evaluate(edges_s, derivatives=False).rate_rad_s
    # means over steps of the grid are the speeds in their middle: shifted by half a step below
    speed = np.linalg.norm(rate, axis=1)
    own = log.rate_rad_s - np.median(log.rate_rad_s, axis=0)
    found = find_clock(since_s, np.linalg.norm(own, axis=1), speed)
    half = 0.5 * GRID_S
    return FoundClock(
        found.offset_s + half, found.skew, found.offset_std_s, found.skew_std,
        found.correlation, found.windows,
    )  # fmt: skip


def _said(clock: FoundClock) -> str:
    return (
        f"the phone's clock was found from the motion: {1e6 * clock.skew:+.1f} +- "
        f"{1e6 * clock.skew_std:.1f} ppm, to {1e3 * clock.offset_std_s:.2f} ms, correlation "
        f"{clock.correlation:.4f}, {clock.windows} windows; its own lag is in there, so the "
        "time_offset of a calibration says nothing of the phone"
    )


def _event(at_ns: int, kind: EventKind, text: str) -> _Dated:
    return at_ns, at_ns, SESSION_EVENT_TOPIC, SessionEvent(at_ns, kind, "program", text)


def _copied(unit: Recording) -> list[_Dated]:
    """Return every message of a recording, with its times."""
    return [
        (one.log_time_ns, one.publish_time_ns, topic, one.message)
        for topic in unit.topics
        for one in unit.stamped(topic)
    ]


def _counts(values: FloatArray, count: float, what: str) -> IntArray:
    whole = np.rint(values / count)
    if np.any(np.abs(whole) > np.iinfo(np.int32).max):
        raise InputError(
            f"the {what} is beyond any sensor",
            "look whether the log is in rad/s and m/s^2; else import it as csv with a column map",
        )
    return np.asarray(whole, dtype=np.int64)


def _write(
    writer: RecordingWriter,
    board: BoardId,
    log: PhoneLog,
    host_ns: IntArray,
    keep: slice,
    others: list[_Dated],
    notes: list[str],
) -> None:
    status = np.zeros(log.stamp_ns.size, dtype=np.int64)
    accel: IntArray | None = None
    if log.accel_m_s2 is not None and log.accel_stamp_ns is not None:
        first = log.stamp_ns[0]
        picked = at_samples(
            log.accel_m_s2,
            (log.accel_stamp_ns - first) * 1e-9,
            (log.stamp_ns - first) * 1e-9,
            np.arange(log.stamp_ns.size),
            "accelerometer",
            notes,
        )
        valid = np.all(np.isfinite(picked), axis=1)
        status |= np.where(valid, int(ImuStatus.ACCEL_VALID), 0)
        accel = _counts(np.where(valid[:, None], picked, 0.0), ACCEL_COUNT_M_S2, "accelerometer")
    gyro = _counts(log.rate_rad_s, GYRO_COUNT_RAD_S, "gyroscope")
    waiting: Iterator[_Dated] = iter(others)
    ahead = next(waiting, None)
    rows = np.arange(log.stamp_ns.size)[keep]
    for start in range(0, rows.size, ROWS):
        part = rows[start : start + ROWS]
        writer.write_imu_array(
            board,
            host_time_ns=host_ns[part],
            publish_time_ns=None,
            # a stamp before the phone's zero cannot be; one that is not counts from the first
            device_time=log.stamp_ns[part] - min(0, int(log.stamp_ns[0])),
            sequence=part & 0xFFFFFFFF,
            status=status[part],
            temperature=np.zeros(part.size, dtype=np.int64),
            gyro=gyro[part],
            accel=None if accel is None else accel[part],
        )
        while ahead is not None and ahead[0] <= int(host_ns[part][-1]):
            writer.write(ahead[2], ahead[3], ahead[0], ahead[1])
            ahead = next(waiting, None)
    while ahead is not None:
        writer.write(ahead[2], ahead[3], ahead[0], ahead[1])
        ahead = next(waiting, None)
