"""Plain CDR (XCDR1, little endian) one value at a time, for messages with strings.

What to use when: `CdrEncoder` and `CdrDecoder` for the few low-rate messages whose
size varies. Fixed-size messages go through one `struct.Struct` or, in bulk, through
the numpy layout of `cdr`.

Source: OMG DDSI-RTPS 2.5 section 10 (encapsulation), CDR alignment of XCDR1.
"""

import struct

from gyrorig_protocol.errors import InputError

# CDR_LE, options 0. Alignment counts from the byte after these four.
ENCAPSULATION = b"\x00\x01\x00\x00"
NS_PER_S = 1_000_000_000


def split_time(time_ns: int) -> tuple[int, int]:
    """Nanoseconds since the epoch as `builtin_interfaces/Time` (sec, nanosec)."""
    return divmod(time_ns, NS_PER_S)


class CdrEncoder:
    """Append values in order; `take()` returns the payload with its header."""

    def __init__(self) -> None:
        self._data = bytearray(ENCAPSULATION)

    def number(self, code: str, value: float) -> None:
        """Append one primitive of struct format `code`, aligned to its size."""
        size = struct.calcsize("<" + code)
        self._data += bytes(-(len(self._data) - 4) % size)
        try:
            self._data += struct.pack("<" + code, value)
        except struct.error as error:
            raise ValueError(f"{value} does not fit its field: {error}") from error

    def time(self, time_ns: int) -> None:
        """Append a `builtin_interfaces/Time`."""
        sec, nanosec = split_time(time_ns)
        self.number("i", sec)
        self.number("I", nanosec)

    def string(self, text: str) -> None:
        """Append a string: length with its NUL, bytes, NUL.

        A NUL inside, which a device may send, becomes a backslash and "x00": readers in
        C end a string at a NUL.
        """
        data = text.replace("\0", "\\x00").encode()
        self.number("I", len(data) + 1)
        self._data += data + b"\0"

    def take(self) -> bytes:
        """The payload as it goes into a message."""
        return bytes(self._data)


_PACKED = {code: struct.Struct("<" + code) for code in "bBhHiIqQ"}


class CdrDecoder:
    """Read values in order from hostile bytes.

    Raises:
        InputError: from every method, when the bytes do not hold what is asked for.
    """

    def __init__(self, data: bytes) -> None:
        if data[:4] != ENCAPSULATION:
            raise InputError(f"CDR header {data[:4].hex()!r}, not 00010000")
        self._data = data
        self._at = 4

    def number(self, code: str) -> int:
        """The next integer of struct format `code`."""
        packed = _PACKED[code]
        size = packed.size
        start = self._at + -(self._at - 4) % size
        if start + size > len(self._data):
            raise InputError(f"message ends at byte {len(self._data)} inside a number")
        self._at = start + size
        value: int = packed.unpack_from(self._data, start)[0]
        return value

    def time(self) -> int:
        """The next `builtin_interfaces/Time` in nanoseconds."""
        sec = self.number("i")
        return sec * NS_PER_S + self.number("I")

    def string(self) -> str:
        """The next string."""
        length = self.number("I")
        end = self._at + length
        if length < 1 or end > len(self._data) or self._data[end - 1] != 0:
            raise InputError(f"string of {length} bytes does not fit its message")
        raw = self._data[self._at : end - 1]
        self._at = end
        try:
            return raw.decode()
        except UnicodeDecodeError as error:
            raise InputError(f"string is not UTF-8: {raw[:40]!r}") from error

    def count(self, least_bytes: int) -> int:
        """The length of a sequence whose elements take at least `least_bytes` each."""
        count = self.number("I")
        if count * least_bytes > len(self._data) - self._at:
            raise InputError(f"sequence of {count} elements does not fit its message")
        return count

    def end(self) -> None:
        """Check that nothing is left over."""
        if self._at != len(self._data):
            raise InputError(f"{len(self._data) - self._at} bytes left over after the message")
