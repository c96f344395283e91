"""Phases of an imported recording: rests and known turns, by rows, times or a mask.

What to use when: `read_phases` for all phases of an import map.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data.arrays import FloatArray
from gyrorig_solver.importers.import_map import ImportMap, MappedTurn, SectionFile, SectionSpan
from gyrorig_solver.importers.import_streams import ImuStream
from gyrorig_solver.importers.measurement_columns import MeasurementColumns

MAX_SECTION_FILE_BYTES = 1_000_000


@dataclass(frozen=True, slots=True)
class SessionPhase:
    """One phase of the session, from one sample to another."""

    name: str  # "static" or "turn"
    first_sample: int  # index of the first sample in it
    last_sample: int  # of the last sample in it
    text: str = ""


def read_phases(
    columns: MeasurementColumns, mapping: ImportMap, imu: ImuStream, folder: Path
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
        at = columns.matrix([mapping.static_mask.key], 1)[:, 0]
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
                f"a {name} section ends at row {span.end}, but the last row is {imu.row[-1]}",
                "correct its end in the import map",
            )
        end = int(np.searchsorted(imu.row, span.end))
    if span.begin_s is not None:
        first = max(first, int(np.searchsorted(imu.time_s, span.begin_s)))
    if span.end_s is not None:
        end = min(end, int(np.searchsorted(imu.time_s, span.end_s)))
    if end - first < 2:
        raise InputError(
            f"a {name} section from sample {first} to {end} is empty",
            "correct its start and end in the import map",
        )
    return SessionPhase(name, first, end - 1, text)


def _phases_from_file(sections: SectionFile, imu: ImuStream, folder: Path) -> list[SessionPhase]:
    path = folder / sections.name
    try:
        if path.stat().st_size > MAX_SECTION_FILE_BYTES:
            raise InputError(
                f"{path.name} is larger than 1 MB, which is too large for a list of sections",
                "give the correct file as `name` under `sections` in the import map",
            )
        document = json.loads(path.read_bytes())
    except OSError as error:
        raise InputError(
            f"cannot read the section list {path}, {error.strerror}",
            "put it into the folder of the input, and give its name as `name` under `sections` in "
            "the import map",
        ) from error
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"{path.name} is not valid JSON, {' '.join(str(error).split())[:160]}",
            "correct the file",
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
    start, end = (entry.get("start"), entry.get("end")) if isinstance(entry, dict) else (None, None)
    if not isinstance(start, int) or not isinstance(end, int) or not 0 <= start < end:
        raise InputError(
            f"{name} has no section {key!r} with a start below its end",
            "give the name of an existing section in the import map",
        )
    return SectionSpan(start=start, end=end)


def _phases_from_mask(
    mask: FloatArray, value: float, shortest_s: float, imu: ImuStream
) -> list[SessionPhase]:
    if mask.size <= int(imu.row[-1]):
        raise InputError(
            f"the static mask has {mask.size} rows, but the gyro has {int(imu.row[-1]) + 1}",
            "give a column with one row per sample as `key` under `static_mask`",
        )
    still = np.concatenate([[False], mask[imu.row] == value, [False]])
    edges = np.flatnonzero(np.diff(still.astype(np.int8)))
    phases = []
    for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if imu.time_s[end - 1] - imu.time_s[first] >= shortest_s:
            phases.append(SessionPhase("static", first, end - 1))
    return phases
