"""Split a board's byte stream into frames.

Theory of operation: no zero stands inside a frame, so every zero is a border, and after
any damage the next zero is a fresh start. What stands between two zeros is unstuffed,
checked, and only then looked at. A piece longer than any frame is reported once, when it
becomes too long, and dropped up to the next zero.

Contract: device bytes raise nothing. What is no frame is a `FrameFault` event, counted by
cause; the events do not depend on where the stream was cut; memory stays below
`MAX_STUFFED_BYTES`.
"""

from gyrorig_protocol.board import cobs
from gyrorig_protocol.board.crc import CRC_BYTES, crc16
from gyrorig_protocol.board.decode import decode_payload
from gyrorig_protocol.board.events import BoardEvent, FaultCause, FrameEvent, FrameFault
from gyrorig_protocol.board.pieces import PieceSplitter
from gyrorig_protocol.board.wire import DELIMITER, MAX_STUFFED_BYTES


class FrameParser:
    """Split a board's bytes into frames and faults.

    Feed it whatever the port returned, in any pieces: device bytes raise nothing.
    """

    def __init__(self) -> None:
        self._splitter = PieceSplitter(DELIMITER, MAX_STUFFED_BYTES)
        self.frames = 0
        self.faults = dict.fromkeys(FaultCause, 0)

    @property
    def buffered_bytes(self) -> int:
        """How much of an unfinished frame is held, at most `MAX_STUFFED_BYTES`."""
        return self._splitter.buffered_bytes

    def reset(self) -> None:
        """Forget an unfinished frame, as after opening the port anew."""
        self._splitter.reset()

    def feed(self, data: bytes, received_ns: int) -> list[BoardEvent]:
        """Return the events that `data` completes.

        Args:
            data: what one read returned, cut anywhere.
            received_ns: the stamp of that read.
        """
        return [
            self._frame(stuffed, received_ns, offset)
            for stuffed, offset in self._splitter.feed(data)
            if stuffed
        ]

    def _frame(self, stuffed: bytes, received_ns: int, offset: int) -> BoardEvent:
        if len(stuffed) > MAX_STUFFED_BYTES:
            return self._fault(FaultCause.OVERSIZE, received_ns, offset, stuffed)
        checked = cobs.decode(stuffed)
        if checked is None:
            return self._fault(FaultCause.COBS, received_ns, offset, stuffed)
        payload = checked[:-CRC_BYTES]
        if crc16(payload) != int.from_bytes(checked[-CRC_BYTES:], "little") or not payload:
            return self._fault(FaultCause.CRC, received_ns, offset, stuffed)
        frame = decode_payload(payload)
        if isinstance(frame, FaultCause):
            return self._fault(frame, received_ns, offset, stuffed)
        self.frames += 1
        return FrameEvent(frame, received_ns, offset, payload)

    def _fault(self, cause: FaultCause, received_ns: int, offset: int, raw: bytes) -> FrameFault:
        self.faults[cause] += 1
        return FrameFault(cause, received_ns, offset, raw)
