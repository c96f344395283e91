"""CAN buses in a rig document, and the settings of the boards on them.

What to use when: `rig_document` reads whole rigs and uses this module for buses.

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

The port of a bus is `socketcan:NAME`, `udp_multicast:GROUP:PORT` (python-can's format without CAN
hardware; a suffix `@ADDRESS` gives the interface), `python-can:INTERFACE:CHANNEL` for other
interfaces of python-can, or `emulated`.
"""

import re
from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated

import msgspec

from gyrorig_daemon.config.board_settings import validate_protocol
from gyrorig_protocol.can import MAX_NODE
from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.identity import BoardId

if TYPE_CHECKING:
    from gyrorig_daemon.config.rig_document import BoardPort, RigConfig

EMULATED = "emulated"
Node = Annotated[int, msgspec.Meta(ge=1, le=MAX_NODE)]
_PORT_PATTERN = re.compile(
    r"emulated|socketcan:[A-Za-z0-9_.-]{1,15}"
    r"|udp_multicast:(\d{1,3}\.){3}\d{1,3}:\d{1,5}(@(\d{1,3}\.){3}\d{1,3})?"
    r"|python-can:[a-z0-9_]{1,20}:[!-~]{1,50}"
)
# bits of a frame with a sample, with half of the worst-case bit stuffing
_FRAME_BITS = 123
_MAX_BUS_LOAD = 0.7  # beyond this load frames wait too long for arbitration


class BusPort(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One CAN bus: its name, its interface, and the rate of the host's SYNC frames."""

    id: str
    port: Annotated[str, msgspec.Meta(max_length=80)]
    bitrate: Annotated[int, msgspec.Meta(ge=10_000, le=1_000_000)] = 1_000_000
    sync_hz: Annotated[float, msgspec.Meta(ge=0.1, le=20.0)] = 5.0

    @property
    def hub_port(self) -> str:
        """Name of this bus's port in the hub."""
        return bus_port(self.id)


def first_duplicate(names: Iterable[str]) -> str | None:
    """Return the first name that occurs a second time, None if all are different."""
    seen: set[str] = set()
    for name in names:
        if name in seen:
            return name
        seen.add(name)
    return None


def bus_port(name: str) -> str:
    """Return the name of a bus's port in the hub."""
    return f"bus:{name}"


def validate_buses(rig: "RigConfig", name: str) -> None:
    """Reject invalid buses, and boards with invalid bus settings.

    Raises:
        UsageError: the text names the bus or the board, and the reason.
    """
    try:
        names = [BoardId(bus.id) for bus in rig.buses]
    except InputError as error:
        raise UsageError(f"{name}: {error.problem}", error.remedy) from error
    if (duplicate := first_duplicate(names)) is not None:
        raise UsageError(f"{name} defines bus {duplicate} twice", "give each bus a different `id`")
    for bus in rig.buses:
        if not _PORT_PATTERN.fullmatch(bus.port):
            raise UsageError(
                f"{name}: bus {bus.id} has the invalid port {bus.port!r}",
                "write the port as socketcan:NAME, udp_multicast:GROUP:PORT, "
                "python-can:INTERFACE:CHANNEL or emulated",
            )
    board_by_node: dict[tuple[str, int], str] = {}
    for board in rig.boards:
        if not board.bus:
            if board.node is not None or board.signals is not None:
                raise UsageError(
                    f"{name}: board {board.id} has the key `node` or `signals`, but not the "
                    "key `bus`",
                    "add the key `bus` with the id of the board's bus",
                )
            continue
        if board.bus not in names:
            raise UsageError(
                f"{name}: board {board.id} uses the bus {board.bus!r}, but `buses` does not "
                "define it",
                "define the bus under `buses`",
            )
        _validate_board(board, name)
        if board.node is not None:
            other = board_by_node.setdefault((board.bus, board.node), board.id)
            if other != board.id:
                raise UsageError(
                    f"{name}: boards {other} and {board.id} on bus {board.bus} both have the "
                    f"node number {board.node}",
                    "give each board a different `node`, equal to the number that is set on "
                    "the board",
                )
    _validate_emulated_buses(rig, name)


def _validate_board(board: "BoardPort", name: str) -> None:
    if board.port:
        raise UsageError(
            f"{name}: board {board.id} has both the key `port` and the key `bus`",
            "remove one of the two keys",
        )
    validate_protocol(board, name)


def _validate_emulated_buses(rig: "RigConfig", name: str) -> None:
    """Reject an emulated bus without enough capacity for its boards' samples."""
    for bus in rig.buses:
        if bus.port != EMULATED:
            continue
        boards = [board for board in rig.boards if board.bus == bus.id]
        load = len(boards) * 2 * rig.emulator.odr_hz * _FRAME_BITS / bus.bitrate
        if load > _MAX_BUS_LOAD:
            raise UsageError(
                f"{name}: the boards use {load:.0%} of the capacity of bus {bus.id}, and "
                f"frames arrive late above {_MAX_BUS_LOAD:.0%}",
                "use a higher `bitrate`, fewer boards, or a lower `odr_hz` under `emulator`",
            )
