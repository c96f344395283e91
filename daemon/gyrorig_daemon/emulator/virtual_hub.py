"""Virtual hub: the emulated rig in simulated time, with the same bytes as in real time.

Theory of operation. The clock advances only in `read`: to the next arrival at the host, or to the
deadline. Bytes that leave a device get their arrival time from the latency model; arrivals wait
in a heap. Before one is delivered, every device is asked for the bytes that have left its line
until then, because they could arrive earlier. The time of a device's next output changes only when
a device receives bytes, or when its output is collected, so it is computed once in between.
"""

import heapq

from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.links.ports.port_hub import Chunk, PortChange, WriteTimes
from gyrorig_protocol.errors import DeviceError

NEVER_NS = 1 << 62
REOPEN_TIME_NS = 10_000_000

_Arrival = tuple[int, int, str, bytes, PortChange | None]


class VirtualHub:
    """A `PortHub` of an emulated rig. It starts at the rig's power-up."""

    def __init__(self, rig: EmulatedRig) -> None:
        """Drive `rig`, exclusively."""
        self.rig = rig
        self._devices = rig.devices
        self._latency = rig.latency
        self._now_ns = rig.origin_ns
        self._arrivals: list[_Arrival] = []
        self._order = 0
        self._closed = False
        self._unplugged: dict[str, list[tuple[int, int]]] = {port: [] for port in self._devices}
        self._down: set[str] = set()
        self._due_ns: dict[str, int | None] = {}  # of the next output, by port; missing: not known

    def unplug(self, port: str, at_ns: int, until_ns: int | None = None) -> None:
        """Disconnect a device at a future time, and connect it again at `until_ns`, or never.

        The device continues to run.
        """
        self._push(at_ns, port, b"", PortChange.GONE)
        if until_ns is not None:
            self._push(until_ns, port, b"", PortChange.BACK)
        self._unplugged[port].append((at_ns, NEVER_NS if until_ns is None else until_ns))

    def swap(self, port: str, other: str) -> None:
        """Exchange the devices of two ports, as happens with unstable port names."""
        self._devices[port], self._devices[other] = self._devices[other], self._devices[port]
        self._due_ns.clear()

    def now_ns(self) -> int:
        """Return the virtual clock."""
        return self._now_ns

    def write(self, port: str, data: bytes) -> WriteTimes:
        """Send bytes to a device; they start on its line after a short delay.

        Raises:
            DeviceError: there is no such port, it is gone, or the hub is closed.
        """
        device = self._devices.get(port)
        if device is None or self._closed:
            raise DeviceError(
                f"the emulated rig has no device on the port {port!r}",
                "check the ports in the rig file",
            )
        if self._is_unplugged(port, self._now_ns):
            raise DeviceError(
                f"the emulator has disconnected the device on the port {port!r}",
                "wait until the emulator connects the device again",
            )
        device.receive(data, self._latency.line_ns(self._now_ns))
        self._due_ns.clear()  # of all devices: a command to the unit also moves the boards
        return WriteTimes(self._now_ns, self._now_ns)

    def read(self, deadline_ns: int) -> Chunk | None:
        """Return the next chunk of any port in order of time, None at the deadline."""
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
        """Return whether the port is open, according to the chunks that `read` has returned."""
        return port not in self._down

    def reopen(self, port: str) -> None:
        """Close a port and open it again, unless it is disconnected."""
        if not self._is_unplugged(port, self._now_ns):
            self.unplug(port, self._now_ns, self._now_ns + REOPEN_TIME_NS)

    def close(self) -> None:
        """Release all ports; a second call does nothing."""
        self._closed = True

    def _next_output(self) -> tuple[int | None, str]:
        best_ns: int | None = None
        best_port = ""
        known_ns = self._due_ns
        for port, device in self._devices.items():
            if port not in known_ns:
                known_ns[port] = device.next_output_ns()
            due_ns = known_ns[port]
            if due_ns is not None and (best_ns is None or due_ns < best_ns):
                best_ns, best_port = due_ns, port
        return best_ns, best_port

    def _collect(self, port: str, until_ns: int) -> None:
        del self._due_ns[port]
        for line_ns, data in self._devices[port].take_output(until_ns):
            arrival_ns = self._latency.arrival_ns(port, line_ns)
            if not self._is_unplugged(port, arrival_ns):
                self._push(arrival_ns, port, data)

    def _push(self, at_ns: int, port: str, data: bytes, change: PortChange | None = None) -> None:
        heapq.heappush(self._arrivals, (at_ns, self._order, port, data, change))
        self._order += 1

    def _is_unplugged(self, port: str, at_ns: int) -> bool:
        return any(begin_ns <= at_ns < end_ns for begin_ns, end_ns in self._unplugged[port])

    def _deliver(self) -> Chunk:
        """Return the first arrival, joined with others on the same port at the same time."""
        at_ns, _, port, data, change = heapq.heappop(self._arrivals)
        while data and self._arrivals and self._arrivals[0][:3:2] == (at_ns, port):
            if self._arrivals[0][4] is not None:
                break
            data += heapq.heappop(self._arrivals)[3]
        self._now_ns = max(self._now_ns, at_ns)
        if change is None:
            return Chunk(port, self._now_ns, data)
        (self._down.add if change is PortChange.GONE else self._down.discard)(port)
        text = "it was unplugged" if change is PortChange.GONE else ""
        return Chunk(port, self._now_ns, b"", change, text)
