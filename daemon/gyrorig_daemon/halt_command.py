"""`gyrorigd halt`: which port and which rates, from a configuration that may be broken.

What to use when: the command itself is `halt_command`; it is apart from `commands` because
that imports the whole daemon, and this has to act at once and when little else works.
"""

import json
import re
from pathlib import Path
from typing import Any

import click

from gyrorig_daemon.halt import USUAL_BAUDS, halt_unit
from gyrorig_protocol.errors import UsageError

EMULATED = "emulated"  # as in `config`, whose imports are not wanted here
_LARGEST_BYTES = 4_000_000
_BAUDS = range(600, 2_000_001)
# Of a document that is no YAML any more: what stands under `ptu:`, and its entries.
_SECTION = re.compile(r"^ptu[ \t]*:(.*(?:\n(?:[ \t#].*)?)*)", re.MULTILINE)
_COMMENT = re.compile(r"(?:^|(?<=\s))#.*", re.MULTILINE)
_ENTRY = r"(?:^|[\s{,])%s[ \t]*:[ \t]*[\"']?([^\s\"',{}#]+)"


@click.command("halt", context_settings={"help_option_names": ["-h", "--help"]})
@click.option(
    "--config",
    "config_path",
    type=click.Path(path_type=Path),
    help="The rig (YAML).  [default: none; then --port is needed]",
)
@click.option(
    "--port", help="The unit's port, such as /dev/ttyUSB0.  [default: that of the configuration]"
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def halt_command(config_path: Path | None, port: str | None, as_json: bool) -> None:
    """Halt the pan-tilt unit and see it stand, whatever has become of the daemon.

    Opens the unit's port itself, at the configured rate and then at the usual ones, and
    ends within a few seconds. Of the configuration only ptu.port and ptu.baud are needed.

    Example: gyrorigd halt --config config/rig-raspberrypi.yaml
    """
    named, baud = (None, None) if config_path is None else _unit_of(config_path, port is not None)
    where = port or named
    if where is None:
        raise UsageError(
            "no port is known to halt a unit on",
            "give --config with the rig's file, or --port, such as --port /dev/ttyUSB0",
        )
    if where == EMULATED:
        _say("the unit of this rig is emulated: nothing to halt", {"halted": False}, as_json)
        return
    bauds = tuple(dict.fromkeys((baud or USUAL_BAUDS[0], *USUAL_BAUDS)))
    stands = halt_unit(where, bauds)
    odd = f", not {baud}" if baud not in (None, stands.baud) else ""
    _say(
        f"the unit on {where} stands at pan {stands.pan_steps}, tilt {stands.tilt_steps} steps "
        f"({stands.baud} baud{odd})",
        {
            "halted": True,
            "port": where,
            "baud": stands.baud,
            "pan_steps": stands.pan_steps,
            "tilt_steps": stands.tilt_steps,
        },
        as_json,
    )


def _say(line: str, document: dict[str, Any], as_json: bool) -> None:
    click.echo(json.dumps(document) if as_json else line)


def _unit_of(path: Path, port_is_told: bool) -> tuple[str | None, int | None]:
    """Return the unit's port and rate as far as the document tells them.

    Raises:
        UsageError: it cannot be read or names no port, and none is told.
    """
    try:
        with path.open("rb") as file:
            text = file.read(_LARGEST_BYTES)
    except OSError as fault:
        if port_is_told:
            return None, None
        raise UsageError(
            f"{path} cannot be read: {fault.strerror}", "name the unit's port with --port"
        ) from fault
    port, baud = _told(text, path.name)
    if port is None and not port_is_told:
        raise UsageError(
            f"{path} does not say on which port the unit is", "name the unit's port with --port"
        )
    return port, baud


def _told(text: bytes, name: str) -> tuple[str | None, int | None]:
    from gyrorig_protocol.documents import parse_yaml  # noqa: PLC0415 - not with --port alone

    try:
        document = parse_yaml(text, name)
    except UsageError:
        section = _SECTION.search(text.decode("utf-8", errors="replace"))
        found = {} if section is None else _scan(_COMMENT.sub("", section[1]))
    else:
        ptu = document.get("ptu") if isinstance(document, dict) else None
        found = ptu if isinstance(ptu, dict) else {}
    port, baud = found.get("port"), found.get("baud")
    sound = isinstance(port, str) and port.isprintable() and 0 < len(port) <= 200
    return port if sound else None, baud if isinstance(baud, int) and baud in _BAUDS else None


def _scan(section: str) -> dict[str, Any]:
    port = re.search(_ENTRY % "port", section, re.MULTILINE)
    baud = re.search(_ENTRY % "baud", section, re.MULTILINE)
    return {
        "port": None if port is None else port[1],
        "baud": int(baud[1]) if baud is not None and baud[1].isdecimal() else None,
    }
