"""Bounded reading of the fields of one MCAP record.

Every step checks that the bytes exist. A damaged length can therefore neither exceed the record nor
allocate memory.

Source: the MCAP format specification, section "Serialization".
"""

import struct

Buffer = bytes | memoryview

_UINT_LAYOUTS = {
    size: struct.Struct(code) for size, code in ((1, "<B"), (2, "<H"), (4, "<I"), (8, "<Q"))
}


class MalformedError(Exception):
    """Bytes are not a valid record; never raised out of this package."""


class RecordCursor:
    """A cursor over `data[start:end]`.

    Raises:
        MalformedError: from every method, if the bytes do not contain the requested value.
    """

    __slots__ = ("_data", "end", "offset")

    def __init__(self, data: Buffer, start: int, end: int) -> None:
        self._data = data
        self.offset = start
        self.end = end

    def read_uint(self, size: int) -> int:
        """Return the next unsigned integer of 1, 2, 4 or 8 bytes."""
        start = self.skip(size)
        value: int = _UINT_LAYOUTS[size].unpack_from(self._data, start)[0]
        return value

    def skip(self, count: int) -> int:
        """Skip `count` bytes; return their offset."""
        start = self.offset
        if start + count > self.end:
            raise MalformedError(f"a record ends inside a field at byte {start}")
        self.offset = start + count
        return start

    def read_bytes(self, size_bytes: int) -> bytes:
        """Return the next byte string; its length is an integer of `size_bytes`."""
        count = self.read_uint(size_bytes)
        start = self.skip(count)
        return bytes(self._data[start : start + count])

    def read_text(self) -> str:
        """Return the next string."""
        raw = self.read_bytes(4)
        try:
            return raw.decode()
        except UnicodeDecodeError as error:
            raise MalformedError(f"a string at byte {self.offset} is not UTF-8") from error

    def read_text_map(self) -> dict[str, str]:
        """Return the next map of strings; a repeated key is malformed."""
        end = self.read_uint(4) + self.offset
        if end > self.end:
            raise MalformedError(f"a map at byte {self.offset} exceeds its record")
        map_cursor = RecordCursor(self._data, self.offset, end)
        entries: dict[str, str] = {}
        while map_cursor.offset < end:
            key = map_cursor.read_text()
            if key in entries:
                raise MalformedError(f"the key {key[:40]!r} is repeated")
            entries[key] = map_cursor.read_text()
        self.offset = end
        return entries

    def check_end(self) -> None:
        """Check that no bytes remain."""
        if self.offset != self.end:
            raise MalformedError(f"{self.end - self.offset} bytes remain at byte {self.offset}")
