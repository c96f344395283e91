"""The protocol of the pipes between the daemon and its acquisition process.

One-way pipes carry frames: a fixed header, then data. Reports take two pipes, so that what the
unit sends, and the result of each write, never wait behind the data of boards. This module uses
only `struct` and a named tuple, because the acquisition process imports nothing larger and the
daemon parses thousands of reports per second.
"""

import struct
from typing import NamedTuple

# daemon -> acquisition: kind, port index, length of the data, deadline in ns
COMMAND_HEADER = struct.Struct("<BBxxIq")
WRITE = 1
CLOSE = 2
REOPEN = 3  # close the port and open it again
PING = 4  # request a PONG; from the first one on, silence of three seconds halts the unit
RELEASE = 5  # the daemon knows of the halt: writes to the unit are accepted again

# acquisition -> daemon: kind, port index, length of the data, two times in ns
REPORT_HEADER = struct.Struct("<BBxxIqq")
OPENED = 1  # every port is open or will be retried; no data
# Data of one read call, never empty. The first time is the return of the call. The second is
# a duration: how late the first may be because this process did not run before.
CHUNK = 2
WRITTEN = 3  # times before and after the write
FAULT = 4  # a write failed; data is the reason
REFUSED = 5  # a port could not be opened; data is "<reason>\n<text>"
DROPPED = 6  # first: time; second: bytes dropped because the daemon did not read
GONE = 7  # first: time; data is the reason. Sent again if the reason changes
BACK = 8  # the port is open again; first: time
PONG = 9  # reply to a PING; first: time
# A write was refused, because this process has halted the unit. Second: 1 if that was ordered;
# data is the reason.
HALTED = 10
URGENT_KINDS = (WRITTEN, FAULT, PONG, HALTED)  # of every port; of the unit's port all kinds

MAX_DATA_BYTES = 1 << 20


class AcquisitionReport(NamedTuple):
    """One frame from the acquisition process."""

    kind: int
    port: int
    first_ns: int
    second_ns: int
    data: bytes


class ReportParser:
    """Split the bytes of the pipe into reports, however they are cut."""

    def __init__(self) -> None:
        self._buffer = b""

    def feed(self, data: bytes) -> list[AcquisitionReport]:
        """Return the reports that `data` completes.

        Raises:
            ValueError: the bytes do not follow the protocol.
        """
        buffer = self._buffer + data if self._buffer else data
        reports: list[AcquisitionReport] = []
        offset, size, unpack_from = 0, len(buffer), REPORT_HEADER.unpack_from
        while size - offset >= REPORT_HEADER.size:
            kind, port, length, first_ns, second_ns = unpack_from(buffer, offset)
            if length > MAX_DATA_BYTES:
                raise ValueError(f"a frame of {length} bytes")
            begin = offset + REPORT_HEADER.size
            end = begin + length
            if size < end:
                break
            reports.append(AcquisitionReport(kind, port, first_ns, second_ns, buffer[begin:end]))
            offset = end
        self._buffer = buffer[offset:]
        return reports
