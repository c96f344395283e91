"""Virtual hub: the emulated rig in simulated time, with the same bytes as in real time.

Theory of operation. The clock advances only in `read`: to the next arrival at the host, or to the
deadline. Bytes that leave a device get their arrival time from the latency model; arrivals wait
in a heap. Before one is delivered, every device is asked for the bytes that have left its line
until then, because they could arrive earlier. The time of a device's next output changes only when
it receives bytes, when its output is collected, or when the stage moves in another way. In between,
the first output of all devices is known, and a read does not depend on their number.
"""

import heapq

from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.links.ports.port_hub import Chunk, PortChange, WriteTimes
from gyrorig_protocol.errors import DeviceError

NEVER_NS = 1 << 63  # later than any deadline
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
        self._due_ns: dict[str, int] = {}  # of the next output, by port
        self._changed_ports = list(self._devices)  # whose next output must be asked for again
        self._first_output = (NEVER_NS, "")  # its time and port, while no port has changed
        self._revision = rig.stage.revision

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
        self._changed_ports = list(self._devices)

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
        self._changed_ports.append(port)
        revision = self.rig.stage.revision
        if revision != self._revision:  # a command to the unit also moves the boards
            self._revision, self._changed_ports = revision, list(self._devices)
        return WriteTimes(self._now_ns, self._now_ns)

    def read(self, deadline_ns: int) -> Chunk | None:
        """Return the next chunk of any port in order of time, None at the deadline."""
        limit_ns = max(deadline_ns, self._now_ns)
        while not self._closed:
            if self._changed_ports:
                self._find_first_output()
            due_ns, port = self._first_output
            arrival_ns = self._arrivals[0][0] if self._arrivals else NEVER_NS
            if due_ns <= arrival_ns and due_ns <= limit_ns:
                self._collect(port, due_ns)
            elif arrival_ns <= limit_ns:
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

    def _find_first_output(self) -> None:
        for port in self._changed_ports:
            due_ns = self._devices[port].next_output_ns()
            self._due_ns[port] = NEVER_NS if due_ns is None else due_ns
        self._changed_ports.clear()
        port = min(self._due_ns, key=self._due_ns.__getitem__)
        self._first_output = self._due_ns[port], port

    def _collect(self, port: str, until_ns: int) -> None:
        self._changed_ports.append(port)
        for line_ns, data in self._devices[port].take_output(until_ns):
            arrival_ns = self._latency.arrival_ns(port, line_ns)
            if not self._is_unplugged(port, arrival_ns):
                self._push(arrival_ns, port, data)

    def _push(self, at_ns: int, port: str, data: bytes, change: PortChange | None = None) -> None:
        heapq.heappush(self._arrivals, (at_ns, self._order, port, data, change))
        self._order += 1

    def _is_unplugged(self, port: str, at_ns: int) -> bool:
        intervals_ns = self._unplugged[port]  # nearly always none
        return bool(intervals_ns) and any(begin <= at_ns < end for begin, end in intervals_ns)

    def _deliver(self) -> Chunk:
        """Return the first arrival, joined with others on the same port at the same time."""
        arrivals = self._arrivals
        at_ns, _, port, data, change = heapq.heappop(arrivals)
        while data and arrivals and arrivals[0][0] == at_ns:
            if arrivals[0][2] != port or arrivals[0][4] is not None:
                break
            data += heapq.heappop(arrivals)[3]
        self._now_ns = max(self._now_ns, at_ns)
        if change is None:
            return Chunk(port, self._now_ns, data)
        (self._down.add if change is PortChange.GONE else self._down.discard)(port)
        text = "it was unplugged" if change is PortChange.GONE else ""
        return Chunk(port, self._now_ns, b"", change, text)
