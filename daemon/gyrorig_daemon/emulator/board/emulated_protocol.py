"""The interface of an emulated board to the protocol that it speaks.

What to use when: subclass `EmulatedProtocol` for another protocol; `find_emulated_protocol` for the
one of a board.
"""

from abc import ABC, abstractmethod
from functools import cache
from typing import TYPE_CHECKING

from gyrorig_daemon.emulator.board import protocols
from gyrorig_daemon.emulator.emulator_settings import BoardSettings
from gyrorig_protocol.board import BoardFrame, FrameParser
from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.module_registry import registered_modules

if TYPE_CHECKING:  # a board uses its protocol
    from gyrorig_daemon.emulator.board.emulated_can_board import EmulatedCanBoard


class EmulatedProtocol(ABC):
    """What the firmware of an emulated board sends and understands. Instances have no state."""

    name: str  # of the protocol, as `format` in a rig file
    has_batches = False  # several samples in a frame

    @abstractmethod
    def encode(self, frame: BoardFrame, settings: BoardSettings) -> bytes:
        """Return the bytes of a frame, b"" for a frame that the protocol does not have.

        Nearly all frames are `Sample`s. A board that identifies itself also sends `Hello`, and
        it sends `Slow` from time to time. The other frames are its answers.
        """

    def make_parser(self) -> FrameParser | None:
        """Return a parser of the host's requests, None if the board only sends."""
        return None


@cache
def _emulated_protocols() -> dict[str, EmulatedProtocol]:
    modules = registered_modules(protocols, "emulated_protocols")
    candidates = [getattr(module, "PROTOCOL", None) for module in modules]
    return {protocol.name: protocol for protocol in candidates if protocol is not None}


def find_emulated_can_board(name: str) -> "type[EmulatedCanBoard]":
    """Return the emulated board of a protocol on a CAN bus: the `CAN_BOARD` of a module.

    Raises:
        UsageError: emulated boards do not speak it.
    """
    modules = registered_modules(protocols, "emulated_protocols")
    candidates = [getattr(module, "CAN_BOARD", None) for module in modules]
    boards: dict[str, type[EmulatedCanBoard]] = {
        board.protocol_name: board for board in candidates if board is not None
    }
    if name not in boards:
        raise UsageError(
            f"an emulated board does not speak the protocol {name} on a CAN bus",
            f"use one of the formats {', '.join(boards)}",
        )
    return boards[name]


def find_emulated_protocol(name: str) -> EmulatedProtocol:
    """Return the emulated end of a protocol.

    Raises:
        UsageError: emulated boards do not speak it.
    """
    protocol = _emulated_protocols().get(name)
    if protocol is None:
        raise UsageError(
            f"an emulated board does not speak the protocol {name}",
            f"use one of the formats {', '.join(_emulated_protocols())}",
        )
    return protocol
