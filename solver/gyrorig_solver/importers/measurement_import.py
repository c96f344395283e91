"""Importing files of measurements: one or several files in, one recording out.

What to use when: `import_files` for any format, found by content or named; `import_measurements`
for a table or an archive with an import map; `join_streams` for the streams of several files.
"""

from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from pathlib import Path

import msgspec

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_solver.data import FloatArray
from gyrorig_solver.importers.board_names import check_unique
from gyrorig_solver.importers.import_map import check_import_map
from gyrorig_solver.importers.imported_recording import ImportSummary, write_streams
from gyrorig_solver.importers.map_keys import ImportMap
from gyrorig_solver.importers.measured_streams import (
    MeasuredBoard,
    MeasuredPhase,
    MeasuredStreams,
)
from gyrorig_solver.importers.measurement_format import (
    ImportOptions,
    MeasurementFormat,
    find_format,
    formats,
)


def import_files(
    sources: Sequence[Path],
    out: Path,
    options: ImportOptions | None = None,
    *,
    format_name: str | None = None,
    unit_recording: Path | None = None,
) -> ImportSummary:
    """Convert one or several files of one measurement to a recording.

    Args:
        sources: files or folders; several are joined on one time axis.
        out: the recording, `.mcap`; it must not exist.
        options: the map, the names and the choices of a person.
        format_name: the format of all sources; None: each source's own, by its content.
        unit_recording: of the unit that turned the device, which dates the device's samples.

    Raises:
        InputError: a source is of no known format, is damaged, or lacks something; nothing is
            written.
        UsageError: an option does not fit, or `out` exists or is not named `.mcap`.
        MachineError: the disk cannot be written; no file remains.
    """
    options = options or ImportOptions()
    for source in sources:
        if not source.exists():
            raise InputError(
                f"the file {source} does not exist", "give the path of a file or folder to import"
            )
    has_map = options.mapping is not None
    chosen = [
        formats()[format_name] if format_name else find_format(source, has_map=has_map)[0]
        for source in sources
    ]
    _check_options(options, chosen)
    parts = [_read(form, source, options) for form, source in zip(chosen, sources, strict=True)]
    return write_streams(join_streams(parts), out, unit_recording)


def import_measurements(
    source: Path, mapping: ImportMap, out: Path, board: str | None = None
) -> ImportSummary:
    """Convert a measurement file to a recording.

    Args:
        source: a text table or an archive that an import map can describe.
        mapping: meaning of the columns.
        out: the recording, `.mcap`; it must not exist.
        board: name of the board, instead of that in the map.

    Raises:
        InputError: the input does not agree with the map; nothing is written.
        UsageError: the map contradicts itself, or `out` exists or is not named `.mcap`.
        MachineError: the disk cannot be written; no file remains.
    """
    mapping = check_import_map(mapping, "import map")
    name = "npz" if source.suffix == ".npz" else "csv"
    return import_files([source], out, ImportOptions(mapping, board), format_name=name)


def _check_options(options: ImportOptions, chosen: Sequence[MeasurementFormat]) -> None:
    """Check that each option that a person gave is used.

    Raises:
        UsageError: no chosen format uses one of them.
    """
    words = {"mapping": "map", "topics": "topic"}
    for field in fields(options):
        if getattr(options, field.name) and not any(
            field.name in form.used_options for form in chosen
        ):
            titles = " and ".join(sorted({form.title for form in chosen}))
            option = f"--{words.get(field.name, field.name)}"
            raise UsageError(
                f"the option {option} has no meaning for this input ({titles})",
                f"remove the option {option}",
            )


def _read(chosen: MeasurementFormat, source: Path, options: ImportOptions) -> MeasuredStreams:
    try:
        return chosen.read(source, options)
    except ModuleNotFoundError as error:
        if not chosen.extra:
            raise
        raise UsageError(
            f"the import of {source.name} ({chosen.title}) needs the Python package "
            f"{error.name}, which is not installed",
            f"run `pip install 'gyrorig[{chosen.extra}]'`",
        ) from error


def join_streams(parts: Sequence[MeasuredStreams]) -> MeasuredStreams:
    """Return the streams of several files on one time axis.

    Boards of the same name complete each other. The first file with a board is the first board.

    Raises:
        InputError: two files have the same stream, or their times do not overlap.
        UsageError: two boards of one file have one name.
    """
    if len(parts) == 1:
        return parts[0]
    for part in parts:
        check_unique([board.name for board in part.boards], part.source)
    origin_ns = min(part.origin_ns for part in parts)
    shifted = [_shift(part, (part.origin_ns - origin_ns) * 1e-9) for part in parts]
    _check_overlap(shifted)
    boards: dict[str, MeasuredBoard] = {}
    for board in (board for part in shifted for board in part.boards):
        known = boards.get(board.name)
        boards[board.name] = board if known is None else _merge_boards(known, board)
    poses = [part.poses for part in shifted if part.poses is not None]
    if len(poses) > 1:
        raise InputError(
            f"{len(poses)} of the files contain reference attitudes, but one recording has one "
            "reference",
            "give only one file with reference attitudes",
        )
    return MeasuredStreams(
        source="; ".join(part.source for part in shifted),
        boards=tuple(boards.values()),
        poses=poses[0] if poses else None,
        phases=tuple(phase for part in shifted for phase in part.phases),
        origin_ns=origin_ns,
        gravity_m_s2=next((p.gravity_m_s2 for p in shifted if p.gravity_m_s2 is not None), None),
        attachments=tuple(attachment for part in shifted for attachment in part.attachments),
        notes=tuple(note for part in shifted for note in part.notes),
    )


def _merge_boards(first: MeasuredBoard, second: MeasuredBoard) -> MeasuredBoard:
    for stream in ("gyro", "accel", "temperature"):
        if getattr(first, stream) is not None and getattr(second, stream) is not None:
            raise InputError(
                f"two of the files contain {stream} data of the board {first.name}",
                "give each file once, or import each file alone with another --board",
            )
    return MeasuredBoard(
        first.name,
        first.gyro or second.gyro,
        first.accel or second.accel,
        first.temperature or second.temperature,
        second.metadata | first.metadata,
    )


def _check_overlap(parts: Sequence[MeasuredStreams]) -> None:
    """Check that every file has times that the first one also covers.

    Raises:
        InputError: two files have no common time, for example because their clocks differ.
    """
    first: tuple[str, float, float] | None = None
    for part in parts:
        times = [time_s for time_s in _all_times(part) if time_s.size]
        if not times:
            continue
        begin_s, end_s = min(float(t[0]) for t in times), max(float(t[-1]) for t in times)
        if first is None:
            first = part.source, begin_s, end_s
        elif begin_s >= first[2] or end_s <= first[1]:
            apart_s = max(begin_s - first[2], first[1] - end_s)
            raise InputError(
                f"the data {first[0]} and the data {part.source} have no common time: they are "
                f"{apart_s:.6g} s apart",
                "give files of the same measurement with times of the same clock, or set "
                "`origin_s` under `time` in an import map",
            )


def _all_times(part: MeasuredStreams) -> Iterator[FloatArray]:
    for board in part.boards:
        for stream in (board.gyro, board.accel, board.temperature):
            if stream is not None and stream.time_s is not None:
                yield stream.time_s
    if part.poses is not None:
        yield part.poses.time_s


def _shift(part: MeasuredStreams, by_s: float) -> MeasuredStreams:
    """Return the streams with all times later by `by_s`."""
    if by_s == 0.0:
        return part
    return replace(
        part,
        boards=tuple(_shift_board(board, by_s) for board in part.boards),
        poses=part.poses and replace(part.poses, time_s=part.poses.time_s + by_s),
        phases=tuple(_shift_phase(phase, by_s) for phase in part.phases),
    )


def _shift_board(board: MeasuredBoard, by_s: float) -> MeasuredBoard:
    gyro, accel, temperature = board.gyro, board.accel, board.temperature
    if gyro is not None:
        gyro = replace(gyro, time_s=gyro.time_s + by_s)
    if accel is not None and accel.time_s is not None:
        accel = replace(accel, time_s=accel.time_s + by_s)
    if temperature is not None and temperature.time_s is not None:
        temperature = replace(temperature, time_s=temperature.time_s + by_s)
    return replace(board, gyro=gyro, accel=accel, temperature=temperature)


def _shift_phase(phase: MeasuredPhase, by_s: float) -> MeasuredPhase:
    begin_s, end_s = phase.span.begin_s, phase.span.end_s
    span = msgspec.structs.replace(
        phase.span,
        begin_s=None if begin_s is None else begin_s + by_s,
        end_s=None if end_s is None else end_s + by_s,
    )
    return replace(phase, span=span)
