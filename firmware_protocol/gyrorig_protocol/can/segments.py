"""Put the segments of a HELLO together again.

Contract: device bytes raise nothing. A segment out of order drops what was collected and is a
fault; the next segment 0 is a fresh start; memory stays below `MAX_SEGMENTS` segments.
"""

from gyrorig_protocol.board.crc import CRC_BYTES, crc16
from gyrorig_protocol.board.events import FaultCause
from gyrorig_protocol.can.board import LAST_SEGMENT, MAX_SEGMENTS


class SegmentCollector:
    """Collects one text from its segments."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._collecting = False

    def reset(self) -> None:
        """Forget an unfinished text."""
        self._parts.clear()
        self._collecting = False

    def feed(self, data: bytes) -> bytes | FaultCause | None:
        """Take one segment.

        Returns:
            The text that it completes; why it was not taken; None where more is to come, and
            for segments whose beginning was not heard.
        """
        if len(data) < 2:
            self.reset()
            return FaultCause.LENGTH
        number = data[0] & ~LAST_SEGMENT
        if number == 0:
            self._parts.clear()
            self._collecting = True
        elif not self._collecting:
            return None
        if number != len(self._parts) or number >= MAX_SEGMENTS:
            self.reset()
            return FaultCause.CONTENT
        self._parts.append(data[1:])
        if not data[0] & LAST_SEGMENT:
            return None
        whole = b"".join(self._parts)
        self.reset()
        text = whole[:-CRC_BYTES]
        if len(whole) <= CRC_BYTES or crc16(text) != int.from_bytes(whole[-CRC_BYTES:], "little"):
            return FaultCause.CRC
        return text
