"""One CAN bus: hands each board its frames, gives the common edge, watches the controller.

Theory of operation. The port's chunks are packed frames. Each is given to the board that
wants its identifier; error frames and counts of lost frames are the bus's own. About five
times a second, at random moments so as not to beat against anything, the host sends SYNC.
Its own echo is the host's time of the edge, not the write call; every board's LATCH that
follows says what its clock was then, and all boards are told the same bracket: after the
write began, before the echo. Where an interface gives no echo, the
LATCH itself is the latest that the edge can have been.

A controller that leaves the bus (bus-off) is brought back by the system (`restart-ms` of
the interface); until then its boards are gone, and afterwards each begins a new epoch.
"""

import random
from collections import Counter
from collections.abc import Sequence

from gyrorig_daemon.config import BusPort
from gyrorig_daemon.links.board_samples import BoardSinks
from gyrorig_daemon.links.can_board import CanBoardLink
from gyrorig_daemon.links.hub import Chunk, PortChange
from gyrorig_daemon.links.pump import Pump
from gyrorig_protocol.can import (
    SYNC_IDENTIFIER,
    BusReport,
    CanFrame,
    FrameFlag,
    FrameType,
    bus_reports,
    pack_frames,
    sync_frame,
    unpack_frames,
)
from gyrorig_protocol.can.board import NODE_BITS
from gyrorig_protocol.errors import DeviceError

EDGES_HELD = 16
IDENTIFIERS_HELD = 1024  # whose frames they are, looked up once
REFUSED_PAUSE_NS = 2_000_000_000  # a full queue is not filled further
QUIET_NS = 60_000_000_000  # the same complaint is written down again after a minute
_NO_DATA = int(FrameFlag.REMOTE | FrameFlag.ERROR | FrameFlag.LOST | FrameFlag.FOREIGN)
_TELL = {
    BusReport.ERROR_PASSIVE: "look at cable, terminators and bitrate",
    BusReport.RX_OVERFLOW: "frames were lost in the controller",
    BusReport.TX_OVERFLOW: "its queue to send is full: nobody acknowledges",
    BusReport.TX_TIMEOUT: "nobody acknowledges",
}


class CanBusLink:
    """The daemon's end of one bus; also the timer of its edges."""

    def __init__(
        self,
        pump: Pump,
        config: BusPort,
        boards: Sequence[CanBoardLink],
        sinks: BoardSinks,
        rng: random.Random,
    ) -> None:
        """Attach to the bus's port, whether it is open or not."""
        self._pump = pump
        self._config = config
        self._boards = boards
        self._sinks = sinks
        self._rng = rng
        self._owners: dict[int, CanBoardLink | None] = {}
        self._edges: dict[int, list[int]] = {}  # low bits -> count, earliest, echo or 0
        self._edge_count = 0
        self._is_off = False
        self._complained: dict[str, int] = {}
        self.counts: Counter[str] = Counter()
        for board in boards:
            board.bus_counts = self.counts
        self.due_ns = pump.now_ns()
        pump.attach(config.hub_port, self._take)
        pump.add_timer(self)

    def fire(self, now_ns: int) -> None:
        """Give the next edge."""
        self.due_ns = now_ns + int(self._rng.uniform(0.25, 1.75) / self._config.sync_hz * 1e9)
        if not self._pump.is_up(self._config.hub_port) or self._is_off:
            return
        if not any(board.known for board in self._boards):
            return
        count, self._edge_count = self._edge_count, self._edge_count + 1
        try:
            stamp = self._pump.write(self._config.hub_port, pack_frames([sync_frame(count)]))
        except DeviceError as fault:
            self.counts["sync_refused"] += 1
            self.due_ns = now_ns + REFUSED_PAUSE_NS
            self._complain("sync", now_ns, f"{fault.what}: its boards get no common edge")
            return
        self.counts["sync_sent"] += 1
        if len(self._edges) >= EDGES_HELD:
            self._drop_edge(next(iter(self._edges)))
        self._edges[count & 0xFF] = [count, stamp.before_ns, 0]

    def _take(self, chunk: Chunk) -> None:
        if chunk.change is PortChange.GONE:
            for board in self._boards:
                board.lose_bus(chunk.text)
            self._edges.clear()
            return
        if chunk.change is PortChange.BACK:
            self._come_back(chunk.received_ns)
        late = chunk.late_ns > 0
        for board in self._boards:
            board.counts.late_chunks += late
        owners = self._owners
        for frame in unpack_frames(chunk.data, chunk.received_ns):
            if frame.flags & _NO_DATA:
                self._take_report(frame)
                continue
            if self._is_off:  # it came back without saying so
                self._come_back(frame.stamp_ns)
            key = frame.key
            owner = owners[key] if key in owners else self._find_owner(key)
            if owner is None:
                self._take_other(frame)
            elif (latch := owner.take_frame(frame)) is not None:
                edge = self._edges.get(latch.counter)
                if edge is not None:
                    owner.take_edge(latch, edge[0], edge[1], edge[2] or latch.received_ns)

    def _find_owner(self, key: int) -> CanBoardLink | None:
        if len(self._owners) >= IDENTIFIERS_HELD:
            self._owners.clear()
        owner = next((board for board in self._boards if board.wants(key)), None)
        self._owners[key] = owner
        return owner

    def _take_other(self, frame: CanFrame) -> None:
        """Take what is no board's: our own edge's echo, or somebody else's traffic."""
        if frame.identifier >> NODE_BITS == FrameType.REQUEST and not frame.flags:
            return  # the echo of our own question
        if frame.identifier != SYNC_IDENTIFIER or frame.flags or len(frame.data) != 1:
            self.counts["other_frames"] += 1
            return
        edge = self._edges.get(frame.data[0])
        if edge is None:
            self.counts["foreign_sync"] += 1  # a second master: its edges are not ours
        elif not edge[2]:
            edge[2] = max(frame.stamp_ns, edge[1])

    def _take_report(self, frame: CanFrame) -> None:
        if frame.flags & FrameFlag.LOST:
            self.counts["lost_in_kernel"] += frame.identifier
            self._complain(
                "lost", frame.stamp_ns, "the system had no room for frames: they are lost"
            )
        elif frame.flags & FrameFlag.FOREIGN:
            self.counts["foreign_frames"] += 1
        elif frame.flags & FrameFlag.ERROR:
            for report in bus_reports(frame):
                self._take_bus_report(report, frame.stamp_ns)

    def _take_bus_report(self, report: BusReport, now_ns: int) -> None:
        self.counts[report.name.lower()] += 1
        if report is BusReport.BUS_OFF and not self._is_off:
            self._is_off = True
            self._edges.clear()
            for board in self._boards:
                board.lose_bus(report.value)
        elif report is BusReport.RESTARTED and self._is_off:
            self._come_back(now_ns)
        elif report in _TELL:
            self._complain(report.name, now_ns, f"{report.value}: {_TELL[report]}")

    def _come_back(self, now_ns: int) -> None:
        self._is_off = False
        self._edges.clear()
        self._owners.clear()
        self.counts["come_back"] += 1
        for board in self._boards:
            board.begin_anew(now_ns)

    def _drop_edge(self, counter: int) -> None:
        if not self._edges.pop(counter)[2]:
            self.counts["sync_without_echo"] += 1

    def _complain(self, what: str, now_ns: int, text: str) -> None:
        """Write a fault down, but not the same one at every frame."""
        last_ns = self._complained.get(what)
        if last_ns is None or now_ns - last_ns > QUIET_NS:
            self._complained[what] = now_ns
            self._sinks.fault(f"bus {self._config.id}: {text}")
