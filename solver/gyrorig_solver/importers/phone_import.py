"""Importing a phone's log: alone, or together with a recording of the pan-tilt unit.

What to use when: `import_phone`. Without a unit's recording, the time of the new recording is
that of the phone, from 0 on. With one, the phone's clock is estimated from the motion
(`phone_clock`), and the new recording contains the messages of the unit's recording and the
phone as an additional board.
"""

from pathlib import Path

import numpy as np

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.backup_copies import COPY_NAMES as COPIES
from gyrorig_protocol.recording.messages import EventKind, ImuStatus
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording
from gyrorig_protocol.recording.writer import Attachment
from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.importers.import_streams import ACCEL_COUNT_M_S2, GYRO_COUNT_RAD_S, ImuStream
from gyrorig_solver.importers.import_times import values_at_samples
from gyrorig_solver.importers.imported_recording import (
    NS,
    DatedMessage,
    ImportSummary,
    check_recording_name,
    imported_session_metadata,
    session_event,
    write_recording,
)
from gyrorig_solver.importers.phone_clock import GRID_S, PhoneClock, find_phone_clock
from gyrorig_solver.importers.phone_log import PhoneLog, read_phone_log
from gyrorig_solver.reference import read_pan_tilt_reference

UNIT_MARGIN_S = 2.0  # of the phone's samples, before and after the unit's recording


def import_phone(
    source: Path, out: Path, board: str, sensor: str, unit_recording: Path | None = None
) -> ImportSummary:
    """Convert a phone's log to a recording.

    Without `unit_recording`, the time of the new recording is that of the phone.

    Raises:
        InputError: the log is not readable, or its motion is not that of the unit; nothing
            is written.
        UsageError: `out` exists or is not named `.mcap`, or the name is already used.
        MachineError: the disk cannot be written; no file remains.
    """
    check_recording_name(out)
    name = BoardId(board)
    log = read_phone_log(source)
    notes = [f"imported from {source.name}: {log.layout}", *log.notes]
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
    if unit_recording is None:
        host_ns = log.stamp_ns - log.stamp_ns[0]
        records = {"gyrorig": imported_session_metadata(out)}
        messages = [
            session_event(0, EventKind.PHASE_BEGIN, "program", ""),
            *(session_event(0, EventKind.NOTE, "program", note) for note in notes),
            session_event(int(host_ns[-1]), EventKind.PHASE_END, "program", ""),
        ]
        attachments: list[Attachment] = []
        keep = slice(None)
    else:
        unit = read_recording(unit_recording)
        if str(name) in map(str, unit.board_ids):
            raise UsageError(
                f"the phone would get the name {name}, but a board in the recording "
                f"{unit_recording.name} already has this name",
                "choose another name for the phone with --board",
            )
        clock = _find_phone_clock(log, since_s, unit)
        notes.append(_clock_note(clock))
        host_ns = unit.start_ns + np.rint(clock.capture_s(since_s) * NS).astype(np.int64)
        is_near = (host_ns >= max(0, unit.start_ns - int(UNIT_MARGIN_S * NS))) & (
            host_ns <= unit.end_ns + int(UNIT_MARGIN_S * NS)
        )
        keep = slice(int(np.argmax(is_near)), is_near.size - int(np.argmax(is_near[::-1])))
        records = {key: dict(value) for key, value in unit.metadata.items()}
        records["gyrorig"]["session"] = out.stem
        messages = _copied_messages(unit) + [
            session_event(unit.start_ns, EventKind.NOTE, "program", note) for note in notes
        ]
        attachments = [
            Attachment(attachment.name, attachment.media_type, attachment.data)
            for attachment in unit.attachments
            if attachment.name not in COPIES
        ]
    records[f"gyrorig.board.{name}"] = metadata
    messages.sort(key=lambda dated: dated[0])
    imu = _imu_stream(log, host_ns, keep, metadata, notes)
    path = write_recording(out, records, attachments, name, imu, messages)
    kept_ns = host_ns[keep]
    return ImportSummary(
        path=path,
        board=str(name),
        samples=kept_ns.size,
        duration_s=float(kept_ns[-1] - kept_ns[0]) * 1e-9,
        attitudes=0,
        attitudes_lost=0,
        rests=0,
        turns=0,
        notes=tuple(notes),
    )


def _find_phone_clock(log: PhoneLog, since_s: FloatArray, unit: Recording) -> PhoneClock:
    if "/ptu/position" not in unit.topics:
        raise InputError(
            f"the recording {unit.path.name} contains no data of a pan-tilt unit",
            "give a recording that gyrorigd made with a pan-tilt unit",
        )
    reference = read_pan_tilt_reference(unit, unit.start_ns)
    edges_s = np.arange(0.0, (unit.end_ns - unit.start_ns) * 1e-9, GRID_S)
    rate = reference.evaluate(edges_s, derivatives=False).rate_rad_s
    # a mean over a grid step is the speed in its middle; shifted by half a step below
    speed = np.linalg.norm(rate, axis=1)
    unbiased_rate = log.rate_rad_s - np.median(log.rate_rad_s, axis=0)
    clock = find_phone_clock(since_s, np.linalg.norm(unbiased_rate, axis=1), speed)
    half_step_s = 0.5 * GRID_S
    return PhoneClock(
        clock.offset_s + half_step_s, clock.skew, clock.offset_std_s, clock.skew_std,
        clock.correlation, clock.windows,
    )  # fmt: skip


def _clock_note(clock: PhoneClock) -> str:
    return (
        f"the phone's clock was estimated from the motion: {1e6 * clock.skew:+.1f} +- "
        f"{1e6 * clock.skew_std:.1f} ppm, offset to {1e3 * clock.offset_std_s:.2f} ms, correlation "
        f"{clock.correlation:.4f}, {clock.windows} windows; the offset includes the delay of the "
        "phone, therefore the time_offset of a calibration has no meaning"
    )


def _copied_messages(unit: Recording) -> list[DatedMessage]:
    """Return all messages of a recording, with their times."""
    return [
        (stamped.log_time_ns, stamped.publish_time_ns, topic, stamped.message)
        for topic in unit.topics
        for stamped in unit.timed_messages(topic)
    ]


def _to_counts(values: FloatArray, count: float, sensor: str) -> IntArray:
    whole = np.rint(values / count)
    if np.any(np.abs(whole) > np.iinfo(np.int32).max):
        raise InputError(
            f"the {sensor} values in the phone's log are too large for any sensor",
            "check that the log is in rad/s and m/s^2, or import the log as csv with a column map",
        )
    return np.asarray(whole, dtype=np.int64)


def _imu_stream(
    log: PhoneLog, host_ns: IntArray, keep: slice, metadata: dict[str, str], notes: list[str]
) -> ImuStream:
    """Return the kept samples of a log as counts; may append to `notes`."""
    count = log.stamp_ns.size
    since_s = (log.stamp_ns - log.stamp_ns[0]) * 1e-9
    status = np.zeros(count, dtype=np.int64)
    accel: IntArray | None = None
    if log.accel_m_s2 is not None and log.accel_stamp_ns is not None:
        picked = values_at_samples(
            log.accel_m_s2,
            (log.accel_stamp_ns - log.stamp_ns[0]) * 1e-9,
            since_s,
            np.arange(count),
            "accelerometer",
            notes,
        )
        valid = np.all(np.isfinite(picked), axis=1)
        status |= np.where(valid, int(ImuStatus.ACCEL_VALID), 0)
        accel = _to_counts(np.where(valid[:, None], picked, 0.0), ACCEL_COUNT_M_S2, "accelerometer")
    return ImuStream(
        host_time_ns=host_ns[keep],
        # device times below zero are not possible; then they count from the first sample
        device_time=(log.stamp_ns - min(0, int(log.stamp_ns[0])))[keep],
        row=np.arange(count)[keep],
        time_s=since_s[keep],
        status=status[keep],
        temperature=np.zeros(count, dtype=np.int64)[keep],
        gyro=_to_counts(log.rate_rad_s, GYRO_COUNT_RAD_S, "gyroscope")[keep],
        accel=None if accel is None else accel[keep],
        metadata=metadata,
        notes=tuple(notes),
    )
