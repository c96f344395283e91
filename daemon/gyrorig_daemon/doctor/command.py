"""`gyrorigd doctor`: the command, and how findings are printed.

What to use when: `doctor_command` is added to the command line in `commands`.
"""

import json
import os
import sys
from pathlib import Path

import click

from gyrorig_daemon.config import load_rig
from gyrorig_daemon.doctor.examine import Order, examine
from gyrorig_daemon.doctor.finding import EXIT_CODES, Finding, Level, worst
from gyrorig_daemon.service import wire

_WORDS = {Level.OK: "ok", Level.NOTE: "note", Level.WARNING: "warning", Level.FAULT: "FAULT"}
_COLOURS = {Level.OK: "green", Level.NOTE: "cyan", Level.WARNING: "yellow", Level.FAULT: "red"}
STATE_FOLDER = Path("/var/lib/gyrorig/recordings")  # systemd/tmpfiles.d


@click.command("doctor", context_settings={"help_option_names": ["-h", "--help"]})
@click.option(
    "--config",
    "config_path",
    type=click.Path(path_type=Path, dir_okay=False),
    required=True,
    help="The rig (YAML).",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    help=f"Where recordings go.  [default: {STATE_FOLDER} where it is, else ./recordings]",
)
@click.option(
    "--no-open", is_flag=True, help="Open no port: only what can be seen without touching."
)
@click.option(
    "--socket",
    "socket_path",
    type=click.Path(path_type=Path, dir_okay=False),
    default=Path(wire.DEFAULT_SOCKET),
    show_default=True,
    help="The socket at which a running daemon is asked.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def doctor_command(
    config_path: Path, out: Path | None, no_open: bool, socket_path: Path, as_json: bool
) -> int:
    """Examine the computer, its disk and clocks, every port and every device of a rig.

    Nothing moves and nothing is set; ports in use are left alone, and a running daemon is
    asked instead. Each finding that needs something done says what. Exit codes: 0 nothing to
    do; 4 it works, and some night will not; 1 something does not work; 2 the configuration is
    no rig.

    Example: gyrorigd doctor --config config/rig-raspberrypi.yaml
    """
    config = load_rig(config_path)
    folder = out or (STATE_FOLDER if STATE_FOLDER.is_dir() else Path("recordings"))
    order = Order(config, folder, opens_ports=not no_open, socket=socket_path)
    found = examine(order, (lambda _: None) if as_json else _print)
    level = worst(found)
    if as_json:
        document = {
            "rig": config.rig,
            "worst": level.name.lower(),
            "findings": [finding.to_document() for finding in found],
        }
        click.echo(json.dumps(document))
    else:
        click.echo(_sum(found))
    return EXIT_CODES[level]


def _print(finding: Finding) -> None:
    word = f"{_WORDS[finding.level]:<8}"
    if sys.stdout.isatty() and not os.environ.get("NO_COLOR"):
        word = click.style(word, fg=_COLOURS[finding.level])
    click.echo(f"{word}{finding.subject}: {finding.what}")
    if finding.remedy:
        click.echo(f"{'':8}-> {finding.remedy}")
    sys.stdout.flush()


def _sum(found: list[Finding]) -> str:
    faults = sum(finding.level is Level.FAULT for finding in found)
    warnings = sum(finding.level is Level.WARNING for finding in found)
    if not (faults or warnings):
        return "nothing to do"
    told = [
        f"{count} {word}{'s' if count > 1 else ''}"
        for count, word in ((faults, "fault"), (warnings, "warning"))
        if count
    ]
    return f"{' and '.join(told)}; do what stands after the arrows, the faults first"
