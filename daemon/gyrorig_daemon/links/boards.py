"""All boards of a rig, each on its port or its bus."""

import random

from gyrorig_daemon.config import RigConfig
from gyrorig_daemon.links.board_link import BoardLink
from gyrorig_daemon.links.board_samples import BoardSinks
from gyrorig_daemon.links.can_board import CanBoardLink
from gyrorig_daemon.links.can_bus import CanBusLink
from gyrorig_daemon.links.capture_clock import CaptureClock
from gyrorig_daemon.links.pump import Pump


def make_boards(
    pump: Pump, config: RigConfig, capture: CaptureClock, sinks: BoardSinks, seed: int
) -> list[BoardLink]:
    """Return the links of all boards in the order of the document, attached to their ports.

    Args:
        pump: serves the ports that `config.ports()` names.
        config: the rig.
        capture: dates everything.
        sinks: where the boards' messages go.
        seed: of the moments at which boards are asked and edges given.
    """
    rng = random.Random(seed)  # noqa: S311 - moments, not secrets
    links: list[BoardLink] = []
    on_bus: dict[str, list[CanBoardLink]] = {}
    for board in config.boards:
        own = random.Random(rng.random())  # noqa: S311
        if board.bus:
            link = CanBoardLink(pump, board, capture, sinks, own)
            on_bus.setdefault(board.bus, []).append(link)
            links.append(link)
        else:
            links.append(BoardLink(pump, board, capture, sinks, own))
    for bus in config.buses:
        own = random.Random(rng.random())  # noqa: S311
        CanBusLink(pump, bus, on_bus.get(bus.id, []), sinks, own)
    return links
