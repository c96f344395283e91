"""Reassembly of a HELLO from its segments.

Contract: received bytes never raise an error. A segment out of order is a fault and drops the
collected segments; the next segment 0 starts again. Memory stays below `MAX_SEGMENTS` segments.
"""

from gyrorig_protocol.board.board_events import FaultCause
from gyrorig_protocol.board.crc import CRC_BYTES, compute_crc16
from gyrorig_protocol.can.board_can_frames import LAST_SEGMENT, MAX_SEGMENTS


class HelloAssembler:
    """Collect one text from its segments."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._collecting = False

    def reset(self) -> None:
        """Drop an unfinished text."""
        self._parts.clear()
        self._collecting = False

    def feed(self, data: bytes) -> bytes | FaultCause | None:
        """Add one segment.

        Returns:
            The text that it completes; the cause of a fault; None if more segments follow, and for
            segments whose first segment was not received.
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
        text_with_crc = b"".join(self._parts)
        self.reset()
        text = text_with_crc[:-CRC_BYTES]
        if len(text_with_crc) <= CRC_BYTES or compute_crc16(text) != int.from_bytes(
            text_with_crc[-CRC_BYTES:], "little"
        ):
            return FaultCause.CRC
        return text
