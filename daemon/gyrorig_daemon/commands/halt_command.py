"""`gyrorigd halt`: the port and baud rate come from a configuration that may be damaged.

It does not need the other commands' imports, because it must act at once.
"""

import json
import re
from pathlib import Path
from typing import Any

import click

from gyrorig_daemon.commands.terminal import CONTEXT
from gyrorig_daemon.halt.standalone_halt import USUAL_BAUDS, halt_unit
from gyrorig_protocol.errors import UsageError

EMULATED, TERMINAL = "emulated", "terminal"  # as in `config`, whose imports are not wanted here
_LARGEST_BYTES = 4_000_000
_BAUDS = range(600, 2_000_001)
# For a document that is not valid YAML: the section `ptu:` and its entries.
_SECTION = re.compile(r"^ptu[ \t]*:(.*(?:\n(?:[ \t#].*)?)*)", re.MULTILINE)
_COMMENT = re.compile(r"(?:^|(?<=\s))#.*", re.MULTILINE)
_ENTRY = r"(?:^|[\s{,])%s[ \t]*:[ \t]*[\"']?([^\s\"',{}#]+)"


@click.command(
    "halt", context_settings=CONTEXT, short_help="Stop the unit, even without the daemon."
)
@click.option(
    "--config",
    "config_path",
    type=click.Path(path_type=Path),
    help="The rig file (YAML).  [default: none; --port is then needed]",
)
@click.option(
    "--port",
    help=("The port of the unit, such as /dev/ttyUSB0.  [default: the port in the rig file]"),
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def halt_command(config_path: Path | None, port: str | None, as_json: bool) -> None:
    r"""Halt the pan-tilt unit and confirm that it has stopped, even without the daemon.

    The command opens the unit's port itself, tries the configured baud rate and then the usual
    ones, and ends within a few seconds. It needs only ptu.port and ptu.baud of the
    configuration.

    \b
    Example:
      gyrorigd halt --config config/rig-raspberrypi.yaml
    """
    configured_port, baud = (
        (None, None) if config_path is None else _read_port_and_baud(config_path, port is not None)
    )
    unit_port = port or configured_port
    if unit_port is None:
        raise UsageError(
            "the command does not know the port of the pan-tilt unit",
            "give the rig file with --config, or the port with --port, for example --port "
            "/dev/ttyUSB0",
        )
    if unit_port in (EMULATED, TERMINAL):
        kind = "emulated" if unit_port == EMULATED else "replaced by a person"
        _print_result(
            f"The pan-tilt unit of this rig is {kind}, so there is nothing to halt.",
            {"halted": False},
            as_json,
        )
        return
    bauds = tuple(dict.fromkeys((baud or USUAL_BAUDS[0], *USUAL_BAUDS)))
    result = halt_unit(unit_port, bauds)
    baud_note = f", not {baud}" if baud not in (None, result.baud) else ""
    _print_result(
        f"The unit on {unit_port} has stopped at pan {result.pan_steps}, tilt {result.tilt_steps} "
        f"steps ({result.baud} baud{baud_note}).",
        {
            "halted": True,
            "port": unit_port,
            "baud": result.baud,
            "pan_steps": result.pan_steps,
            "tilt_steps": result.tilt_steps,
        },
        as_json,
    )


def _print_result(line: str, document: dict[str, Any], as_json: bool) -> None:
    click.echo(json.dumps(document) if as_json else line)


def _read_port_and_baud(path: Path, port_is_given: bool) -> tuple[str | None, int | None]:
    """Return the unit's port and baud rate, as far as the document contains them.

    Raises:
        UsageError: the document cannot be read or has no port, and no port is given.
    """
    try:
        with path.open("rb") as file:
            text = file.read(_LARGEST_BYTES)
    except OSError as fault:
        if port_is_given:
            return None, None
        raise UsageError(
            f"the rig file {path}, which contains the port of the pan-tilt unit, cannot be read "
            f"({fault.strerror})",
            "give the port of the unit with --port",
        ) from fault
    port, baud = _port_and_baud(text, path.name)
    if port is None and not port_is_given:
        from gyrorig_protocol.file_kinds import describe_file_kind  # noqa: PLC0415 - for an error

        raise UsageError(
            f"the rig file {path} does not contain the port of the pan-tilt unit. It is "
            f"{describe_file_kind(text)}",
            "give the port of the unit with --port",
        )
    return port, baud


def _port_and_baud(text: bytes, name: str) -> tuple[str | None, int | None]:
    from gyrorig_protocol.documents import parse_yaml  # noqa: PLC0415 - not with --port alone

    try:
        document = parse_yaml(text, name)
    except UsageError:
        section = _SECTION.search(text.decode("utf-8", errors="replace"))
        entries = {} if section is None else _scan_section(_COMMENT.sub("", section[1]))
    else:
        ptu = document.get("ptu") if isinstance(document, dict) else None
        entries = ptu if isinstance(ptu, dict) else {}
    port, baud = entries.get("port"), entries.get("baud")
    is_valid = isinstance(port, str) and port.isprintable() and 0 < len(port) <= 200
    return port if is_valid else None, baud if isinstance(baud, int) and baud in _BAUDS else None


def _scan_section(section: str) -> dict[str, Any]:
    port = re.search(_ENTRY % "port", section, re.MULTILINE)
    baud = re.search(_ENTRY % "baud", section, re.MULTILINE)
    return {
        "port": None if port is None else port[1],
        "baud": int(baud[1]) if baud is not None and baud[1].isdecimal() else None,
    }
