"""Consistent overhead byte stuffing for short frames: no zero inside, one byte more.

Only payloads of up to 253 bytes: then no code byte is 255, every code stands for one
zero, and both directions are a walk along the zeros. Source: Cheshire and Baker,
"Consistent Overhead Byte Stuffing", IEEE/ACM Transactions on Networking 7(2), 1999.
"""

from gyrorig_protocol.errors import UsageError

MAX_PAYLOAD_BYTES = 253


def encode(payload: bytes) -> bytes:
    """Return `payload` without zero bytes, one byte longer, delimiters not included.

    Raises:
        UsageError: the payload has more than 253 bytes.
    """
    if len(payload) > MAX_PAYLOAD_BYTES:
        raise UsageError(f"a frame of {len(payload)} bytes", f"send {MAX_PAYLOAD_BYTES} at most")
    stuffed = bytearray(b"\0" + payload)
    code_at = 0
    zero_at = stuffed.find(0, 1)
    while zero_at > 0:
        stuffed[code_at] = zero_at - code_at
        code_at = zero_at
        zero_at = stuffed.find(0, code_at + 1)
    stuffed[code_at] = len(stuffed) - code_at
    return bytes(stuffed)


def decode(stuffed: bytes) -> bytes | None:
    """Return the payload of `stuffed`, None where the codes do not meet its end.

    Args:
        stuffed: what stood between two delimiters: no zero in it, 254 bytes at most.
    """
    payload = bytearray(stuffed)
    end = len(payload)
    at = 0
    while at < end:
        code = payload[at]
        payload[at] = 0
        at += code
    if at != end or not 0 < end <= MAX_PAYLOAD_BYTES + 1:
        return None
    del payload[0]
    return bytes(payload)
