"""The pipe between the daemon and its acquisition process.

Two one-way pipes of frames, each a fixed header and its bytes. Only the standard
library's struct and a named tuple: the acquisition process imports nothing larger, and the
daemon makes thousands of reports a second.
"""

import struct
from typing import NamedTuple

# daemon -> acquisition: kind, port index, length of the data, deadline in ns
ORDER = struct.Struct("<BBxxIq")
WRITE = 1
CLOSE = 2
REOPEN = 3  # let go of the port and open it anew
PING = 4  # say that all is well

# acquisition -> daemon: kind, port index, length of the data, two stamps in ns
REPORT = struct.Struct("<BBxxIqq")
OPENED = 1  # every port is open, or is waited for; no data
# data read, never empty; the first stamp is the return of the read call, the second no
# stamp: how many ns late the first may be, because this process stood still before
CHUNK = 2
WRITTEN = 3  # stamps before and after the write
FAULT = 4  # a write failed; data is the reason
REFUSED = 5  # a port could not be opened; data is "<reason>\n<text>"
LOST = 6  # the first stamp: when; the second: bytes dropped because the daemon did not read
GONE = 7  # the first stamp: when; data is why. Said again where the reason has changed
BACK = 8  # the port is open again; the first stamp: when
PONG = 9  # the answer to a ping; the first stamp: when

MAX_DATA_BYTES = 1 << 20


class Report(NamedTuple):
    """One frame of the acquisition process."""

    kind: int
    port: int
    first_ns: int
    second_ns: int
    data: bytes


class ReportParser:
    """Turn the pipe's bytes into reports, in whatever pieces they come."""

    def __init__(self) -> None:
        self._held = b""

    def feed(self, data: bytes) -> list[Report]:
        """Return the reports that `data` completes.

        Raises:
            ValueError: the other side does not speak this language.
        """
        held = self._held + data if self._held else data
        reports: list[Report] = []
        at, size, unpack_from = 0, len(held), REPORT.unpack_from
        while size - at >= REPORT.size:
            kind, port, length, first_ns, second_ns = unpack_from(held, at)
            if length > MAX_DATA_BYTES:
                raise ValueError(f"a frame of {length} bytes")
            begin = at + REPORT.size
            end = begin + length
            if size < end:
                break
            reports.append(Report(kind, port, first_ns, second_ns, held[begin:end]))
            at = end
        self._held = held[at:]
        return reports
