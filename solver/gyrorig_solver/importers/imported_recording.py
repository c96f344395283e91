"""Writing an imported recording: samples and other messages in the order of time.

What to use when: `write_recording` once everything in the input has been checked. After an
error no file remains.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from gyrorig_protocol.errors import GyrorigError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.messages import (
    SESSION_EVENT_TOPIC,
    EventKind,
    Message,
    SessionEvent,
)
from gyrorig_protocol.recording.writer import Attachment, RecordingWriter
from gyrorig_solver.importers.import_streams import ImuStream

NS = 1_000_000_000
SAMPLES_PER_WRITE = 4096  # about ten seconds of a fast board between two other messages

DatedMessage = tuple[int, int, str, Message]  # log time, publish time, topic, message


@dataclass(frozen=True, slots=True)
class ImportSummary:
    """Counts of what an import wrote and left out."""

    path: Path
    board: str
    samples: int
    duration_s: float
    attitudes: int
    attitudes_lost: int
    rests: int
    turns: int
    notes: tuple[str, ...]


def check_recording_name(out: Path) -> None:
    """Check the suffix of a recording.

    Raises:
        UsageError: it is not `.mcap`.
    """
    if out.suffix != ".mcap":
        raise UsageError(
            f"the name of the output file {out.name} does not end in .mcap",
            "give a name that ends in .mcap with --output",
        )


def imported_session_metadata(out: Path) -> dict[str, str]:
    """Return the session metadata of an import; its time starts at the source's origin."""
    return {
        "session": out.stem,
        "rig": "import",
        "anchor_utc_ns": "0",
        "anchor_monotonic_raw_ns": "0",
    }


def session_event(at_ns: int, kind: EventKind, phase: str, text: str) -> DatedMessage:
    """Return an event of the session with its times."""
    return at_ns, at_ns, SESSION_EVENT_TOPIC, SessionEvent(at_ns, kind, phase, text)


def write_recording(
    out: Path,
    metadata: Mapping[str, Mapping[str, str]],
    attachments: Sequence[Attachment],
    board: BoardId,
    imu: ImuStream,
    messages: Iterable[DatedMessage],
) -> Path:
    """Write a recording and return its path.

    The messages are in the order of their log times.

    Raises:
        UsageError: `out` exists.
        MachineError: the disk cannot be written.
    """
    writer = RecordingWriter(out, metadata, attachments)
    try:
        pending = iter(messages)
        next_message = next(pending, None)
        for start in range(0, imu.row.size, SAMPLES_PER_WRITE):
            part = slice(start, start + SAMPLES_PER_WRITE)
            last_ns = int(imu.host_time_ns[part][-1])
            writer.write_imu_array(
                board,
                host_time_ns=imu.host_time_ns[part],
                publish_time_ns=None,
                device_time=imu.device_time[part],
                sequence=imu.row[part] & 0xFFFFFFFF,
                status=imu.status[part],
                temperature=imu.temperature[part],
                gyro=imu.gyro[part],
                accel=imu.accel[part] if imu.accel is not None else None,
            )
            while next_message is not None and next_message[0] <= last_ns:
                _write_message(writer, next_message)
                next_message = next(pending, None)
        while next_message is not None:
            _write_message(writer, next_message)
            next_message = next(pending, None)
        return writer.close()
    except (GyrorigError, ValueError, KeyboardInterrupt):
        writer.path.unlink(missing_ok=True)
        raise


def _write_message(writer: RecordingWriter, dated: DatedMessage) -> None:
    log_ns, publish_ns, topic, message = dated
    writer.write(topic, message, log_ns, publish_ns)
