"""CAN buses in a rig's document, and what a board on one must say.

What to use when: `document` reads whole rigs; here is what concerns buses alone.

    buses:
      - id: can0
        port: socketcan:can0
    boards:
      - {id: GY80-1, bus: can0, node: 1}
      - id: MTLT-1
        bus: can0
        format: signals
        signals: {preset: j1939, source_address: 128}
        facts: {uid: MTLT-by-hand, odr_hz: 100.0}

A bus's port is `socketcan:NAME`, `udp_multicast:GROUP:PORT` (python-can's format, for where
there is no CAN; `@ADDRESS` behind it names the interface), `python-can:INTERFACE:CHANNEL` for
what else python-can knows, or `emulated`.
"""

import re
from typing import TYPE_CHECKING, Annotated

import msgspec

from gyrorig_daemon.config.names import first_twice
from gyrorig_protocol.can import MAX_NODE, bind
from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.identity import BoardId

if TYPE_CHECKING:
    from gyrorig_daemon.config.document import BoardPort, RigConfig

EMULATED = "emulated"
Node = Annotated[int, msgspec.Meta(ge=1, le=MAX_NODE)]
_PORT = re.compile(
    r"emulated|socketcan:[A-Za-z0-9_.-]{1,15}"
    r"|udp_multicast:(\d{1,3}\.){3}\d{1,3}:\d{1,5}(@(\d{1,3}\.){3}\d{1,3})?"
    r"|python-can:[a-z0-9_]{1,20}:[!-~]{1,50}"
)
# of a sample with its time and its number, with bit stuffing half the worst case
_FRAME_BITS = 123
_LOAD = 0.7  # beyond it frames wait for each other too long (reference: boards.md section 3)


class BusPort(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One CAN bus: its name, its interface, and how often the host gives an edge."""

    id: str
    port: Annotated[str, msgspec.Meta(max_length=80)]
    bitrate: Annotated[int, msgspec.Meta(ge=10_000, le=1_000_000)] = 1_000_000
    sync_hz: Annotated[float, msgspec.Meta(ge=0.1, le=20.0)] = 5.0

    @property
    def hub_port(self) -> str:
        """The name of this bus's port in the hub."""
        return bus_port(self.id)


def bus_port(name: str) -> str:
    """Return the hub's name of a bus's port."""
    return f"bus:{name}"


def check_buses(rig: "RigConfig", name: str) -> None:
    """Refuse buses and boards on them that cannot be meant.

    Raises:
        UsageError: the text says which and why.
    """
    try:
        names = [BoardId(bus.id) for bus in rig.buses]
    except InputError as fault:
        raise UsageError(f"{name}: {fault.what}", fault.remedy) from fault
    if (again := first_twice(names)) is not None:
        raise UsageError(f"{name} names bus {again} twice", "give each bus its own id")
    for bus in rig.buses:
        if not _PORT.fullmatch(bus.port):
            raise UsageError(
                f"{name}: bus {bus.id} has the port {bus.port!r}",
                "write socketcan:NAME, udp_multicast:GROUP:PORT, python-can:INTERFACE:CHANNEL "
                "or emulated",
            )
    taken: dict[tuple[str, int], str] = {}
    for board in rig.boards:
        if not board.bus:
            if board.node is not None or board.signals is not None:
                raise UsageError(
                    f"{name}: board {board.id} has a node or signals but no bus", "give its bus"
                )
            continue
        if board.bus not in names:
            raise UsageError(
                f"{name}: board {board.id} is on bus {board.bus!r}", "list it under buses"
            )
        _check_board(board, name)
        if board.node is not None:
            other = taken.setdefault((board.bus, board.node), board.id)
            if other != board.id:
                raise UsageError(
                    f"{name}: boards {other} and {board.id} on bus {board.bus} have one node, "
                    f"{board.node}",
                    "give each its own, as it is set on the board",
                )
    _check_emulated(rig, name)


def _check_board(board: "BoardPort", name: str) -> None:
    if board.port:
        raise UsageError(f"{name}: board {board.id} has a port and a bus", "leave out one of them")
    if board.format == "text":
        raise UsageError(
            f"{name}: board {board.id} has format: text, which no CAN bus carries",
            "give it format: signals, and which signals, or format: gcb1 and its node",
        )
    if board.format == "gcb1":
        if board.node is None:
            raise UsageError(f"{name}: board {board.id} has no node", f"give node: 1 to {MAX_NODE}")
        if board.signals is not None:
            raise UsageError(
                f"{name}: board {board.id} has signals, and its format is gcb1",
                "give it format: signals, or leave signals out",
            )
        return
    if board.signals is None:
        raise UsageError(
            f"{name}: board {board.id} has format: signals and does not say which",
            "give it signals: preset, or dbc and gyro",
        )
    if not board.facts.uid or not (board.facts.sensor or board.signals.preset):
        raise UsageError(
            f"{name}: board {board.id} cannot say what it is",
            "give it facts: uid (any name of its own) and sensor",
        )
    if board.signals.dbc_file is None:
        bind(board.signals, board.id)


def _check_emulated(rig: "RigConfig", name: str) -> None:
    """Refuse an emulated bus that cannot carry its boards' samples."""
    for bus in rig.buses:
        if bus.port != EMULATED:
            continue
        there = [board for board in rig.boards if board.bus == bus.id]
        for board in there:
            if board.format != "gcb1":
                raise UsageError(
                    f"{name}: board {board.id} is emulated, and such a board sends gcb1",
                    "leave out its format: signals",
                )
        load = len(there) * 2 * rig.emulator.odr_hz * _FRAME_BITS / bus.bitrate
        if load > _LOAD:
            raise UsageError(
                f"{name}: its boards would fill bus {bus.id} by {load:.0%}, and beyond {_LOAD:.0%} "
                "frames wait for each other",
                "give a higher bitrate, fewer boards or a lower emulator: odr_hz",
            )
