"""Runs all checks of a rig, one subject after another.

What to use when: `check_rig`. A port is first checked without opening it, and then opened only if
it is free and permitted, so that a running service is never disturbed.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from gyrorig_daemon.clocks.capture_clock import read_host_clocks
from gyrorig_daemon.config import EMULATED, PTU_PORT, BoardPort, RigConfig
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
from gyrorig_daemon.doctor.finding import Finding, note
from gyrorig_daemon.doctor.port_check import check_port
from gyrorig_daemon.doctor.system_files import SystemFiles
from gyrorig_daemon.doctor.unit_check import SUBJECT as UNIT
from gyrorig_daemon.doctor.unit_check import check_unit
from gyrorig_daemon.service.service_protocol import DEFAULT_SOCKET
from gyrorig_protocol.ptu import Dialect, dialect_features

Report = Callable[[Finding], None]


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
    return [(PTU_PORT, UNIT, config.ptu.port), *boards]


def _check_device(
    request: CheckRequest, name: str, subject: str, path: str, add: Callable[[list[Finding]], None]
) -> float:
    """Check a port and, if it is free, its device; return its samples per second."""
    if path == EMULATED:
        add([note(subject, "emulated", "it is emulated and has no port")])
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
