"""Conversion of the columns of a table to measured streams, by an import map.

What to use when: `read_mapped_streams` for all streams and phases of one input; `turn_text` for
the text of a known turn.
"""

import json
from pathlib import Path

import msgspec
import numpy as np

from gyrorig_protocol.documents import dump_yaml
from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.writer import Attachment
from gyrorig_solver.data import FloatArray
from gyrorig_solver.importers.import_times import read_times, sample_rate
from gyrorig_solver.importers.map_columns import MapColumns
from gyrorig_solver.importers.map_keys import (
    AccelColumns,
    AttitudeColumns,
    GyroColumns,
    ImportMap,
    MappedTurn,
    SectionFile,
    SectionSpan,
    TemperatureColumn,
)
from gyrorig_solver.importers.matrix_attitudes import quaternions_of_matrices
from gyrorig_solver.importers.measured_streams import (
    LENGTH_TOLERANCE,
    STANDARD_GRAVITY_M_S2,
    AccelStream,
    GyroStream,
    MeasuredBoard,
    MeasuredPhase,
    MeasuredStreams,
    PoseStream,
    TemperatureStream,
)
from gyrorig_solver.importers.measurement_columns import MeasurementColumns

MAX_SECTION_FILE_BYTES = 1_000_000


def read_mapped_streams(columns: MapColumns, mapping: ImportMap, source: Path) -> MeasuredStreams:
    """Return the samples, the reference attitude and the phases of one input.

    Args:
        columns: the columns of every stream.
        mapping: the meaning of the columns.
        source: the input; the section list is in the same folder.

    Raises:
        InputError: times decrease, a section is invalid, or there is no usable data.
    """
    rows = columns.of("gyro")
    gyro = rows.matrix(mapping.gyro.keys, 3)
    time_s = read_times(rows, mapping.time, len(gyro), "gyro")
    has_rate = mapping.time.rate_hz is not None or mapping.time.rate_key is not None
    stream = GyroStream(
        time_s,
        _gyro_values(gyro, mapping.gyro),
        scale_rad_s=mapping.gyro.scale_rad_s if mapping.gyro.unit == "counts" else None,
        stamp=mapping.time.stamp,
        rate_hz=sample_rate(rows, mapping.time) if has_rate else None,
    )
    metadata = {"uid": mapping.uid, "sensor": mapping.sensor}
    metadata |= {"model": mapping.model} if mapping.model else {}
    for key in ("full_scale_dps", "bandwidth_hz"):
        value = getattr(mapping.gyro, key)
        if value is not None:
            metadata["gyro_" + key if key == "full_scale_dps" else key] = repr(value)
    board = MeasuredBoard(
        mapping.board,
        stream,
        _accel_stream(columns.of("accel"), mapping.accel, len(gyro)) if mapping.accel else None,
        _temperature_stream(columns.of("temperature"), mapping.temperature, len(gyro))
        if mapping.temperature
        else None,
        metadata,
    )
    map_text = dump_yaml(msgspec.to_builtins(mapping))
    return MeasuredStreams(
        source=f"imported from {source.name}",
        boards=(board,),
        poses=_pose_stream(columns.of("attitude"), mapping.attitude, time_s)
        if mapping.attitude
        else None,
        phases=tuple(_read_phases(rows, mapping, stream, source.parent)),
        gravity_m_s2=mapping.gravity_m_s2,
        attachments=(Attachment("import-map.yaml", "application/yaml", map_text.encode()),),
    )


def _gyro_values(gyro: FloatArray, part: GyroColumns) -> FloatArray:
    if part.unit == "counts":
        return np.asarray(gyro - np.asarray(part.offset_counts))
    gyro = gyro - np.asarray(part.zero)
    return np.asarray(np.radians(gyro)) if part.unit == "deg/s" else gyro


def _accel_stream(columns: MeasurementColumns, part: AccelColumns, rows: int) -> AccelStream:
    values = columns.matrix(part.keys, 3)
    if part.time is None:
        _check_rows(len(values), rows, "accel")
    time_s = read_times(columns, part.time, len(values), "accel") if part.time else None
    stamp = part.time.stamp if part.time else "sampled"
    if part.unit == "counts":
        counts = values - np.asarray(part.offset_counts)
        return AccelStream(counts, time_s, part.scale_m_s2, stamp)
    values = values - np.asarray(part.zero)
    unit_m_s2 = STANDARD_GRAVITY_M_S2 if part.unit == "g" else 1.0
    return AccelStream(values * unit_m_s2, time_s, stamp=stamp)


def _temperature_stream(
    columns: MeasurementColumns, part: TemperatureColumn, rows: int
) -> TemperatureStream:
    values = columns.matrix([part.key], 1)[:, 0]
    if part.time is None:
        _check_rows(len(values), rows, "temperature")
    time_s = read_times(columns, part.time, len(values), "temperature") if part.time else None
    return TemperatureStream(values, time_s, part.time.stamp if part.time else "sampled")


def _pose_stream(
    columns: MeasurementColumns, part: AttitudeColumns, time_s: FloatArray
) -> PoseStream:
    if part.order == "matrix":
        values = quaternions_of_matrices(columns.matrix(part.keys, 9))
    else:
        values = columns.matrix(part.keys, 4)
    if part.order == "wxyz":
        values = values[:, [1, 2, 3, 0]]
    if part.maps == "world_to_body":
        values = values * [-1.0, -1.0, -1.0, 1.0]
    if part.time is not None:
        base_s = read_times(columns, part.time, len(values), "attitude")
    else:
        _check_rows(len(values), time_s.size, "attitude")
        base_s = time_s
    is_finite = np.all(np.isfinite(values), axis=1)
    length = np.linalg.norm(values[is_finite], axis=1)
    if not length.size:
        raise InputError(
            "no row of the attitude columns contains numbers only",
            "correct `keys` under `attitude` in the import map",
        )
    if np.any(np.abs(length - 1.0) > LENGTH_TOLERANCE):
        wrong = int(np.argmax(np.abs(length - 1.0)))
        raise InputError(
            f"row {int(np.flatnonzero(is_finite)[wrong]) + 1} of the attitude columns has the "
            f"length {length[wrong]:.4g}, but a quaternion of an attitude has the length 1",
            "give the four columns of the quaternion as `keys` under `attitude` in the import map",
        )
    return PoseStream(
        base_s[is_finite],
        values[is_finite] / length[:, None],
        float(np.radians(part.std_deg)) if part.std_deg else float("nan"),
        part.time.stamp if part.time else "sampled",
        part.time.rate_hz if part.time else None,
        int((~is_finite).sum()),
    )


def _check_rows(rows: int, gyro_rows: int, stream: str) -> None:
    if rows != gyro_rows:
        columns = f"the {stream} columns have {rows} rows"
        raise InputError(
            f"{columns}, but the gyro columns have {gyro_rows}",
            f"give the times of the {stream} rows with the key `time` under `{stream}` in the "
            "import map",
        )


def turn_text(turn: MappedTurn) -> str:
    """Return the text of a known turn in a recording."""
    return json.dumps(
        {
            "axis": [float(v) for v in turn.axis],
            "angle_rad": float(np.radians(turn.angle_deg)),
            "std_rad": float(np.radians(turn.std_deg)),
        }
    )


def _read_phases(
    columns: MeasurementColumns, mapping: ImportMap, gyro: GyroStream, folder: Path
) -> list[MeasuredPhase]:
    board = mapping.board
    phases = [MeasuredPhase("static", board, span) for span in mapping.static]
    phases += [MeasuredPhase("turn", board, turn.over, turn_text(turn)) for turn in mapping.turns]
    if mapping.sections:
        phases += _phases_from_file(mapping.sections, board, folder)
    if mapping.static_mask:
        at = columns.matrix([mapping.static_mask.key], 1)[:, 0]
        spans = _rests_of_mask(at, mapping.static_mask.value, mapping.static_mask.shortest_s, gyro)
        phases += [MeasuredPhase("static", board, span) for span in spans]
    return phases


def _phases_from_file(sections: SectionFile, board: str, folder: Path) -> list[MeasuredPhase]:
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
        MeasuredPhase("static", board, _span_from_file(document, key, path.name))
        for key in sections.static
    ]
    for key, turn in sections.turns.items():
        span = _span_from_file(document, key, path.name)
        phases.append(MeasuredPhase("turn", board, span, turn_text(turn)))
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


def _rests_of_mask(
    mask: FloatArray, value: float, shortest_s: float, gyro: GyroStream
) -> list[SectionSpan]:
    if mask.size != len(gyro.values):
        raise InputError(
            f"the column of `static_mask`, which marks the rests, has {mask.size} rows, but the "
            f"gyro columns have {len(gyro.values)}",
            "correct `key` under `static_mask` in the import map: its column needs one row per "
            "gyro sample",
        )
    row = np.flatnonzero(np.all(np.isfinite(gyro.values), axis=1))
    still = np.concatenate([[False], mask[row] == value, [False]])
    edges = np.flatnonzero(np.diff(still.astype(np.int8)))
    spans = []
    for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if gyro.time_s[row[end - 1]] - gyro.time_s[row[first]] >= shortest_s:
            spans.append(SectionSpan(start=int(row[first]), end=int(row[end - 1]) + 1))
    return spans
