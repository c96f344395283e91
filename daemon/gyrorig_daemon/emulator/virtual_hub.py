"""The emulated rig under a virtual clock: the same bytes, faster than time.

Theory of operation. The clock moves only in `read`: to the next arrival at the host, or to
the deadline. What leaves a device gets its arrival time from the latency model; arrivals
wait in a heap. Before one is delivered, every device has been asked for what left its line
until then, because it could have overtaken.
"""

import heapq

from gyrorig_daemon.emulator.rig import EmulatedRig
from gyrorig_daemon.links.hub import Chunk, PortChange, WriteStamp
from gyrorig_protocol.errors import DeviceError

NEVER_NS = 1 << 62
REOPENING_NS = 10_000_000

_Arrival = tuple[int, int, str, bytes, PortChange | None]


class VirtualHub:
    """A `PortHub` over an emulated rig. Starts at the rig's power-up."""

    def __init__(self, rig: EmulatedRig) -> None:
        """Drive `rig`; nothing else may drive it."""
        self.rig = rig
        self._devices = rig.devices
        self._latency = rig.latency
        self._now_ns = rig.origin_ns
        self._arrivals: list[_Arrival] = []
        self._order = 0
        self._closed = False
        self._away: dict[str, list[tuple[int, int]]] = {port: [] for port in self._devices}
        self._down: set[str] = set()

    def unplug(self, port: str, at_ns: int, until_ns: int | None = None) -> None:
        """Pull a device's cable at a time to come; plug it in again at `until_ns`, or never.

        The device goes on without it.
        """
        self._push(at_ns, port, b"", PortChange.GONE)
        if until_ns is not None:
            self._push(until_ns, port, b"", PortChange.BACK)
        self._away[port].append((at_ns, NEVER_NS if until_ns is None else until_ns))

    def swap(self, port: str, other: str) -> None:
        """Exchange what hangs on two ports, as names that follow the order of plugging do."""
        self._devices[port], self._devices[other] = self._devices[other], self._devices[port]

    def now_ns(self) -> int:
        """Return the virtual clock."""
        return self._now_ns

    def write(self, port: str, data: bytes) -> WriteStamp:
        """Hand bytes to a device; they begin on its line a little later.

        Raises:
            DeviceError: there is no such port, it is gone, or the hub is closed.
        """
        device = self._devices.get(port)
        if device is None or self._closed:
            raise DeviceError(f"no emulated device on port {port!r}", "check the rig's ports")
        if self._is_away(port, self._now_ns):
            raise DeviceError(f"the port {port!r} hung up", "plug the device in again")
        device.receive(data, self._latency.line_ns(self._now_ns))
        return WriteStamp(self._now_ns, self._now_ns)

    def read(self, deadline_ns: int) -> Chunk | None:
        """Return the next chunk of any port in the order of time, None at the deadline."""
        limit_ns = max(deadline_ns, self._now_ns)
        while not self._closed:
            due_ns, port = self._next_output()
            arrival_ns = self._arrivals[0][0] if self._arrivals else None
            horizon_ns = limit_ns if arrival_ns is None else min(arrival_ns, limit_ns)
            if due_ns is not None and due_ns <= horizon_ns:
                self._collect(port, due_ns)
            elif arrival_ns is not None and arrival_ns <= limit_ns:
                return self._deliver()
            else:
                break
        self._now_ns = limit_ns
        return None

    def is_up(self, port: str) -> bool:
        """Return whether the port is open, by what `read` has told."""
        return port not in self._down

    def reopen(self, port: str) -> None:
        """Let go of a port and open it anew, unless its cable is pulled."""
        if not self._is_away(port, self._now_ns):
            self.unplug(port, self._now_ns, self._now_ns + REOPENING_NS)

    def close(self) -> None:
        """Release every port. Closing twice is no fault."""
        self._closed = True

    def _next_output(self) -> tuple[int | None, str]:
        best_ns: int | None = None
        best_port = ""
        for port, device in self._devices.items():
            due_ns = device.next_output_ns()
            if due_ns is not None and (best_ns is None or due_ns < best_ns):
                best_ns, best_port = due_ns, port
        return best_ns, best_port

    def _collect(self, port: str, until_ns: int) -> None:
        for line_ns, data in self._devices[port].take_output(until_ns):
            arrival_ns = self._latency.arrival_ns(port, line_ns)
            if not self._is_away(port, arrival_ns):
                self._push(arrival_ns, port, data)

    def _push(self, at_ns: int, port: str, data: bytes, change: PortChange | None = None) -> None:
        heapq.heappush(self._arrivals, (at_ns, self._order, port, data, change))
        self._order += 1

    def _is_away(self, port: str, at_ns: int) -> bool:
        return any(begin_ns <= at_ns < end_ns for begin_ns, end_ns in self._away[port])

    def _deliver(self) -> Chunk:
        """Take the first arrival, with whatever came on the same port at the same time."""
        at_ns, _, port, data, change = heapq.heappop(self._arrivals)
        while data and self._arrivals and self._arrivals[0][:3:2] == (at_ns, port):
            if self._arrivals[0][4] is not None:
                break
            data += heapq.heappop(self._arrivals)[3]
        self._now_ns = max(self._now_ns, at_ns)
        if change is None:
            return Chunk(port, self._now_ns, data)
        (self._down.add if change is PortChange.GONE else self._down.discard)(port)
        text = "it hung up" if change is PortChange.GONE else ""
        return Chunk(port, self._now_ns, b"", change, text)
