"""`gyrorig import`: convert measurements of another format to a recording."""

from dataclasses import asdict
from pathlib import Path

import click

from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.suggestions import did_you_mean
from gyrorig_solver.commands.project_files import project_file, project_names
from gyrorig_solver.commands.terminal import Terminal, json_option, output_option
from gyrorig_solver.importers import (
    ImportMap,
    ImportOptions,
    MissingMapError,
    formats,
    import_files,
    load_import_map,
)
from gyrorig_solver.storage import limit_input, size_of_inputs


@click.command("import")
@click.argument("words", metavar="[FORMAT] INPUT...", nargs=-1, required=True)
@click.option(
    "--map",
    "map_path",
    type=click.Path(path_type=Path, dir_okay=False),
    help="For files that do not specify what their columns measure: column map (YAML).",
)
@output_option("Recording to write; it must not exist.  [default: name of INPUT with .mcap]")
@click.option("--board", help="Name of the board.  [default: from the input or the map]")
@click.option(
    "--sensor", help="Only if the input does not give it: sensor type, for example MPU-6515."
)
@click.option(
    "--topic",
    "topics",
    multiple=True,
    help="Stream to read if the input has several, for example /imu; can be given twice.",
)
@click.option(
    "--reference",
    type=click.Path(path_type=Path),
    help="For reference attitudes in another file on the same clock; the same as another INPUT.",
)
@click.option(
    "--stamp",
    type=click.Choice(["sampled", "arrival"]),
    help="What the times of INPUT are.  [default: as found]",
)
@click.option(
    "--beside",
    "unit_recording",
    type=click.Path(path_type=Path, dir_okay=False),
    help="For samples without times: recording of the unit that turned the device.",
)
@json_option
@click.pass_obj
def import_command(
    terminal: Terminal,
    words: tuple[str, ...],
    map_path: Path | None,
    out: Path | None,
    board: str | None,
    sensor: str | None,
    topics: tuple[str, ...],
    reference: Path | None,
    stamp: str | None,
    unit_recording: Path | None,
) -> int:
    r"""Convert measurements of another format to a recording.

    INPUT is a file or folder. Its format is found by its content. Several inputs of one
    measurement are joined on one time axis. A table or an archive needs a column map: give it
    with --map, or give the name of a map in config/imports as FORMAT. The page
    reference/import-map.md lists all keys of a map, docs/how-to/import.md lists the formats.

    \b
    Examples:
      gyrorig import bag_folder
      gyrorig import csv drive.csv --map columns.yaml -o drive.mcap
      gyrorig import broad trial02.npz --board IMU-1 -o trial02.mcap
      gyrorig import android Gyroscope.csv --board NEXUS5 --sensor MPU-6515 -o phone.mcap
    """
    kind, sources = _format_and_sources(words)
    mapping = _column_map(kind, map_path)
    format_name = kind if kind in formats() else None
    if reference is not None:
        sources.append(reference)
    out = out or _default_output(sources[0])
    for source in sources:
        terminal.print_progress(f"importing {source.name}")
    try:
        inputs = [*sources, *([unit_recording] if unit_recording else [])]
        with limit_input(sources[0].name, size_of_inputs(inputs)):
            result = import_files(
                sources,
                out,
                ImportOptions(mapping, board, sensor, topics, stamp),
                format_name=format_name,
                unit_recording=unit_recording,
            )
    except MissingMapError as error:
        terminal.print_result(error.sketch.rstrip())
        raise
    plain = {name: str(v) if isinstance(v, Path) else v for name, v in asdict(result).items()}
    terminal.print_result(f"{sources[0].name}: {result.samples} samples of {result.board}")
    terminal.print_result(f"  {result.source}")
    for name, samples in result.other_boards.items():
        terminal.print_result(f"  also        {samples} samples of {name}")
    for note in result.notes:
        terminal.print_result(f"  remark: {note}")
    terminal.print_result(f"  recording   {out}")
    terminal.print_json({**plain, "recording": str(out), "exit_code": 0})
    return 0


def _format_and_sources(words: tuple[str, ...]) -> tuple[str | None, list[Path]]:
    """Return the format, if a person named it, and the inputs.

    Raises:
        UsageError: the format is unknown, or there is no input.
    """
    known = (*formats(), *project_names("imports"))
    first, *rest = words
    if first in known and (rest or not Path(first).exists()):
        if not rest:
            raise UsageError(
                f"the format {first} is given without an input", "give the file to import"
            )
        return first, [Path(word) for word in rest]
    is_name = not Path(first).exists() and not any(mark in first for mark in "./\\")
    if is_name and rest:
        raise UsageError(
            f"the format {first!r:.40} is unknown",
            did_you_mean(first, known) or f"choose one of the formats {', '.join(known)}",
        )
    return None, [Path(word) for word in words]


def _column_map(kind: str | None, map_path: Path | None) -> ImportMap | None:
    """Return the column map that was given or named, None if there is none.

    Raises:
        UsageError: the map is given twice or invalid.
    """
    if kind is None or kind in formats():
        return load_import_map(map_path) if map_path is not None else None
    if map_path is not None:
        raise UsageError(
            f"the format {kind} has a built-in column map, so --map cannot be used with it",
            "remove the option --map, or use the format csv or npz",
        )
    return load_import_map(project_file("imports", f"{kind}.yaml"))


def _default_output(source: Path) -> Path:
    """Return the name of the recording of an input, in the working directory."""
    stem = source.resolve().stem
    return Path(f"{stem}-imported.mcap" if source.suffix == ".mcap" else f"{stem}.mcap")
