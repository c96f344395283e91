"""Bounded reading of the fields of one MCAP record.

What to use when: under `framing` and `chunks`; every step checks that the bytes are
there, so a damaged length can neither run over the record nor ask for memory.

Source: the MCAP format specification, section "Serialization".
"""

import struct

Buffer = bytes | memoryview

_NUMBERS = {
    size: struct.Struct(code) for size, code in ((1, "<B"), (2, "<H"), (4, "<I"), (8, "<Q"))
}


class MalformedError(Exception):
    """Bytes that are no record of the kind they claim to be; never leaves this package."""


class Fields:
    """A cursor over `data[start:end]`.

    Raises:
        MalformedError: from every method, when the bytes do not hold what is asked for.
    """

    __slots__ = ("_data", "at", "end")

    def __init__(self, data: Buffer, start: int, end: int) -> None:
        self._data = data
        self.at = start
        self.end = end

    def number(self, size: int) -> int:
        """The next unsigned integer of 1, 2, 4 or 8 bytes."""
        at = self.skip(size)
        value: int = _NUMBERS[size].unpack_from(self._data, at)[0]
        return value

    def skip(self, count: int) -> int:
        """Step over `count` bytes; returns where they begin."""
        at = self.at
        if at + count > self.end:
            raise MalformedError(f"a record ends inside a field at byte {at}")
        self.at = at + count
        return at

    def raw(self, size_bytes: int) -> bytes:
        """The next byte string, whose length takes `size_bytes`."""
        count = self.number(size_bytes)
        at = self.skip(count)
        return bytes(self._data[at : at + count])

    def text(self) -> str:
        """The next string."""
        raw = self.raw(4)
        try:
            return raw.decode()
        except UnicodeDecodeError as error:
            raise MalformedError(f"a string at byte {self.at} is not UTF-8") from error

    def text_map(self) -> dict[str, str]:
        """The next map of strings; a key given twice is malformed."""
        end = self.number(4) + self.at
        if end > self.end:
            raise MalformedError(f"a map at byte {self.at} runs over its record")
        inside = Fields(self._data, self.at, end)
        found: dict[str, str] = {}
        while inside.at < end:
            key = inside.text()
            if key in found:
                raise MalformedError(f"the key {key[:40]!r} appears twice")
            found[key] = inside.text()
        self.at = end
        return found

    def done(self) -> None:
        """Check that nothing is left over."""
        if self.at != self.end:
            raise MalformedError(f"{self.end - self.at} bytes left over at byte {self.at}")
