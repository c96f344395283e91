"""`gyrorigd halt`: the port and baud rate come from a configuration that may be damaged.

It does not need the other commands' imports, because it must act at once.
"""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import click

from gyrorig_daemon.commands.terminal import CONTEXT, print_line
from gyrorig_daemon.halt.standalone_halt import USUAL_BAUDS, HaltResult, halt_unit
from gyrorig_protocol.errors import DeviceError, UsageError

DEFAULT_DRIVER = "directed_perception"
EMULATED, TERMINAL = "emulated", "terminal"  # as in `config`, whose imports are not wanted here
_LARGEST_BYTES = 4_000_000
_BAUDS = range(600, 2_000_001)
# For a document that is not valid YAML: the section `ptu:` and its entries.
_SECTION = re.compile(r"^ptu[ \t]*:(.*(?:\n(?:[ \t#].*)?)*)", re.MULTILINE)
_COMMENT = re.compile(r"(?:^|(?<=\s))#.*", re.MULTILINE)
_DRIVER = re.compile(r"[a-z][a-z0-9_]{0,31}")
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
@click.option(
    "--driver",
    help=(
        "The driver of the unit.  [default: the driver in the rig file, otherwise "
        f"{DEFAULT_DRIVER}]"
    ),
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def halt_command(
    config_path: Path | None, port: str | None, driver: str | None, as_json: bool
) -> None:
    r"""Halt the pan-tilt unit and confirm that it has stopped, even without the daemon.

    The command opens the unit's port itself, tries the configured baud rate and then the usual
    ones, and ends within a few seconds. It needs only ptu.port and ptu.baud of the
    configuration.

    \b
    Example:
      gyrorigd halt --config config/rig-raspberrypi.yaml
    """
    configured = _Entries() if config_path is None else _read_entries(config_path, port is not None)
    unit_port, baud = port or configured.port, configured.baud
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
    driver = driver or configured.driver
    if driver == DEFAULT_DRIVER:
        result = halt_unit(unit_port, bauds)
    else:
        result = _halt_with_driver(unit_port, bauds, driver, configured.commands)
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
    print_line(json.dumps(document) if as_json else line)


@dataclass(frozen=True, slots=True)
class _Entries:
    """What the section `ptu` of a rig file contains."""

    port: str | None = None
    baud: int | None = None
    driver: str = DEFAULT_DRIVER
    commands: Mapping[str, str] = field(default_factory=dict)


def _halt_with_driver(
    port: str, bauds: Sequence[int], driver: str, commands: Mapping[str, str]
) -> HaltResult:
    """Halt a unit that has another driver."""
    from gyrorig_daemon.config import PtuPort  # noqa: PLC0415 - not for the usual unit
    from gyrorig_daemon.halt.text_unit_halt import (  # noqa: PLC0415
        halt_text_unit,
        send_halt_bytes,
    )
    from gyrorig_daemon.motion import find_driver  # noqa: PLC0415

    entry = find_driver(driver)
    if entry.language is not None:
        config = PtuPort(port=port, commands=dict(commands))
        return halt_text_unit(port, bauds, entry.language(config))
    if entry.halt_bytes:
        send_halt_bytes(port, bauds, entry.halt_bytes)
        raise DeviceError(
            f"the halt command was sent to {port}, but the driver {driver} cannot confirm without "
            "the daemon that the unit stopped",
            "make sure that the unit has stopped. If it still turns, switch off its power",
        )
    raise UsageError(
        f"the driver {driver} does not state the bytes that halt its unit, so nothing was sent",
        "switch off the power of the unit if it turns. Then add halt_bytes to DRIVER in the module "
        "of the driver",
    )


def _read_entries(path: Path, port_is_given: bool) -> _Entries:
    """Return the unit's entries, as far as the document contains them.

    Raises:
        UsageError: the document cannot be read or has no port, and no port is given.
    """
    try:
        with path.open("rb") as file:
            text = file.read(_LARGEST_BYTES)
    except OSError as fault:
        if port_is_given:
            return _Entries()
        raise UsageError(
            f"the rig file {path}, which contains the port of the pan-tilt unit, cannot be read "
            f"({fault.strerror})",
            "give the port of the unit with --port",
        ) from fault
    entries = _entries(text, path.name)
    if entries.port is None and not port_is_given:
        from gyrorig_protocol.file_kinds import describe_file_kind  # noqa: PLC0415 - for an error

        raise UsageError(
            f"the rig file {path} does not contain the port of the pan-tilt unit. It is "
            f"{describe_file_kind(text)}",
            "give the port of the unit with --port",
        )
    return entries


def _entries(text: bytes, name: str) -> _Entries:
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
    driver, commands = entries.get("driver"), entries.get("commands")
    return _Entries(
        port if is_valid else None,
        baud if isinstance(baud, int) and baud in _BAUDS else None,
        driver if isinstance(driver, str) and _DRIVER.fullmatch(driver) else DEFAULT_DRIVER,
        {str(k): str(v) for k, v in commands.items()} if isinstance(commands, dict) else {},
    )


def _scan_section(section: str) -> dict[str, Any]:
    port = re.search(_ENTRY % "port", section, re.MULTILINE)
    baud = re.search(_ENTRY % "baud", section, re.MULTILINE)
    driver = re.search(_ENTRY % "driver", section, re.MULTILINE)
    return {
        "port": None if port is None else port[1],
        "driver": None if driver is None else driver[1],
        "baud": int(baud[1]) if baud is not None and baud[1].isdecimal() else None,
    }
