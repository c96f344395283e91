"""The summary at the end of a finished MCAP file.

What to use when: under `reader`. It is believed only when its checksum is right; it
tells where the data end, repeats schemas and channels, and counts the messages.

Source: the MCAP format specification, sections "Footer" and "Summary Section".
"""

import struct
import zlib
from dataclasses import dataclass, field

from gyrorig_protocol.recording.definitions import Declared
from gyrorig_protocol.recording.fields import Fields, MalformedError

MAGIC = b"\x89MCAP0\r\n"
_FOOTER = struct.Struct("<BQQQI")
_FRAME = struct.Struct("<BQ")

_SCHEMA, _CHANNEL, _STATISTICS = 0x03, 0x04, 0x0B


@dataclass(slots=True)
class Summary:
    """What the summary says; nothing when it is not `sound`."""

    sound: bool = False
    fault: str = ""
    start: int = 0
    declared: Declared = field(default_factory=Declared)
    messages: int | None = None  # None: no statistics


def read_summary(data: memoryview) -> Summary:
    """Read the summary from the end of a file; never raises."""
    footer_at = len(data) - len(MAGIC) - _FOOTER.size
    if footer_at < len(MAGIC) or data[-len(MAGIC) :] != MAGIC:
        return Summary(fault="no end mark")
    opcode, length, start, _, crc = _FOOTER.unpack_from(data, footer_at)
    if opcode != 0x02 or length != 20:
        return Summary(fault="no footer")
    start = start or footer_at  # 0: a file without a summary
    if not len(MAGIC) <= start <= footer_at:
        return Summary(fault="the footer points outside the file")
    if crc and zlib.crc32(data[start : footer_at + _FOOTER.size - 4]) != crc:
        return Summary(fault="wrong checksum")
    found = Summary(sound=True, start=start)
    try:
        _take_records(found, data, start, footer_at)
    except MalformedError as error:
        return Summary(fault=str(error))
    return found


def _take_records(found: Summary, data: memoryview, at: int, limit: int) -> None:
    while at < limit:
        if at + _FRAME.size > limit:
            raise MalformedError("it ends inside a record")
        opcode, length = _FRAME.unpack_from(data, at)
        fields = Fields(data, at + _FRAME.size, at + _FRAME.size + length)
        if fields.end > limit:
            raise MalformedError("a record runs over its end")
        if opcode == _SCHEMA:
            found.declared.add_schema(fields)
        elif opcode == _CHANNEL:
            found.declared.add_channel(fields)
        elif opcode == _STATISTICS:
            found.messages = fields.number(8)
        at = fields.end
