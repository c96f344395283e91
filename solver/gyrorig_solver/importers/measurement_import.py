"""Importing a measurement file: one file in, one recording out.

What to use when: `import_measurements` for a table or a NumPy archive with an import map;
`read_phases` for the rests and known turns of a map, given by rows, times or a mask.
"""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np

from gyrorig_protocol.documents import dump_yaml
from gyrorig_protocol.errors import InputError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.messages import (
    REFERENCE_ATTITUDE_TOPIC,
    EventKind,
    ReferenceAttitude,
)
from gyrorig_protocol.recording.writer import Attachment
from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.data.clocks.clock_map import map_clock
from gyrorig_solver.importers.import_map import check_import_map
from gyrorig_solver.importers.import_streams import (
    AttitudeStream,
    ImuStream,
    read_streams,
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
from gyrorig_solver.importers.map_columns import MapColumns, open_map_columns
from gyrorig_solver.importers.map_keys import (
    ImportMap,
    MappedTurn,
    SectionFile,
    SectionSpan,
)

MAX_SECTION_FILE_BYTES = 1_000_000


@dataclass(frozen=True, slots=True)
class SessionPhase:
    """One phase of the session, from one sample to another."""

    name: str  # "static" or "turn"
    first_sample: int  # index of the first sample in it
    last_sample: int  # of the last sample in it
    text: str = ""


def read_phases(
    columns: MapColumns, mapping: ImportMap, imu: ImuStream, folder: Path
) -> list[SessionPhase]:
    """Return the phases of a map, sorted by their first samples.

    Raises:
        InputError: a section is outside the data or empty, or the section file is invalid.
    """
    phases = [_phase_of_span("static", span, imu) for span in mapping.static]
    phases += [_phase_of_span("turn", turn.over, imu, turn_text(turn)) for turn in mapping.turns]
    if mapping.sections:
        phases += _phases_from_file(mapping.sections, imu, folder)
    if mapping.static_mask:
        at = columns.of("gyro").matrix([mapping.static_mask.key], 1)[:, 0]
        phases += _phases_from_mask(
            at, mapping.static_mask.value, mapping.static_mask.shortest_s, imu
        )
    return sorted(phases, key=lambda phase: (phase.first_sample, phase.last_sample))


def turn_text(turn: MappedTurn) -> str:
    """Return the text of a known turn in a recording."""
    return json.dumps(
        {
            "axis": [float(v) for v in turn.axis],
            "angle_rad": float(np.radians(turn.angle_deg)),
            "std_rad": float(np.radians(turn.std_deg)),
        }
    )


def _phase_of_span(name: str, span: SectionSpan, imu: ImuStream, text: str = "") -> SessionPhase:
    first, end = 0, imu.row.size
    if span.start is not None:
        first = int(np.searchsorted(imu.row, span.start))
    if span.end is not None:
        if span.end > imu.row[-1] + 1:
            raise InputError(
                f"a {name} section ends at row {span.end}, but the last row of the data is "
                f"row {imu.row[-1]}",
                "correct the end of the section in the import map",
            )
        end = int(np.searchsorted(imu.row, span.end))
    if span.begin_s is not None:
        first = max(first, int(np.searchsorted(imu.time_s, span.begin_s)))
    if span.end_s is not None:
        end = min(end, int(np.searchsorted(imu.time_s, span.end_s)))
    if end - first < 2:
        raise InputError(
            f"the {name} section from sample {first} to sample {end} contains too few samples",
            "correct the start and the end of the section in the import map",
        )
    return SessionPhase(name, first, end - 1, text)


def _phases_from_file(sections: SectionFile, imu: ImuStream, folder: Path) -> list[SessionPhase]:
    path = folder / sections.name
    try:
        if path.stat().st_size > MAX_SECTION_FILE_BYTES:
            raise InputError(
                f"the section list {path.name} is too large, because it has more than 1 MB",
                "give the correct file as `name` under `sections` in the import map",
            )
        document = json.loads(path.read_bytes())
    except OSError as error:
        raise InputError(
            f"the import map names {sections.name} as the file with the list of sections, but "
            f"{path} cannot be read ({error.strerror})",
            "put this file into the folder of the input file, or correct `name` under `sections` "
            "in the import map",
        ) from error
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"the section list {path.name} is not valid JSON "
            f"({' '.join(str(error).split())[:160]})",
            "correct the section list",
        ) from error
    phases = [
        _phase_of_span("static", _span_from_file(document, key, path.name), imu)
        for key in sections.static
    ]
    for key, turn in sections.turns.items():
        phases.append(
            _phase_of_span("turn", _span_from_file(document, key, path.name), imu, turn_text(turn))
        )
    return phases


def _span_from_file(document: object, key: str, name: str) -> SectionSpan:
    entry = document.get(key) if isinstance(document, dict) else None
    if entry is None:
        raise InputError(
            f"the section list {name} contains no section {key!r}",
            "give the name of an existing section in the import map",
        )
    start, end = (entry.get("start"), entry.get("end")) if isinstance(entry, dict) else (None, None)
    if not isinstance(start, int) or not isinstance(end, int) or not 0 <= start < end:
        raise InputError(
            f"the section {key!r} in the section list {name} does not have a start below its end",
            "write the row numbers `start` and `end` of the section as whole numbers from 0, "
            "with `start` below `end`",
        )
    return SectionSpan(start=start, end=end)


def _phases_from_mask(
    mask: FloatArray, value: float, shortest_s: float, imu: ImuStream
) -> list[SessionPhase]:
    if mask.size <= int(imu.row[-1]):
        raise InputError(
            f"the column of `static_mask`, which marks the rests, has {mask.size} rows, but the "
            f"gyro columns have {int(imu.row[-1]) + 1}",
            "correct `key` under `static_mask` in the import map: its column needs one row per "
            "gyro sample",
        )
    still = np.concatenate([[False], mask[imu.row] == value, [False]])
    edges = np.flatnonzero(np.diff(still.astype(np.int8)))
    phases = []
    for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if imu.time_s[end - 1] - imu.time_s[first] >= shortest_s:
            phases.append(SessionPhase("static", first, end - 1))
    return phases


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
    columns = open_map_columns(source, mapping)
    imu, attitude = read_streams(columns, mapping)
    phases = read_phases(columns, mapping, imu, source.parent)
    arrives_in_bursts = bool(phases) and mapping.time.stamp == "arrival"
    sample_ns = _sample_times_ns(imu) if arrives_in_bursts else imu.host_time_ns
    imu, attitude, sample_ns = _shift_after_zero(imu, attitude, sample_ns)
    metadata = {
        "gyrorig": imported_session_metadata(out),
        f"gyrorig.board.{name}": imu.metadata,
    }
    if attitude is not None and attitude.metadata:
        metadata["gyrorig.reference"] = attitude.metadata
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
