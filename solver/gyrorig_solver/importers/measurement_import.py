"""Importing a measurement file: one file in, one recording out.

What to use when: `import_measurements` for a table or a NumPy archive with an import map.
"""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np

from gyrorig_protocol.documents import dump_yaml
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.messages import (
    REFERENCE_ATTITUDE_TOPIC,
    EventKind,
    ReferenceAttitude,
)
from gyrorig_protocol.recording.writer import Attachment
from gyrorig_solver.data.arrays import IntArray
from gyrorig_solver.data.clocks.clock_map import map_clock
from gyrorig_solver.importers.import_map import ImportMap, check_import_map
from gyrorig_solver.importers.import_streams import (
    AttitudeStream,
    ImuStream,
    read_streams,
    wanted_keys,
)
from gyrorig_solver.importers.import_times import nanoseconds
from gyrorig_solver.importers.imported_recording import (
    NS,
    DatedMessage,
    ImportSummary,
    check_recording_name,
    imported_session_metadata,
    session_event,
    write_recording,
)
from gyrorig_solver.importers.measurement_columns import open_columns
from gyrorig_solver.importers.session_phases import SessionPhase, read_phases


def import_measurements(
    source: Path, mapping: ImportMap, out: Path, board: str | None = None
) -> ImportSummary:
    """Convert a measurement file to a recording.

    Args:
        source: `.npz` or a text table.
        mapping: meaning of the columns.
        out: the recording, `.mcap`; it must not exist.
        board: name of the board, instead of that in the map.

    Raises:
        InputError: the input does not agree with the map; nothing is written.
        UsageError: the map contradicts itself, or `out` exists or is not named `.mcap`.
        MachineError: the disk cannot be written; no file remains.
    """
    check_recording_name(out)
    mapping = check_import_map(mapping, "import map")
    name = BoardId(board if board is not None else mapping.board)
    columns = open_columns(source, wanted_keys(mapping))
    imu, attitude = read_streams(columns, mapping)
    phases = read_phases(columns, mapping, imu, source.parent)
    arrives_in_bursts = bool(phases) and mapping.time.stamp == "arrival"
    sample_ns = _sample_times_ns(imu) if arrives_in_bursts else imu.host_time_ns
    imu, attitude, sample_ns = _shift_after_zero(imu, attitude, sample_ns)
    metadata = {
        "gyrorig": imported_session_metadata(out),
        f"gyrorig.board.{name}": imu.metadata,
    }
    if mapping.gravity_m_s2 is not None:
        metadata["gyrorig.site"] = {"gravity_m_s2": repr(mapping.gravity_m_s2)}
    map_text = dump_yaml(msgspec.to_builtins(mapping))
    attachment = Attachment("import-map.yaml", "application/yaml", map_text.encode())
    messages = _messages(source, imu, attitude, phases, sample_ns)
    path = write_recording(out, metadata, [attachment], name, imu, messages)
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


def _shift_after_zero(
    imu: ImuStream, attitude: AttitudeStream | None, sample_ns: IntArray
) -> tuple[ImuStream, AttitudeStream | None, IntArray]:
    """Return everything shifted by whole seconds, so that no sample is before time 0."""
    shift_ns = NS * -int(min(0, sample_ns.min()) // NS)
    if shift_ns == 0:
        return imu, attitude, sample_ns
    note = f"all times are shifted by {shift_ns // NS} s, so that none is below 0"
    imu = replace(imu, host_time_ns=imu.host_time_ns + shift_ns, notes=(*imu.notes, note))
    if attitude is not None:
        attitude = replace(attitude, host_time_ns=attitude.host_time_ns + shift_ns)
    return imu, attitude, sample_ns + shift_ns


def _messages(
    source: Path,
    imu: ImuStream,
    attitude: AttitudeStream | None,
    phases: list[SessionPhase],
    sample_ns: IntArray,
) -> list[DatedMessage]:
    """Return all messages other than samples, in the order of time."""
    start = int(min(imu.host_time_ns[0], sample_ns[0]))
    end = int(max(imu.host_time_ns[-1], sample_ns[-1]))
    messages = [session_event(start, EventKind.PHASE_BEGIN, "program", "")]
    messages += [
        session_event(start, EventKind.NOTE, "program", text)
        for text in (f"imported from {source.name}", *imu.notes)
    ]
    for phase in phases:
        begin_ns, end_ns = int(sample_ns[phase.first_sample]), int(sample_ns[phase.last_sample])
        messages.append(session_event(begin_ns, EventKind.PHASE_BEGIN, phase.name, phase.text))
        messages.append(session_event(end_ns, EventKind.PHASE_END, phase.name, phase.text))
    messages.append(session_event(end, EventKind.PHASE_END, "program", ""))
    if attitude is not None:
        for time_ns, q in zip(
            attitude.host_time_ns.tolist(), attitude.orientation_xyzw.tolist(), strict=True
        ):
            message = ReferenceAttitude(
                time_ns, (q[0], q[1], q[2], q[3]), attitude.standard_deviation_rad, 0
            )
            messages.append((time_ns, time_ns, REFERENCE_ATTITUDE_TOPIC, message))
    return sorted(messages, key=lambda dated: dated[0])
