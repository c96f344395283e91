"""GCB1 on a CAN bus: the frames of this project's firmware with a CAN controller."""

from gyrorig_protocol.board_protocols.board_protocol import BoardEntry, CanProtocol
from gyrorig_protocol.can import MAX_NODE, CanBoardParser, CanFrame, hello_request_frame
from gyrorig_protocol.errors import UsageError


class Gcb1CanFrames(CanProtocol):
    """The board identifies itself, and reports its clock at the edges of the bus."""

    name = "gcb1"
    description = "CAN frames of the format gcb1"
    identifies_itself = True
    counter_bits = 32
    sequence_bits = 16

    def make_parser(self, board: BoardEntry) -> CanBoardParser:
        """Return a parser of the frames of the board's node."""
        return CanBoardParser(board.node or 0)

    def hello_request(self, board: BoardEntry) -> CanFrame:
        """Return the request to the board's node."""
        return hello_request_frame(board.node or 0)

    def check_settings(self, board: BoardEntry, name: str) -> None:
        """Check that the node is given; see `BoardProtocol.check_settings`."""
        if board.node is None:
            raise UsageError(
                f"{name}: board {board.id} on a CAN bus has no node number",
                f"add the key `node` with a number from 1 to {MAX_NODE}",
            )


PROTOCOL = Gcb1CanFrames()
