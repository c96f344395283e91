"""The examination of a whole rig, one subject after another.

What to use when: `examine`. Ports are looked at without opening them first; only one that
is free and permitted is opened, so that a daemon at work is never disturbed.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from gyrorig_daemon.config import EMULATED, PTU_PORT, BoardPort, RigConfig
from gyrorig_daemon.doctor.board import examine_board
from gyrorig_daemon.doctor.bus import examine_bus
from gyrorig_daemon.doctor.disk import Disk, examine_disk
from gyrorig_daemon.doctor.finding import Finding, note
from gyrorig_daemon.doctor.machine import examine_machine
from gyrorig_daemon.doctor.ports import examine_port
from gyrorig_daemon.doctor.running import Running, examine_daemon
from gyrorig_daemon.doctor.system import System
from gyrorig_daemon.doctor.timekeeping import examine_time
from gyrorig_daemon.doctor.tonight import Night, examine_room, examine_schedule
from gyrorig_daemon.doctor.unit import SUBJECT as UNIT
from gyrorig_daemon.doctor.unit import examine_unit
from gyrorig_daemon.links.capture_clock import read_host_clocks
from gyrorig_daemon.service import wire
from gyrorig_protocol.ptu import Dialect, offers

Tell = Callable[[Finding], None]


@dataclass(frozen=True, slots=True)
class Order:
    """What to examine."""

    config: RigConfig
    folder: Path  # where recordings go
    opens_ports: bool = True  # False: only what can be seen without touching a device
    socket: Path = Path(wire.DEFAULT_SOCKET)  # of a daemon that may be at work
    system: System = field(default_factory=System)


def examine(order: Order, tell: Tell) -> list[Finding]:
    """Examine the rig; `tell` hears each finding when it is made."""
    found: list[Finding] = []

    def add(more: list[Finding]) -> None:
        for finding in more:
            found.append(finding)
            tell(finding)

    add(examine_machine(order.system))
    add(examine_time(order.system, read_host_clocks()))
    of_disk, disk = examine_disk(order.folder, order.system)
    add(of_disk)
    of_daemon, running = examine_daemon(order.socket)
    add(of_daemon)
    samples_hz = sum(
        _examine_device(order, name, subject, path, add)
        for name, subject, path in _ports(order.config)
    )
    for bus in order.config.buses:
        add(examine_bus(bus, order.system))
        samples_hz += sum(_nominal_hz(order.config, one) for one in order.config.bus_boards(bus))
    add(_tonight(order.config, disk, samples_hz, running, found))
    return found


def _tonight(
    config: RigConfig,
    disk: Disk | None,
    samples_hz: float,
    running: Running | None,
    found: list[Finding],
) -> list[Finding]:
    """Return what follows from all that was found."""
    polls_hz = config.ptu.poll.rate_hz or 1.0 / offers(Dialect.E46).min_command_interval_s
    heard_hz = max(samples_hz, 0.0 if running is None else running.samples_hz)
    night = Night(heard_hz, polls_hz, len(config.boards))
    unsure = running is not None and not running.steps_are_sure
    needs_homing = unsure or any(finding.code == "not_homed" for finding in found)
    is_held = running is not None and running.is_held
    return [
        *examine_room(disk, night, config.service),
        *examine_schedule(config.schedule, needs_homing, config.ptu.home_without_asking, is_held),
    ]


def _ports(config: RigConfig) -> list[tuple[str, str, str]]:
    """Return the hub's name, the subject and the path of each serial port."""
    boards = [(board.hub_port, f"board {board.id}", board.port) for board in config.serial_boards]
    return [(PTU_PORT, UNIT, config.ptu.port), *boards]


def _examine_device(
    order: Order, name: str, subject: str, path: str, add: Callable[[list[Finding]], None]
) -> float:
    """Examine one port and, where it is free, what is on it; return its samples a second."""
    if path == EMULATED:
        add([note(subject, "emulated", "it is emulated: there is no port to look at")])
        return _nominal_of(order.config, name)
    findings, state = examine_port(subject, path, order.system)
    add(findings)
    if not (order.opens_ports and state.can_open):
        return _nominal_of(order.config, name)
    if name == PTU_PORT:
        add(examine_unit(order.config.ptu))
        return 0.0
    board = next(board for board in order.config.serial_boards if board.hub_port == name)
    findings, rate_hz = examine_board(board)
    add(findings)
    return rate_hz


def _nominal_of(config: RigConfig, name: str) -> float:
    """Return what is to be expected of the boards on one of the hub's ports."""
    return sum(_nominal_hz(config, board) for board in config.boards if board.hub_port == name)


def _nominal_hz(config: RigConfig, board: BoardPort) -> float:
    """Return what the configuration says of a board that was not listened to."""
    emulated_hz = float(config.emulator.odr_hz) if config.is_emulated_board(board) else 0.0
    return board.facts.odr_hz or emulated_hz
