"""GCB1 frames on a serial port: the protocol of this project's firmware."""

from gyrorig_protocol.board import FrameParser, Sample
from gyrorig_protocol.board_protocols.board_protocol import BoardEntry, SerialProtocol


class Gcb1Frames(SerialProtocol):
    """Binary frames with a checksum; the board identifies itself and answers time requests."""

    name = "gcb1"
    description = "frames of the binary format gcb1"
    identifies_itself = True
    answers_time_requests = True
    counter_bits = 32
    sequence_bits = 16
    overhead_bytes = 5  # CRC 2, stuffing 1, delimiters 2
    sample_bytes = len(Sample(0, 0, 0, (0, 0, 0), (0, 0, 0), 0).encode())

    def make_parser(self, board: BoardEntry) -> FrameParser:
        """Return a parser of frames."""
        del board
        return FrameParser()


PROTOCOL = Gcb1Frames()
