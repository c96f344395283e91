"""A serial line seen from the device: bytes take their time both ways, nothing overlaps.

`InLine` says when each received byte is complete; `Outbox` queues what the device sends
and says when it has left. An interruption (a limit flag) goes out at its own time, in the
middle of a reply where there is one under way.
"""

import heapq
from bisect import insort
from collections import deque

BITS_PER_BYTE = 10  # 8N1


def byte_ns(baud: int) -> int:
    """Return how long one byte occupies the line."""
    return BITS_PER_BYTE * 1_000_000_000 // baud


class InLine:
    """The receiving half."""

    def __init__(self, baud: int) -> None:
        """Begin with an idle line."""
        self.byte_ns = byte_ns(baud)
        self._free_ns = 0

    def arrivals(self, count: int, at_ns: int) -> list[int]:
        """Return when each of `count` bytes, sent from `at_ns` on, is complete."""
        start = max(at_ns, self._free_ns)
        self._free_ns = start + count * self.byte_ns
        return [start + (k + 1) * self.byte_ns for k in range(count)]


class Outbox:
    """The sending half."""

    def __init__(self, baud: int) -> None:
        """Begin with an idle line and nothing to send."""
        self.byte_ns = byte_ns(baud)
        self._free_ns = 0
        self._order = 0
        self._queue: list[tuple[int, int, bytes, bool]] = []
        self._flags: list[tuple[int, str]] = []
        self._left: deque[tuple[int, bytes]] = deque()

    def send(self, ready_ns: int, data: bytes, split_first: bool = False) -> None:
        """Queue bytes that are ready at a time.

        Args:
            ready_ns: when the first bit may leave.
            data: the bytes.
            split_first: the first byte arrives apart from the rest, as it does when the
                host wakes up at the first one.
        """
        if data:
            heapq.heappush(self._queue, (ready_ns, self._order, data, split_first))
            self._order += 1

    def change_speed(self, ready_ns: int, byte_ns_after: int) -> int:
        """Use another byte time after all that is ready by now has left; return that time."""
        while self._queue and self._queue[0][0] <= ready_ns:
            self._transmit()
        self.byte_ns = byte_ns_after
        return self._free_ns

    def flag(self, at_ns: int, text: str) -> None:
        """Plan an interruption; `drop_flags` takes it back if it has not gone out."""
        insort(self._flags, (at_ns, text))

    def drop_flags(self, text: str) -> None:
        """Forget every planned interruption of this text."""
        self._flags = [flag for flag in self._flags if flag[1] != text]

    def next_ns(self) -> int | None:
        """Return when the next piece will have left, None when nothing is queued.

        An interruption may make it later: then `take` at that time returns nothing.
        """
        if self._left:
            return self._left[0][0]
        times = []
        if self._queue:
            ready, _, data, split = self._queue[0]
            times.append(max(ready, self._free_ns) + (1 if split else len(data)) * self.byte_ns)
        if self._flags:
            at, text = self._flags[0]
            times.append(max(at, self._free_ns) + len(text) * self.byte_ns)
        return min(times, default=None)

    def take(self, until_ns: int) -> list[tuple[int, bytes]]:
        """Return the pieces that have left up to a time, each with the time of its last byte."""
        self.advance(until_ns)
        pieces = []
        while self._left and self._left[0][0] <= until_ns:
            pieces.append(self._left.popleft())
        return pieces

    def advance(self, until_ns: int) -> None:
        """Put on the line what begins by a time, so that nothing later changes it."""
        while self._begins_by(until_ns):
            self._transmit()

    def _begins_by(self, until_ns: int) -> bool:
        first = [self._queue[0][0]] if self._queue else []
        if self._flags:
            first.append(self._flags[0][0])
        return bool(first) and max(min(first), self._free_ns) <= until_ns

    def _transmit(self) -> None:
        """Put the first queued reply or interruption on the line."""
        reply_start = max(self._queue[0][0], self._free_ns) if self._queue else None
        if self._flags and (reply_start is None or self._flags[0][0] <= reply_start):
            at, text = self._flags.pop(0)
            self._put(max(at, self._free_ns), text.encode())
            return
        if reply_start is None:
            return
        _, _, data, split = heapq.heappop(self._queue)
        while self._flags and self._flags[0][0] < reply_start + len(data) * self.byte_ns:
            at, text = self._flags.pop(0)
            cut = max(1, -(-(at - reply_start) // self.byte_ns))
            data = data[:cut] + text.encode() + data[cut:]
        if split and len(data) > 1:
            self._put(reply_start, data[:1])
            self._put(self._free_ns, data[1:])
        else:
            self._put(reply_start, data)

    def _put(self, start_ns: int, data: bytes) -> None:
        self._free_ns = start_ns + len(data) * self.byte_ns
        self._left.append((self._free_ns, data))
