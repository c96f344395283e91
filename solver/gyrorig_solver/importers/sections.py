"""Phases of an imported recording: rests and known turns, by rows, times or a mask."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.importers.columns import Columns
from gyrorig_solver.importers.mapping import ImportMap, SectionFile, Span, Turn
from gyrorig_solver.importers.streams import ImuStream

MAX_SECTION_FILE_BYTES = 1_000_000


@dataclass(frozen=True, slots=True)
class Phase:
    """One phase of the session, from sample to sample."""

    name: str  # static or turn
    first: int  # index into the stream's samples
    last: int  # of the last sample in it
    text: str = ""


def read_phases(columns: Columns, mapping: ImportMap, imu: ImuStream, folder: Path) -> list[Phase]:
    """Return the phases that the map speaks of, in the order of their beginnings.

    Raises:
        InputError: a section lies outside the data, is empty, or its list is no list.
    """
    phases = [_phase("static", span, imu) for span in mapping.static]
    phases += [_phase("turn", turn.over, imu, turn_text(turn)) for turn in mapping.turns]
    if mapping.sections:
        phases += _listed(mapping.sections, imu, folder)
    if mapping.static_mask:
        at = columns.matrix([mapping.static_mask.key], 1)[:, 0]
        phases += _masked(at, mapping.static_mask.value, mapping.static_mask.shortest_s, imu)
    return sorted(phases, key=lambda phase: (phase.first, phase.last))


def turn_text(turn: Turn) -> str:
    """Return a known turn as the recording contract writes it."""
    return json.dumps(
        {
            "axis": [float(v) for v in turn.axis],
            "angle_rad": float(np.radians(turn.angle_deg)),
            "std_rad": float(np.radians(turn.std_deg)),
        }
    )


def _phase(name: str, span: Span, imu: ImuStream, text: str = "") -> Phase:
    first, end = 0, imu.row.size
    if span.start is not None:
        first = int(np.searchsorted(imu.row, span.start))
    if span.end is not None:
        if span.end > imu.row[-1] + 1:
            raise InputError(
                f"a {name} section ends at row {span.end}, and there are {imu.row[-1] + 1}",
                "correct its end in the map",
            )
        end = int(np.searchsorted(imu.row, span.end))
    if span.begin_s is not None:
        first = max(first, int(np.searchsorted(imu.time_s, span.begin_s)))
    if span.end_s is not None:
        end = min(end, int(np.searchsorted(imu.time_s, span.end_s)))
    if end - first < 2:
        raise InputError(
            f"a {name} section from sample {first} to {end} is empty",
            "correct its start and end in the map",
        )
    return Phase(name, first, end - 1, text)


def _listed(sections: SectionFile, imu: ImuStream, folder: Path) -> list[Phase]:
    path = folder / sections.name
    try:
        if path.stat().st_size > MAX_SECTION_FILE_BYTES:
            raise InputError(
                f"{path.name} is larger than 1 MB, and no list of sections is",
                "name the right file under sections: name in the map",
            )
        found = json.loads(path.read_bytes())
    except OSError as error:
        raise InputError(
            f"cannot read the section list {path}, {error.strerror}",
            "put it beside the input, under the name that the map gives (sections: name)",
        ) from error
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"{path.name} is no JSON, {' '.join(str(error).split())[:160]}", "mend it there"
        ) from error
    phases = [_phase("static", _span(found, key, path.name), imu) for key in sections.static]
    for key, turn in sections.turns.items():
        phases.append(_phase("turn", _span(found, key, path.name), imu, turn_text(turn)))
    return phases


def _span(found: object, key: str, name: str) -> Span:
    entry = found.get(key) if isinstance(found, dict) else None
    start, end = (entry.get("start"), entry.get("end")) if isinstance(entry, dict) else (None, None)
    if not isinstance(start, int) or not isinstance(end, int) or not 0 <= start < end:
        raise InputError(
            f"{name} has no section {key!r} with start and end",
            "name one in the map that it has, with start below end",
        )
    return Span(start=start, end=end)


def _masked(mask: FloatArray, value: float, shortest_s: float, imu: ImuStream) -> list[Phase]:
    if mask.size <= int(imu.row[-1]):
        raise InputError(
            f"the static mask has {mask.size} rows, and the gyro {int(imu.row[-1]) + 1}",
            "name a column with a row for each sample under static_mask: key",
        )
    still = np.concatenate([[False], mask[imu.row] == value, [False]])
    edges = np.flatnonzero(np.diff(still.astype(np.int8)))
    phases = []
    for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if imu.time_s[end - 1] - imu.time_s[first] >= shortest_s:
            phases.append(Phase("static", first, end - 1))
    return phases
