"""Consistent overhead byte stuffing (COBS) of short frames: removes all zero bytes.

Payloads have at most 253 bytes. Then no code byte is 255, every code byte replaces one zero, and
both directions follow the zeros. The result is one byte longer. Source: Cheshire and Baker,
"Consistent Overhead Byte Stuffing", IEEE/ACM Transactions on Networking 7(2), 1999.
"""

from gyrorig_protocol.errors import UsageError

MAX_PAYLOAD_BYTES = 253


def encode(payload: bytes) -> bytes:
    """Return `payload` without zero bytes, one byte longer, without delimiters.

    Raises:
        UsageError: the payload has more than 253 bytes.
    """
    if len(payload) > MAX_PAYLOAD_BYTES:
        raise UsageError(
            f"the board frame is too long: it has {len(payload)} bytes",
            f"send at most {MAX_PAYLOAD_BYTES} bytes in one frame",
        )
    stuffed = bytearray(b"\0" + payload)
    code_index = 0
    zero_index = stuffed.find(0, 1)
    while zero_index > 0:
        stuffed[code_index] = zero_index - code_index
        code_index = zero_index
        zero_index = stuffed.find(0, code_index + 1)
    stuffed[code_index] = len(stuffed) - code_index
    return bytes(stuffed)


def decode(stuffed: bytes) -> bytes | None:
    """Return the payload of `stuffed`, None if the code bytes do not end at its last byte.

    Args:
        stuffed: the bytes between two delimiters, at most 254, none of them zero.
    """
    payload = bytearray(stuffed)
    end = len(payload)
    index = 0
    while index < end:
        code = payload[index]
        payload[index] = 0
        index += code
    if index != end or not 0 < end <= MAX_PAYLOAD_BYTES + 1:
        return None
    del payload[0]
    return bytes(payload)
