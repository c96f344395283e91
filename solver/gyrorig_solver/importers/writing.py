"""An import from beginning to end: one file in, one recording out, or nothing at all."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np

from gyrorig_protocol.documents import dump_yaml
from gyrorig_protocol.errors import GyrorigError, UsageError
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
from gyrorig_solver.arrays import IntArray
from gyrorig_solver.clocks.mapping import map_clock
from gyrorig_solver.importers.columns import open_columns
from gyrorig_solver.importers.mapping import ImportMap, check_import_map
from gyrorig_solver.importers.sections import Phase, read_phases
from gyrorig_solver.importers.streams import (
    AttitudeStream,
    ImuStream,
    read_streams,
    wanted_keys,
)
from gyrorig_solver.importers.times import nanoseconds

NS = 1_000_000_000
# About ten seconds of a fast board between two looks at the other topics.
SAMPLES_AT_A_TIME = 4096

_Dated = tuple[int, str, Message]


@dataclass(frozen=True, slots=True)
class ImportSummary:
    """What an import made, and what it had to leave out."""

    path: Path
    board: str
    samples: int
    duration_s: float
    attitudes: int
    attitudes_lost: int
    rests: int
    turns: int
    notes: tuple[str, ...]


def import_measurements(
    source: Path, mapping: ImportMap, out: Path, board: str | None = None
) -> ImportSummary:
    """Turn somebody's measurement file into a recording.

    Args:
        source: `.npz` or a text table.
        mapping: which column is what.
        out: the recording, `.mcap`; it must not exist.
        board: name of the board, in place of the map's.

    Raises:
        InputError: the input is not what the map says; nothing is written.
        UsageError: the map contradicts itself, or `out` exists or is not named `.mcap`.
        MachineError: the disk refused; nothing is left.
    """
    if out.suffix != ".mcap":
        raise UsageError(f"{out.name} is no name for a recording", "end it in .mcap")
    mapping = check_import_map(mapping, "import map")
    name = BoardId(board if board is not None else mapping.board)
    columns = open_columns(source, wanted_keys(mapping))
    imu, attitude = read_streams(columns, mapping)
    phases = read_phases(columns, mapping, imu, source.parent)
    in_bursts = bool(phases) and mapping.time.stamp == "arrival"
    taken_ns = _taken_ns(imu) if in_bursts else imu.host_time_ns
    imu, attitude, taken_ns = _not_before_zero(imu, attitude, taken_ns)
    writer = RecordingWriter(out, _metadata(mapping, imu, name, out), [_attached(mapping)])
    try:
        _write(writer, name, imu, _others(source, imu, attitude, phases, taken_ns))
        path = writer.close()
    except (GyrorigError, ValueError, KeyboardInterrupt):
        writer.path.unlink(missing_ok=True)
        raise
    return ImportSummary(
        path=path,
        board=str(name),
        samples=imu.row.size,
        duration_s=float(imu.time_s[-1] - imu.time_s[0]),
        attitudes=attitude.host_time_ns.size if attitude else 0,
        attitudes_lost=attitude.lost if attitude else 0,
        rests=sum(phase.name == "static" for phase in phases),
        turns=sum(phase.name == "turn" for phase in phases),
        notes=imu.notes,
    )


def _metadata(
    mapping: ImportMap, imu: ImuStream, board: BoardId, out: Path
) -> dict[str, dict[str, str]]:
    """Return the records; the anchor is the source's own origin of time."""
    records = {
        "gyrorig": {
            "session": out.stem,
            "rig": "import",
            "anchor_utc_ns": "0",
            "anchor_monotonic_raw_ns": "0",
        },
        f"gyrorig.board.{board}": imu.metadata,
    }
    if mapping.gravity_m_s2 is not None:
        records["gyrorig.site"] = {"gravity_m_s2": repr(mapping.gravity_m_s2)}
    return records


def _attached(mapping: ImportMap) -> Attachment:
    text = dump_yaml(msgspec.to_builtins(mapping))
    return Attachment("import-map.yaml", "application/yaml", text.encode())


def _taken_ns(imu: ImuStream) -> IntArray:
    """Return when samples that came in bursts were taken: by the clock that reads them back.

    A phase is from sample to sample. Dated by arrivals it would lose the samples that
    were taken before the first of them arrived.
    """
    first_ns = imu.host_time_ns[0]
    clock = map_clock(
        imu.device_time,
        np.asarray((imu.host_time_ns - first_ns) * 1e-9, dtype=np.float64),
        float(imu.metadata["tick_hz"]),
        int(imu.metadata["counter_bits"]),
    )
    return np.asarray(first_ns + nanoseconds(clock.time_s), dtype=np.int64)


def _not_before_zero(
    imu: ImuStream, attitude: AttitudeStream | None, taken_ns: IntArray
) -> tuple[ImuStream, AttitudeStream | None, IntArray]:
    """Return all of it later by whole seconds, if a sample was taken before time 0."""
    later_ns = NS * -int(min(0, taken_ns.min()) // NS)
    if later_ns == 0:
        return imu, attitude, taken_ns
    note = f"every time is later by {later_ns // NS} s, so that none is before 0"
    imu = replace(imu, host_time_ns=imu.host_time_ns + later_ns, notes=(*imu.notes, note))
    if attitude is not None:
        attitude = replace(attitude, host_time_ns=attitude.host_time_ns + later_ns)
    return imu, attitude, taken_ns + later_ns


def _others(
    source: Path,
    imu: ImuStream,
    attitude: AttitudeStream | None,
    phases: list[Phase],
    taken_ns: IntArray,
) -> list[_Dated]:
    """Return every message that is no sample, in the order of time."""
    start = int(min(imu.host_time_ns[0], taken_ns[0]))
    end = int(max(imu.host_time_ns[-1], taken_ns[-1]))
    events = [SessionEvent(start, EventKind.PHASE_BEGIN, "program", "")]
    events += [
        SessionEvent(start, EventKind.NOTE, "program", text)
        for text in (f"imported from {source.name}", *imu.notes)
    ]
    for phase in phases:
        begin_ns, end_ns = int(taken_ns[phase.first]), int(taken_ns[phase.last])
        events.append(SessionEvent(begin_ns, EventKind.PHASE_BEGIN, phase.name, phase.text))
        events.append(SessionEvent(end_ns, EventKind.PHASE_END, phase.name, phase.text))
    events.append(SessionEvent(end, EventKind.PHASE_END, "program", ""))
    dated: list[_Dated] = [(e.host_time_ns, SESSION_EVENT_TOPIC, e) for e in events]
    if attitude is not None:
        for time_ns, q in zip(
            attitude.host_time_ns.tolist(), attitude.orientation_xyzw.tolist(), strict=True
        ):
            message = ReferenceAttitude(
                time_ns, (q[0], q[1], q[2], q[3]), attitude.standard_deviation_rad, 0
            )
            dated.append((time_ns, REFERENCE_ATTITUDE_TOPIC, message))
    return sorted(dated, key=lambda one: one[0])


def _write(writer: RecordingWriter, board: BoardId, imu: ImuStream, others: list[_Dated]) -> None:
    waiting: Iterator[_Dated] = iter(others)
    ahead = next(waiting, None)
    for first in range(0, imu.row.size, SAMPLES_AT_A_TIME):
        part = slice(first, first + SAMPLES_AT_A_TIME)
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
        while ahead is not None and ahead[0] <= last_ns:
            writer.write(ahead[1], ahead[2])
            ahead = next(waiting, None)
    while ahead is not None:
        writer.write(ahead[1], ahead[2])
        ahead = next(waiting, None)
