"""The interface of an emulated board to the protocol that it speaks.

What to use when: subclass `EmulatedProtocol` for another protocol; `find_emulated_protocol` for the
one of a board.
"""

from abc import ABC, abstractmethod
from functools import cache

from gyrorig_daemon.emulator.board import protocols
from gyrorig_daemon.emulator.emulator_settings import BoardSettings
from gyrorig_protocol.board import BoardFrame, FrameParser
from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.module_registry import registered_modules


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
    return {module.PROTOCOL.name: module.PROTOCOL for module in modules}


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
