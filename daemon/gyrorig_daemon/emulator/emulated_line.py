"""Serial line as seen by a device: bytes take time in both directions.

`ReceiveLine` gives the time at which each received byte is complete. `TransmitQueue` queues the
bytes that the device sends and gives the time at which they have left. A limit flag is sent at
its own time, also in the middle of a reply.
"""

import heapq
from bisect import insort
from collections import deque

BITS_PER_BYTE = 10  # 8N1


def byte_ns(baud: int) -> int:
    """Return the duration of one byte on the line."""
    return BITS_PER_BYTE * 1_000_000_000 // baud


class ReceiveLine:
    """The receiving half."""

    def __init__(self, baud: int) -> None:
        """Start with an idle line."""
        self.byte_ns = byte_ns(baud)
        self._free_ns = 0

    def arrivals(self, count: int, at_ns: int) -> list[int]:
        """Return when each of `count` bytes, sent from `at_ns` on, is complete."""
        start = max(at_ns, self._free_ns)
        self._free_ns = start + count * self.byte_ns
        return [start + (k + 1) * self.byte_ns for k in range(count)]


class TransmitQueue:
    """The sending half."""

    def __init__(self, baud: int) -> None:
        """Start with an idle line and an empty queue."""
        self.byte_ns = byte_ns(baud)
        self._free_ns = 0
        self._order = 0
        self._queue: list[tuple[int, int, bytes, bool]] = []
        self._flags: list[tuple[int, str]] = []
        self._sent: deque[tuple[int, bytes]] = deque()

    def send(self, ready_ns: int, data: bytes, split_first: bool = False) -> None:
        """Queue bytes that are ready at a time.

        Args:
            ready_ns: when the first bit may leave.
            data: the bytes.
            split_first: the first byte arrives separately, as it does when the host wakes up
                at the first byte.
        """
        if data:
            heapq.heappush(self._queue, (ready_ns, self._order, data, split_first))
            self._order += 1

    def change_speed(self, ready_ns: int, byte_ns_after: int) -> int:
        """Change the byte time after all ready bytes have left; return that time."""
        while self._queue and self._queue[0][0] <= ready_ns:
            self._transmit()
        self.byte_ns = byte_ns_after
        return self._free_ns

    def plan_flag(self, at_ns: int, text: str) -> None:
        """Plan a limit flag; `drop_flags` cancels it if it has not been sent."""
        insort(self._flags, (at_ns, text))

    def drop_flags(self, text: str) -> None:
        """Cancel every planned flag with this text."""
        self._flags = [flag for flag in self._flags if flag[1] != text]

    def next_ns(self) -> int | None:
        """Return when the next bytes have left, None if nothing is queued.

        A limit flag can delay them: then `take` returns nothing at that time.
        """
        if self._sent:
            return self._sent[0][0]
        times = []
        if self._queue:
            ready, _, data, split = self._queue[0]
            times.append(max(ready, self._free_ns) + (1 if split else len(data)) * self.byte_ns)
        if self._flags:
            at_ns, text = self._flags[0]
            times.append(max(at_ns, self._free_ns) + len(text) * self.byte_ns)
        return min(times, default=None)

    def take(self, until_ns: int) -> list[tuple[int, bytes]]:
        """Return the bytes that have left up to a time, with the time of their last byte."""
        self.advance(until_ns)
        pieces = []
        while self._sent and self._sent[0][0] <= until_ns:
            pieces.append(self._sent.popleft())
        return pieces

    def advance(self, until_ns: int) -> None:
        """Put everything on the line that starts by a time, so that it no longer changes."""
        while self._begins_by(until_ns):
            self._transmit()

    def _begins_by(self, until_ns: int) -> bool:
        start_times = [self._queue[0][0]] if self._queue else []
        if self._flags:
            start_times.append(self._flags[0][0])
        return bool(start_times) and max(min(start_times), self._free_ns) <= until_ns

    def _transmit(self) -> None:
        """Put the first queued reply or flag on the line."""
        reply_start = max(self._queue[0][0], self._free_ns) if self._queue else None
        if self._flags and (reply_start is None or self._flags[0][0] <= reply_start):
            at_ns, text = self._flags.pop(0)
            self._put_on_line(max(at_ns, self._free_ns), text.encode())
            return
        if reply_start is None:
            return
        _, _, data, split = heapq.heappop(self._queue)
        while self._flags and self._flags[0][0] < reply_start + len(data) * self.byte_ns:
            at_ns, text = self._flags.pop(0)
            split_at = max(1, -(-(at_ns - reply_start) // self.byte_ns))
            data = data[:split_at] + text.encode() + data[split_at:]
        if split and len(data) > 1:
            self._put_on_line(reply_start, data[:1])
            self._put_on_line(self._free_ns, data[1:])
        else:
            self._put_on_line(reply_start, data)

    def _put_on_line(self, start_ns: int, data: bytes) -> None:
        self._free_ns = start_ns + len(data) * self.byte_ns
        self._sent.append((self._free_ns, data))
