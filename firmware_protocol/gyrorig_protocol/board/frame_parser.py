"""Parser of a board's GCB1 byte stream.

Theory of operation: a frame contains no zero byte, so every zero is a delimiter, and after any
damage the parser starts again at the next zero. The bytes between two zeros are unstuffed, their
checksum is verified, and then they are decoded. Bytes that are longer than any frame are reported
once, when they become too long, and dropped up to the next zero.

Contract: received bytes never raise an error. Invalid bytes give a `FrameFault` event and are
counted by cause. The events do not depend on where the stream was cut. Memory stays below
`MAX_STUFFED_BYTES`.
"""

from gyrorig_protocol.board import cobs
from gyrorig_protocol.board.board_events import BoardEvent, FaultCause, FrameEvent, FrameFault
from gyrorig_protocol.board.crc import CRC_BYTES, compute_crc16
from gyrorig_protocol.board.delimiter_splitter import DelimiterSplitter
from gyrorig_protocol.board.frame_encoding import DELIMITER, MAX_STUFFED_BYTES
from gyrorig_protocol.board.payload_decoder import decode_payload


class FrameParser:
    """Parse a board's bytes into frames and faults. The bytes can come in any portions."""

    def __init__(self) -> None:
        self._splitter = DelimiterSplitter(DELIMITER, MAX_STUFFED_BYTES)
        self.frames = 0
        self.faults = dict.fromkeys(FaultCause, 0)

    @property
    def buffered_bytes(self) -> int:
        """Number of bytes of an unfinished frame, at most `MAX_STUFFED_BYTES`."""
        return self._splitter.buffered_bytes

    def reset(self) -> None:
        """Drop an unfinished frame, for example after the port was opened again."""
        self._splitter.reset()

    def feed(self, data: bytes, received_ns: int) -> list[BoardEvent]:
        """Return the events that `data` completes.

        Args:
            data: the bytes of one read call, cut anywhere.
            received_ns: the timestamp of that read call.
        """
        return [
            self._parse_frame(stuffed, received_ns, offset)
            for stuffed, offset in self._splitter.feed(data)
            if stuffed
        ]

    def _parse_frame(self, stuffed: bytes, received_ns: int, offset: int) -> BoardEvent:
        if len(stuffed) > MAX_STUFFED_BYTES:
            return self._report_fault(FaultCause.OVERSIZE, received_ns, offset, stuffed)
        payload_with_crc = cobs.decode(stuffed)
        if payload_with_crc is None:
            return self._report_fault(FaultCause.COBS, received_ns, offset, stuffed)
        payload = payload_with_crc[:-CRC_BYTES]
        if (
            compute_crc16(payload) != int.from_bytes(payload_with_crc[-CRC_BYTES:], "little")
            or not payload
        ):
            return self._report_fault(FaultCause.CRC, received_ns, offset, stuffed)
        frame = decode_payload(payload)
        if isinstance(frame, FaultCause):
            return self._report_fault(frame, received_ns, offset, stuffed)
        self.frames += 1
        return FrameEvent(frame, received_ns, offset, payload)

    def _report_fault(
        self, cause: FaultCause, received_ns: int, offset: int, raw: bytes
    ) -> FrameFault:
        self.faults[cause] += 1
        return FrameFault(cause, received_ns, offset, raw)
