"""The command `gyrorigd doctor`, and how findings are printed."""

import json
import os
import sys
from pathlib import Path

import click

from gyrorig_daemon.config import load_rig
from gyrorig_daemon.doctor.finding import EXIT_CODES, Finding, Level, worst
from gyrorig_daemon.doctor.rig_check import CheckRequest, check_rig
from gyrorig_daemon.service.service_protocol import DEFAULT_SOCKET
from gyrorig_protocol.errors import sentence

_LEVEL_NAMES = {Level.OK: "ok", Level.NOTE: "note", Level.WARNING: "warning", Level.FAULT: "FAULT"}
_LEVEL_COLOURS = {
    Level.OK: "green",
    Level.NOTE: "cyan",
    Level.WARNING: "yellow",
    Level.FAULT: "red",
}
DEFAULT_RECORDINGS = Path("/var/lib/gyrorig/recordings")  # systemd/tmpfiles.d


@click.command(
    "doctor",
    context_settings={"help_option_names": ["-h", "--help"]},
    short_help="Check the computer and every device.",
)
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
    help=f"Folder for recordings.  [default: {DEFAULT_RECORDINGS} if it exists, else ./recordings]",
)
@click.option("--no-open", is_flag=True, help="Open no port; run only the checks that need none.")
@click.option(
    "--socket",
    "socket_path",
    type=click.Path(path_type=Path, dir_okay=False),
    default=Path(DEFAULT_SOCKET),
    show_default=True,
    help="The socket of a running daemon.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def doctor_command(
    config_path: Path, out: Path | None, no_open: bool, socket_path: Path, as_json: bool
) -> int:
    """Check the computer, its disk and clocks, and every port and device of a rig.

    Nothing moves and no setting changes. Ports in use are not opened; a running daemon is queried
    instead. Each problem has a remedy. Exit status: 0: nothing to do; 4: it works now, but a
    known problem will make a later session fail; 1: something does not work; 2: the configuration
    is invalid.

    Example: gyrorigd doctor --config config/rig-raspberrypi.yaml
    """
    config = load_rig(config_path)
    folder = out or (DEFAULT_RECORDINGS if DEFAULT_RECORDINGS.is_dir() else Path("recordings"))
    request = CheckRequest(config, folder, opens_ports=not no_open, socket=socket_path)
    findings = check_rig(request, (lambda _: None) if as_json else _print)
    level = worst(findings)
    if as_json:
        document = {
            "rig": config.rig,
            "worst": level.name.lower(),
            "findings": [finding.to_document() for finding in findings],
        }
        click.echo(json.dumps(document))
    else:
        click.echo(_summary(findings))
    return EXIT_CODES[level]


def _print(finding: Finding) -> None:
    word = f"{_LEVEL_NAMES[finding.level]:<8}"
    if sys.stdout.isatty() and not os.environ.get("NO_COLOR"):
        word = click.style(word, fg=_LEVEL_COLOURS[finding.level])
    click.echo(f"{word}{finding.subject}: {finding.what}")
    if finding.remedy:
        click.echo(f"{'':8}-> {sentence(finding.remedy).rstrip('.')}")
    sys.stdout.flush()


def _summary(findings: list[Finding]) -> str:
    faults = sum(finding.level is Level.FAULT for finding in findings)
    warnings = sum(finding.level is Level.WARNING for finding in findings)
    if not (faults or warnings):
        return "No problems found."
    counts = [
        f"{count} {word}{'s' if count > 1 else ''}"
        for count, word in ((faults, "fault"), (warnings, "warning"))
        if count
    ]
    return f"{' and '.join(counts)}. Fix the faults first. The action is shown after each arrow."
