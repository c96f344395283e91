"""The summary at the end of a finished MCAP file.

The summary is used only if its checksum is valid. It has the end of the data section, copies of the
schemas and channels, and the number of messages.

Source: the MCAP format specification, sections "Footer" and "Summary Section".
"""

import struct
import zlib
from dataclasses import dataclass, field

from gyrorig_protocol.recording.mcap.declarations import Declarations
from gyrorig_protocol.recording.mcap.record_cursor import MalformedError, RecordCursor

MAGIC = b"\x89MCAP0\r\n"
_FOOTER_LAYOUT = struct.Struct("<BQQQI")
_FRAME_LAYOUT = struct.Struct("<BQ")

_SCHEMA, _CHANNEL, _STATISTICS = 0x03, 0x04, 0x0B


@dataclass(slots=True)
class McapSummary:
    """The content of a summary; empty if it is not valid."""

    is_valid: bool = False
    fault: str = ""
    start_offset: int = 0
    declarations: Declarations = field(default_factory=Declarations)
    message_count: int | None = None  # None: no statistics


def read_summary(data: memoryview) -> McapSummary:
    """Read the summary at the end of a file; never raises an error."""
    footer_offset = len(data) - len(MAGIC) - _FOOTER_LAYOUT.size
    if footer_offset < len(MAGIC) or data[-len(MAGIC) :] != MAGIC:
        return McapSummary(fault="the end mark is missing")
    opcode, length, start, _, crc = _FOOTER_LAYOUT.unpack_from(data, footer_offset)
    if opcode != 0x02 or length != 20:
        return McapSummary(fault="the footer is missing")
    start = start or footer_offset  # 0: a file without a summary
    if not len(MAGIC) <= start <= footer_offset:
        return McapSummary(fault="the footer points outside the file")
    if crc and zlib.crc32(data[start : footer_offset + _FOOTER_LAYOUT.size - 4]) != crc:
        return McapSummary(fault="its checksum is wrong")
    summary = McapSummary(is_valid=True, start_offset=start)
    try:
        _read_records(summary, data, start, footer_offset)
    except MalformedError as error:
        return McapSummary(fault=str(error))
    return summary


def _read_records(summary: McapSummary, data: memoryview, offset: int, limit: int) -> None:
    while offset < limit:
        if offset + _FRAME_LAYOUT.size > limit:
            raise MalformedError("it ends inside a record")
        opcode, length = _FRAME_LAYOUT.unpack_from(data, offset)
        cursor = RecordCursor(
            data, offset + _FRAME_LAYOUT.size, offset + _FRAME_LAYOUT.size + length
        )
        if cursor.end > limit:
            raise MalformedError("a record exceeds its end")
        if opcode == _SCHEMA:
            summary.declarations.add_schema(cursor)
        elif opcode == _CHANNEL:
            summary.declarations.add_channel(cursor)
        elif opcode == _STATISTICS:
            summary.message_count = cursor.read_uint(8)
        offset = cursor.end
