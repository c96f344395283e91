"""Create the links to all boards of a rig, each on its port or bus."""

import random

from gyrorig_daemon.clocks.capture_clock import CaptureClock
from gyrorig_daemon.config import RigConfig
from gyrorig_daemon.links.boards.board_link import BoardLink
from gyrorig_daemon.links.boards.sample_stream import BoardSinks
from gyrorig_daemon.links.can.can_board_link import CanBoardLink
from gyrorig_daemon.links.can.can_bus_link import CanBusLink
from gyrorig_daemon.links.pump import Pump


def make_board_links(
    pump: Pump, config: RigConfig, capture: CaptureClock, sinks: BoardSinks, seed: int
) -> list[BoardLink]:
    """Return the links in the order of the configuration, attached to their ports.

    Args:
        pump: serves the ports that `config.ports()` names.
        config: the rig.
        capture: the clock of all messages.
        sinks: where the boards' messages go.
        seed: of the random moments of time requests and edges.
    """
    rng = random.Random(seed)  # noqa: S311 - moments, not secrets
    links: list[BoardLink] = []
    boards_by_bus: dict[str, list[CanBoardLink]] = {}
    for board in config.boards:
        link_rng = random.Random(rng.random())  # noqa: S311
        if board.bus:
            link = CanBoardLink(pump, board, capture, sinks, link_rng)
            boards_by_bus.setdefault(board.bus, []).append(link)
            links.append(link)
        else:
            links.append(BoardLink(pump, board, capture, sinks, link_rng))
    for bus in config.buses:
        link_rng = random.Random(rng.random())  # noqa: S311
        CanBusLink(pump, bus, boards_by_bus.get(bus.id, []), sinks, link_rng)
    return links
