"""The frame checksum: CRC-16/CCITT-FALSE (polynomial 0x1021, start 0xFFFF, not reflected).

`binascii.crc_hqx` of the standard library computes it; 0x29B1 over "123456789". It detects every
error of up to three bits in a frame and every burst of up to 16 bits.
"""

from binascii import crc_hqx

CRC_BYTES = 2


def compute_crc16(data: bytes) -> int:
    """Return the checksum of `data`; it is sent low byte first."""
    return crc_hqx(data, 0xFFFF)
