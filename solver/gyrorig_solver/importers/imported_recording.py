"""Writing an imported recording: samples and other messages in the order of time.

What to use when: `write_streams` for measured streams of any format. The whole input is checked
before anything is written; after an error no file remains.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gyrorig_protocol.errors import GyrorigError, InputError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.messages import (
    REFERENCE_ATTITUDE_TOPIC,
    SESSION_EVENT_TOPIC,
    EventKind,
    Message,
    ReferenceAttitude,
    SessionEvent,
)
from gyrorig_protocol.recording.writer import Attachment, RecordingWriter
from gyrorig_solver.data import IntArray
from gyrorig_solver.data.clocks.clock_map import map_clock
from gyrorig_solver.importers.beside_unit import UnitRecording
from gyrorig_solver.importers.board_names import check_unique
from gyrorig_solver.importers.import_times import check_times, nanoseconds
from gyrorig_solver.importers.imported_phases import SessionPhase, find_phases
from gyrorig_solver.importers.measured_streams import (
    MeasuredBoard,
    MeasuredPhase,
    MeasuredStreams,
    PoseStream,
)
from gyrorig_solver.importers.plausible_rates import rate_warnings
from gyrorig_solver.importers.sample_encoding import ImuStream, encode_samples

NS = 1_000_000_000
SAMPLES_PER_WRITE = 4096  # about ten seconds of a fast board between two other messages

DatedMessage = tuple[int, int, str, Message]  # log time, publish time, topic, message


@dataclass(frozen=True, slots=True)
class ImportSummary:
    """Counts of what an import wrote and left out."""

    path: Path
    board: str  # the first one
    samples: int
    duration_s: float
    attitudes: int
    attitudes_lost: int
    rests: int
    turns: int
    notes: tuple[str, ...]
    source: str  # what was read, for example "imported from log.csv"
    other_boards: dict[str, int]  # their samples


def write_streams(
    streams: MeasuredStreams, out: Path, unit_recording: Path | None = None
) -> ImportSummary:
    """Write measured streams as a recording.

    Args:
        streams: with at least one gyro.
        out: the recording, `.mcap`; it must not exist.
        unit_recording: of the unit that turned the first board: the time of its samples is found
            from the motion, and the new recording also has the unit's messages.

    Raises:
        InputError: there is no gyro, or a stream is invalid; nothing is written.
        UsageError: `out` exists or is not named `.mcap`, or two boards have one name.
        MachineError: the disk cannot be written; no file remains.
    """
    _check_recording_name(out)
    boards = [board for board in streams.boards if board.gyro is not None]
    if not boards:
        raise InputError(
            f"the data {streams.source} contain no rates of a gyroscope",
            "give, in addition, a file with the rates of the gyroscope",
        )
    check_unique([board.name for board in boards], streams.source)
    encoded = {BoardId(b.name): encode_samples(b, streams.origin_ns) for b in boards}
    if unit_recording is not None:
        return _write_beside(streams, encoded, boards, out, unit_recording)
    phases, dated_ns = _find_all_phases(streams.phases, boards, encoded)
    poses_ns, pose_notes = _pose_times_ns(streams)
    starts = [int(imu.host_time_ns[0]) for imu in encoded.values()]
    begins = [phase.begin_ns for phase in phases]
    sampled = [int(sample_ns.min()) for sample_ns in dated_ns]
    lowest_ns = min([*starts, *sampled, *begins, *poses_ns[:1].tolist()])
    notes = [*streams.notes, *(note for imu in encoded.values() for note in imu.notes)]
    notes += pose_notes
    for board in boards:
        if board.gyro is not None:
            notes += rate_warnings(board.gyro, streams.poses, board.name)
    shift_ns = NS * -int(min(0, lowest_ns) // NS)
    if shift_ns:
        notes.append(f"all times are shifted by {shift_ns // NS} s, so that none is below 0")
        encoded = {
            name: replace(imu, host_time_ns=imu.host_time_ns + shift_ns)
            for name, imu in encoded.items()
        }
        phases = [
            replace(phase, begin_ns=phase.begin_ns + shift_ns, end_ns=phase.end_ns + shift_ns)
            for phase in phases
        ]
        dated_ns = [sample_ns + shift_ns for sample_ns in dated_ns]
    metadata = {"gyrorig": _session_metadata(out)}
    metadata |= {f"gyrorig.board.{name}": imu.metadata for name, imu in encoded.items()}
    if streams.poses is not None and streams.poses.stamp == "arrival":
        rate_hz = streams.poses.rate_hz
        rate = {} if rate_hz is None else {"rate_hz": repr(rate_hz)}
        metadata["gyrorig.reference"] = {"stamp": "arrival", **rate}
    if streams.gravity_m_s2 is not None:
        metadata["gyrorig.site"] = {"gravity_m_s2": repr(streams.gravity_m_s2)}
    messages = _session_messages([streams.source, *notes], encoded, phases, dated_ns)
    if streams.poses is not None:
        messages += _pose_messages(streams.poses, poses_ns + shift_ns)
    path = _write_recording(out, metadata, streams.attachments, encoded, messages)
    return _summary(path, streams, encoded, phases, notes)


def _write_beside(
    streams: MeasuredStreams,
    encoded: dict[BoardId, ImuStream],
    boards: Sequence[MeasuredBoard],
    out: Path,
    unit_recording: Path,
) -> ImportSummary:
    unit = UnitRecording(unit_recording)
    (name, imu), *others = encoded.items()
    if others or streams.poses is not None or streams.phases:
        raise UsageError(
            f"the data {streams.source} contain more than one board or a separate reference, but "
            "a unit's recording can date only the samples of one board",
            "import without --beside, or choose one board with --topic",
        )
    gyro = boards[0].gyro
    if gyro is None:
        raise ValueError("a board without a gyro")
    unit.check_name(name)
    dated, note = unit.date_samples(imu, gyro)
    notes = [*streams.notes, *imu.notes, note]
    metadata = unit.metadata(out.stem) | {f"gyrorig.board.{name}": imu.metadata}
    messages = unit.copied_messages() + [
        _session_event(unit.start_ns, EventKind.NOTE, "program", text)
        for text in (streams.source, *notes)
    ]
    attachments = (*unit.attachments(), *streams.attachments)
    encoded = {name: dated}
    path = _write_recording(out, metadata, attachments, encoded, messages)
    return _summary(path, streams, encoded, [], notes)


def _summary(
    path: Path,
    streams: MeasuredStreams,
    encoded: Mapping[BoardId, ImuStream],
    phases: Sequence[SessionPhase],
    notes: Sequence[str],
) -> ImportSummary:
    poses = streams.poses
    (name, first), *others = encoded.items()
    return ImportSummary(
        path=path,
        board=str(name),
        samples=first.row.size,
        duration_s=int(first.host_time_ns[-1] - first.host_time_ns[0]) * 1e-9,
        attitudes=poses.time_s.size if poses else 0,
        attitudes_lost=poses.lost if poses else 0,
        rests=sum(phase.name == "static" for phase in phases),
        turns=sum(phase.name == "turn" for phase in phases),
        notes=tuple(notes),
        source=streams.source,
        other_boards={str(other): imu.row.size for other, imu in others},
    )


def _check_recording_name(out: Path) -> None:
    if out.suffix != ".mcap":
        raise UsageError(
            f"the name of the output file {out.name} does not end in .mcap",
            "give a name that ends in .mcap with --output",
        )


def _session_metadata(out: Path) -> dict[str, str]:
    """Return the session metadata of an import; its time starts at the source's origin."""
    return {
        "session": out.stem,
        "rig": "import",
        "anchor_utc_ns": "0",
        "anchor_monotonic_raw_ns": "0",
    }


def _find_all_phases(
    phases: Sequence[MeasuredPhase],
    boards: Sequence[MeasuredBoard],
    encoded: Mapping[BoardId, ImuStream],
) -> tuple[list[SessionPhase], list[IntArray]]:
    """Return the phases of all boards, and the sample times of each board that has phases."""
    session_phases: list[SessionPhase] = []
    dated_ns = []
    for board in boards:
        of_board = [phase for phase in phases if phase.board == board.name]
        if not of_board:
            continue
        imu = encoded[BoardId(board.name)]
        arrives_in_bursts = board.gyro is not None and board.gyro.stamp == "arrival"
        sample_ns = _sample_times_ns(imu) if arrives_in_bursts else imu.host_time_ns
        session_phases += find_phases(of_board, imu, sample_ns)
        dated_ns.append(sample_ns)
    return session_phases, dated_ns


def _sample_times_ns(imu: ImuStream) -> IntArray:
    """Return the sample times of samples that arrived in bursts, by the offline clock map.

    Phases go from sample to sample. By arrival times, a phase would lose the samples that
    were taken before the first one of them arrived.
    """
    first_ns = imu.host_time_ns[0]
    clock = map_clock(
        imu.device_time,
        np.asarray((imu.host_time_ns - first_ns) * 1e-9, dtype=np.float64),
        float(imu.metadata["tick_hz"]),
        int(imu.metadata["counter_bits"]),
    )
    return np.asarray(first_ns + nanoseconds(clock.time_s), dtype=np.int64)


def _session_messages(
    notes: Sequence[str],
    encoded: Mapping[BoardId, ImuStream],
    phases: Sequence[SessionPhase],
    dated_ns: Sequence[IntArray],
) -> list[DatedMessage]:
    """Return the session's events; `dated_ns` are the sample times of boards with phases."""
    times_ns = [*dated_ns, *(imu.host_time_ns for imu in encoded.values())]
    begins, ends = [p.begin_ns for p in phases], [p.end_ns for p in phases]
    start = min([*(int(time_ns[0]) for time_ns in times_ns), *begins])
    end = max([*(int(time_ns[-1]) for time_ns in times_ns), *ends])
    messages = [_session_event(start, EventKind.PHASE_BEGIN, "program", "")]
    messages += [_session_event(start, EventKind.NOTE, "program", text) for text in notes]
    for phase in phases:
        for at_ns, kind in (
            (phase.begin_ns, EventKind.PHASE_BEGIN),
            (phase.end_ns, EventKind.PHASE_END),
        ):
            messages.append(_session_event(at_ns, kind, phase.name, phase.text))
    messages.append(_session_event(end, EventKind.PHASE_END, "program", ""))
    return messages


def _session_event(at_ns: int, kind: EventKind, phase: str, text: str) -> DatedMessage:
    return at_ns, at_ns, SESSION_EVENT_TOPIC, SessionEvent(at_ns, kind, phase, text)


def _pose_times_ns(streams: MeasuredStreams) -> tuple[IntArray, list[str]]:
    """Return the stamps of the attitudes, in order, and a note on what was changed."""
    poses = streams.poses
    if poses is None:
        return np.empty(0, dtype=np.int64), []
    check_times(poses.time_s, streams.origin_ns, "attitude")
    back = int(np.sum(np.diff(poses.time_s) < 0.0))
    if not back:
        return streams.origin_ns + nanoseconds(poses.time_s), []
    from scipy.optimize import isotonic_regression  # noqa: PLC0415 - slow to load

    ordered_s = np.asarray(isotonic_regression(poses.time_s).x, dtype=np.float64)
    note = (
        f"attitude: {back} times go back to before the row above them; they are replaced by "
        "the mean of the times that are not in order, so that the rows stay in order"
    )
    return streams.origin_ns + nanoseconds(ordered_s), [note]


def _pose_messages(poses: PoseStream, time_ns: IntArray) -> list[DatedMessage]:
    messages: list[DatedMessage] = []
    for at_ns, q in zip(time_ns.tolist(), poses.orientation_xyzw.tolist(), strict=True):
        message = ReferenceAttitude(
            at_ns, (q[0], q[1], q[2], q[3]), poses.standard_deviation_rad, 0
        )
        messages.append((at_ns, at_ns, REFERENCE_ATTITUDE_TOPIC, message))
    return messages


def _write_recording(
    out: Path,
    metadata: Mapping[str, Mapping[str, str]],
    attachments: Sequence[Attachment],
    encoded: Mapping[BoardId, ImuStream],
    messages: Iterable[DatedMessage],
) -> Path:
    """Write a recording and return its path.

    Raises:
        UsageError: `out` exists.
        MachineError: the disk cannot be written.
    """
    writer = RecordingWriter(out, metadata, attachments)
    try:
        pending = iter(sorted(messages, key=lambda dated: dated[0]))
        next_message = next(pending, None)
        for name, imu, part in _parts_by_time(encoded):
            last_ns = int(imu.host_time_ns[part][-1])
            writer.write_imu_array(
                name,
                host_time_ns=imu.host_time_ns[part],
                publish_time_ns=None,
                device_time=imu.device_time[part],
                sequence=imu.number[part] & 0xFFFFFFFF,
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


def _parts_by_time(
    encoded: Mapping[BoardId, ImuStream],
) -> list[tuple[BoardId, ImuStream, slice]]:
    """Return parts of the boards' samples, ordered by the times of their last samples."""
    parts = [
        (name, imu, slice(start, start + SAMPLES_PER_WRITE))
        for name, imu in encoded.items()
        for start in range(0, imu.row.size, SAMPLES_PER_WRITE)
    ]
    return sorted(parts, key=lambda part: int(part[1].host_time_ns[part[2]][-1]))


def _write_message(writer: RecordingWriter, dated: DatedMessage) -> None:
    log_ns, publish_ns, topic, message = dated
    writer.write(topic, message, log_ns, publish_ns)
