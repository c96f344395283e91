"""The firmware of this project: GCB1 frames, requests, and several samples in a frame."""

from gyrorig_daemon.emulator.board.emulated_can_board import EmulatedCanBoard
from gyrorig_daemon.emulator.board.emulated_protocol import EmulatedProtocol
from gyrorig_daemon.emulator.emulator_settings import BoardSettings
from gyrorig_protocol.board import BoardFrame, FrameParser


class EmulatedGcb1(EmulatedProtocol):
    """Sends every frame, and understands every request."""

    name = "gcb1"
    has_batches = True

    def encode(self, frame: BoardFrame, settings: BoardSettings) -> bytes:
        """Return the bytes of a frame."""
        del settings
        return frame.encode()

    def make_parser(self) -> FrameParser:
        """Return a parser of the requests."""
        return FrameParser()


PROTOCOL = EmulatedGcb1()
CAN_BOARD = EmulatedCanBoard
