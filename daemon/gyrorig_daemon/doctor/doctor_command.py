"""The command `gyrorigd doctor`: runs all checks of a rig and prints their findings.

What to use when: `check_rig` for the findings. A port is first checked without opening it, and
then opened only if it is free and permitted, so that a running service is never disturbed.
"""

import json
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import click

from gyrorig_daemon.clocks.capture_clock import read_host_clocks
from gyrorig_daemon.config import EMULATED, PTU_PORT, BoardPort, RigConfig, load_rig
from gyrorig_daemon.doctor.board_check import check_board
from gyrorig_daemon.doctor.can_bus_check import check_bus
from gyrorig_daemon.doctor.capacity_forecast import (
    RecordingLoad,
    check_capacity,
    check_schedule_can_run,
)
from gyrorig_daemon.doctor.clock_check import check_clocks
from gyrorig_daemon.doctor.computer_check import check_computer
from gyrorig_daemon.doctor.daemon_check import DaemonReport, check_daemon
from gyrorig_daemon.doctor.disk_check import DiskMeasurement, check_disk
from gyrorig_daemon.doctor.finding import EXIT_CODES, Finding, Level, note, worst
from gyrorig_daemon.doctor.port_check import check_port
from gyrorig_daemon.doctor.system_files import SystemFiles
from gyrorig_daemon.doctor.unit_check import SUBJECT as UNIT
from gyrorig_daemon.doctor.unit_check import check_unit
from gyrorig_daemon.service.service_protocol import DEFAULT_SOCKET
from gyrorig_daemon.session.line_writer import escape_controls
from gyrorig_protocol.errors import sentence
from gyrorig_protocol.ptu import Dialect, dialect_features

Report = Callable[[Finding], None]
_LEVEL_NAMES = {Level.OK: "ok", Level.NOTE: "note", Level.WARNING: "warning", Level.FAULT: "FAULT"}
_LEVEL_COLOURS = {
    Level.OK: "green",
    Level.NOTE: "cyan",
    Level.WARNING: "yellow",
    Level.FAULT: "red",
}
DEFAULT_RECORDINGS = Path("/var/lib/gyrorig/recordings")  # systemd/tmpfiles.d


@dataclass(frozen=True, slots=True)
class CheckRequest:
    """What to check."""

    config: RigConfig
    folder: Path  # for recordings
    opens_ports: bool = True  # False: only checks that need no device
    socket: Path = Path(DEFAULT_SOCKET)  # of a service that may be running
    system: SystemFiles = field(default_factory=SystemFiles)


def check_rig(request: CheckRequest, report: Report) -> list[Finding]:
    """Check the rig; `report` receives each finding immediately."""
    findings: list[Finding] = []

    def add(more: list[Finding]) -> None:
        for finding in more:
            findings.append(finding)
            report(finding)

    add(check_computer(request.system))
    add(check_clocks(request.system, read_host_clocks()))
    disk_findings, disk = check_disk(request.folder, request.system)
    add(disk_findings)
    daemon_findings, daemon = check_daemon(request.socket)
    add(daemon_findings)
    samples_hz = sum(
        _check_device(request, name, subject, path, add)
        for name, subject, path in _ports(request.config)
    )
    for bus in request.config.buses:
        add(check_bus(bus, request.system))
        samples_hz += sum(
            _nominal_board_hz(request.config, board) for board in request.config.bus_boards(bus)
        )
    add(_check_forecast(request.config, disk, samples_hz, daemon, findings))
    return findings


def _check_forecast(
    config: RigConfig,
    disk: DiskMeasurement | None,
    samples_hz: float,
    daemon: DaemonReport | None,
    findings: list[Finding],
) -> list[Finding]:
    """Return the forecast that follows from all findings."""
    polls_hz = config.ptu.poll.rate_hz or 1.0 / dialect_features(Dialect.E46).min_command_interval_s
    measured_hz = max(samples_hz, 0.0 if daemon is None else daemon.samples_hz)
    load = RecordingLoad(measured_hz, polls_hz, len(config.boards))
    steps_uncertain = daemon is not None and not daemon.steps_are_sure
    needs_homing = steps_uncertain or any(finding.code == "not_homed" for finding in findings)
    is_held = daemon is not None and daemon.motion_is_locked
    return [
        *check_capacity(disk, load, config.service),
        check_schedule_can_run(
            config.schedule, needs_homing, config.ptu.home_without_asking, is_held
        ),
    ]


def _ports(config: RigConfig) -> list[tuple[str, str, str]]:
    """Return the hub name, the subject and the path of each serial port."""
    boards = [(board.hub_port, f"board {board.id}", board.port) for board in config.serial_boards]
    has_unit = PTU_PORT in config.ports()  # not where a person turns the boards
    return [(PTU_PORT, UNIT, config.ptu.port), *boards] if has_unit else boards


def _check_device(
    request: CheckRequest, name: str, subject: str, path: str, add: Callable[[list[Finding]], None]
) -> float:
    """Check a port and, if it is free, its device; return its samples per second."""
    if path == EMULATED:
        add([note(subject, "emulated", "the device is emulated, so it has no port to check")])
        return _nominal_port_hz(request.config, name)
    findings, state = check_port(subject, path, request.system)
    add(findings)
    if not (request.opens_ports and state.can_open):
        return _nominal_port_hz(request.config, name)
    if name == PTU_PORT:
        add(check_unit(request.config.ptu))
        return 0.0
    board = next(board for board in request.config.serial_boards if board.hub_port == name)
    findings, rate_hz = check_board(board)
    add(findings)
    return rate_hz


def _nominal_port_hz(config: RigConfig, name: str) -> float:
    """Return the nominal samples per second of the boards on one hub port."""
    return sum(
        _nominal_board_hz(config, board) for board in config.boards if board.hub_port == name
    )


def _nominal_board_hz(config: RigConfig, board: BoardPort) -> float:
    """Return the samples per second of a board, by the configuration."""
    emulated_hz = float(config.emulator.odr_hz) if config.is_emulated_board(board) else 0.0
    return board.facts.odr_hz or emulated_hz


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
    help="The rig file (YAML).",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    help=f"Folder for recordings.  [default: {DEFAULT_RECORDINGS} if it exists, else ./recordings]",
)
@click.option(
    "--no-open", is_flag=True, help=("Open no port, and run only the checks that need no device.")
)
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
    click.echo(word + escape_controls(f"{finding.subject}: {finding.what}"))
    if finding.remedy:
        click.echo(f"{'':8}-> {escape_controls(sentence(finding.remedy).rstrip('.'))}")
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
    return (
        f"{' and '.join(counts)}. Correct the faults first. The remedy is shown after each arrow."
    )
