"""How a payload goes over the wire: check, stuffing, delimiters.

    00 COBS(payload, crc16 low byte first) 00

Payload and check are at most 250 bytes together, so stuffing always adds one byte. The
00 on both sides costs one byte and means that noise between two frames costs no frame.
Two frames in a row may share a 00.
"""

import struct
from typing import ClassVar

import msgspec

from gyrorig_protocol.board import cobs
from gyrorig_protocol.board.crc import CRC_BYTES, crc16
from gyrorig_protocol.errors import UsageError

DELIMITER = b"\0"
MAX_PAYLOAD_BYTES = 250 - CRC_BYTES
MAX_STUFFED_BYTES = 251


def frame_bytes(payload: bytes) -> bytes:
    """Return `payload` with its check, stuffed, between two delimiters.

    Raises:
        UsageError: the payload has more than 248 bytes.
    """
    if len(payload) > MAX_PAYLOAD_BYTES:
        raise UsageError(f"a payload of {len(payload)} bytes", f"{MAX_PAYLOAD_BYTES} fit")
    checked = payload + crc16(payload).to_bytes(CRC_BYTES, "little")
    return DELIMITER + cobs.encode(checked) + DELIMITER


class Frame(msgspec.Struct, frozen=True, gc=False):
    """What all records share: a type and the way to the wire.

    A msgspec structure is frozen like a frozen dataclass and ten times as quick to make.
    """

    TYPE: ClassVar[int] = 0

    def payload(self) -> bytes:
        """Return the payload without its check; by itself, the type alone."""
        return bytes([self.TYPE])

    def encode(self) -> bytes:
        """Return the frame as it goes over the wire, with both delimiters.

        Raises:
            UsageError: a value does not fit into its field, or the frame is too long.
        """
        try:
            return frame_bytes(self.payload())
        except struct.error as fault:
            raise UsageError(f"a value does not fit into {type(self).__name__}", str(fault)) from (
                fault
            )
