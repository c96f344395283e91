"""Frame encoding on the wire: checksum, byte stuffing, delimiters.

    00 COBS(payload, crc16 low byte first) 00

Payload and checksum have at most 250 bytes together, so that stuffing always adds one byte. The
00 on both sides costs one byte and protects the next frame from noise between two frames. Two
consecutive frames can share a 00.
"""

import struct
from typing import ClassVar

import msgspec

from gyrorig_protocol.board import cobs
from gyrorig_protocol.board.crc import CRC_BYTES, compute_crc16
from gyrorig_protocol.errors import UsageError

DELIMITER = b"\0"
MAX_PAYLOAD_BYTES = 250 - CRC_BYTES
MAX_STUFFED_BYTES = 251


def encode_frame(payload: bytes) -> bytes:
    """Return `payload` with its checksum, stuffed, between two delimiters.

    Raises:
        UsageError: the payload has more than 248 bytes.
    """
    if len(payload) > MAX_PAYLOAD_BYTES:
        raise UsageError(
            f"the payload of the board frame is too long: it has {len(payload)} bytes",
            f"send at most {MAX_PAYLOAD_BYTES} bytes in one frame",
        )
    checked = payload + compute_crc16(payload).to_bytes(CRC_BYTES, "little")
    return DELIMITER + cobs.encode(checked) + DELIMITER


class Frame(msgspec.Struct, frozen=True, gc=False):
    """Base class of the frames: a type and its encoding.

    A msgspec structure is immutable like a frozen dataclass, and creating it is ten times faster.
    """

    TYPE: ClassVar[int] = 0

    def encode_payload(self) -> bytes:
        """Return the payload without its checksum; here only the type."""
        return bytes([self.TYPE])

    def encode(self) -> bytes:
        """Return the bytes to send, with both delimiters.

        Raises:
            UsageError: a value does not fit into its field, or the frame is too long.
        """
        try:
            return encode_frame(self.encode_payload())
        except struct.error as fault:
            raise UsageError(
                f"a value does not fit into its field of the frame {type(self).__name__} ({fault})",
                "give a value within the range of the field",
            ) from fault
