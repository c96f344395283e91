"""CDR codec (XCDR1, little endian), one value at a time, for messages with strings.

What to use when: `CdrEncoder` and `CdrDecoder` for the few low-rate messages whose size varies.
Fixed-size messages use one `struct.Struct` with `pack_fields` and `unpack_fields` or, in bulk, the
numpy layout of `message_layouts`.

Source: OMG DDSI-RTPS 2.5 section 10 (encapsulation), CDR alignment of XCDR1.
"""

import struct
from typing import Any

from gyrorig_protocol.errors import InputError

# CDR_LE, options 0. Alignment counts from the byte after these four.
ENCAPSULATION = b"\x00\x01\x00\x00"
NS_PER_S = 1_000_000_000
_REMEDY = "copy the recording again, or record the session again"


def pack_fields(layout: struct.Struct, *values: float) -> bytes:
    """Return the payload of a message whose fields all have fixed sizes.

    Raises:
        ValueError: a value does not fit its field.
    """
    try:
        return layout.pack(ENCAPSULATION, *values)
    except struct.error as error:
        raise ValueError(f"a value does not fit its field: {error}") from error


def unpack_fields(layout: struct.Struct, data: bytes, name: str) -> tuple[Any, ...]:
    """Return the fields of a message of fixed size, of the types in its layout.

    Raises:
        InputError: the payload of the message `name` has another size or header.
    """
    if len(data) != layout.size or data[:4] != ENCAPSULATION:
        raise InputError(
            f"a message of type {name} is damaged: it has {len(data)} bytes and the header "
            f"{data[:4].hex()}, instead of {layout.size} bytes and the header 00010000",
            "copy the file again, or record again",
        )
    return layout.unpack(data)[1:]


def split_time(time_ns: int) -> tuple[int, int]:
    """Split nanoseconds since the epoch into `builtin_interfaces/Time` (sec, nanosec)."""
    return divmod(time_ns, NS_PER_S)


class CdrEncoder:
    """Append values in order; `to_payload()` returns the payload with its header."""

    def __init__(self) -> None:
        self._data = bytearray(ENCAPSULATION)

    def add_number(self, code: str, value: float) -> None:
        """Append one primitive of struct format `code`, aligned to its size."""
        size = struct.calcsize("<" + code)
        self._data += bytes(-(len(self._data) - 4) % size)
        try:
            self._data += struct.pack("<" + code, value)
        except struct.error as error:
            raise ValueError(f"{value} does not fit its field: {error}") from error

    def add_time(self, time_ns: int) -> None:
        """Append a `builtin_interfaces/Time`."""
        sec, nanosec = split_time(time_ns)
        self.add_number("i", sec)
        self.add_number("I", nanosec)

    def add_string(self, text: str) -> None:
        """Append a string: length with its NUL, bytes, NUL.

        A NUL in the text, which a device can send, is replaced by a backslash and "x00", because
        readers in C end a string at a NUL.
        """
        data = text.replace("\0", "\\x00").encode()
        self.add_number("I", len(data) + 1)
        self._data += data + b"\0"

    def to_payload(self) -> bytes:
        """Return the payload of the message."""
        return bytes(self._data)


_INTEGER_LAYOUTS = {code: struct.Struct("<" + code) for code in "bBhHiIqQ"}
_LENGTH = _INTEGER_LAYOUTS["I"]


class CdrDecoder:
    """Read values in order from untrusted bytes.

    Raises:
        InputError: from every method, if the bytes do not contain the requested value.
    """

    def __init__(self, data: bytes) -> None:
        if data[:4] != ENCAPSULATION:
            raise InputError(
                "a message of the recording is damaged: its first four bytes are "
                f"{data[:4].hex()} instead of 00010000",
                _REMEDY,
            )
        self._data = data
        self._offset = 4

    def read_integer(self, code: str) -> int:
        """Return the next integer of struct format `code`."""
        layout = _INTEGER_LAYOUTS[code]
        size = layout.size
        start = self._offset + -(self._offset - 4) % size
        if start + size > len(self._data):
            raise InputError(
                f"a message of the recording is damaged: it ends at byte {len(self._data)}, inside "
                "a number",
                _REMEDY,
            )
        self._offset = start + size
        value: int = layout.unpack_from(self._data, start)[0]
        return value

    def read_time(self) -> int:
        """Return the next `builtin_interfaces/Time` in nanoseconds."""
        sec = self.read_integer("i")
        return sec * NS_PER_S + self.read_integer("I")

    def read_string(self) -> str:
        """Return the next string."""
        # A recording has tens of thousands of strings: the length is read without another call.
        begin = self._offset + -self._offset % _LENGTH.size + _LENGTH.size
        if begin > len(self._data):
            raise InputError(
                f"a message of the recording is damaged: it ends at byte {len(self._data)}, inside "
                "a number",
                _REMEDY,
            )
        length: int = _LENGTH.unpack_from(self._data, begin - _LENGTH.size)[0]
        end = begin + length
        if length < 1 or end > len(self._data) or self._data[end - 1] != 0:
            raise InputError(
                "a message of the recording is damaged: it states the wrong length of "
                f"{length} bytes for a string",
                _REMEDY,
            )
        raw = self._data[begin : end - 1]
        self._offset = end
        try:
            return raw.decode()
        except UnicodeDecodeError as error:
            raise InputError(
                f"a message of the recording is damaged: its string {raw[:40]!r} is not UTF-8",
                _REMEDY,
            ) from error

    def read_count(self, min_element_bytes: int) -> int:
        """Return the length of a sequence whose elements have at least `min_element_bytes`."""
        count = self.read_integer("I")
        if count * min_element_bytes > len(self._data) - self._offset:
            raise InputError(
                f"a message of the recording is damaged: it announces a list of {count} elements, "
                "but is too short for such a list",
                _REMEDY,
            )
        return count

    def check_end(self) -> None:
        """Check that no bytes remain."""
        if self._offset != len(self._data):
            raise InputError(
                f"a message of the recording is damaged: {len(self._data) - self._offset} "
                "unknown bytes follow its last field",
                _REMEDY,
            )
