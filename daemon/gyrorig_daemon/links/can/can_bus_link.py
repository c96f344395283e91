"""The link to one CAN bus: distributes frames, sends the common edge, watches the controller.

Theory of operation. The chunks of the port are packed frames. Each goes to the board that owns
its identifier; error frames and counts of lost frames concern the bus. About five times per
second, at random moments so that nothing beats, the host sends SYNC. The time of the edge is
the host's own echo, not the write call. Every board then sends a LATCH with its clock at the
edge, and all boards get the same bracket: after the start of the write, before the echo. If an
interface gives no echo, the arrival of the LATCH is the upper bound.

A controller that leaves the bus (bus-off) is restarted by the system (`restart-ms` of the
interface). Until then its boards are absent; afterwards each starts a new epoch.
"""

import random
from collections import Counter
from collections.abc import Sequence

from gyrorig_daemon.config import BusPort
from gyrorig_daemon.links.boards.sample_stream import BoardSinks
from gyrorig_daemon.links.can.can_board_link import CanBoardLink
from gyrorig_daemon.links.fault_limiter import FaultLimiter
from gyrorig_daemon.links.ports.port_hub import Chunk, PortChange
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
from gyrorig_protocol.can.board_can_frames import NODE_BITS
from gyrorig_protocol.errors import DeviceError

MAX_PENDING_EDGES = 16
MAX_CACHED_KEYS = 1024  # cached owners of identifiers
SYNC_RETRY_NS = 2_000_000_000  # do not fill a full queue further
_NO_DATA = int(FrameFlag.REMOTE | FrameFlag.ERROR | FrameFlag.LOST | FrameFlag.FOREIGN)
_REMEDIES = {
    BusReport.ERROR_PASSIVE: "check cable, terminators and bitrate",
    BusReport.RX_OVERFLOW: "frames were lost in the controller",
    BusReport.TX_OVERFLOW: "the transmit queue is full because no node acknowledges",
    BusReport.TX_TIMEOUT: "no node acknowledges",
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
        self._rng = rng
        self._board_by_key: dict[int, CanBoardLink | None] = {}
        self._edges: dict[int, list[int]] = {}  # low bits -> number, earliest time, echo or 0
        self._edge_count = 0
        self._is_bus_off = False
        self._faults = FaultLimiter(sinks.fault)
        self.counts: Counter[str] = Counter()
        for board in boards:
            board.bus_counts = self.counts
        self.due_ns = pump.now_ns()
        pump.attach(config.hub_port, self._handle_chunk)
        pump.add_timer(self)

    def fire(self, now_ns: int) -> None:
        """Send the next edge."""
        self.due_ns = now_ns + int(self._rng.uniform(0.25, 1.75) / self._config.sync_hz * 1e9)
        if not self._pump.is_up(self._config.hub_port) or self._is_bus_off:
            return
        if not any(board.is_known for board in self._boards):
            return
        count, self._edge_count = self._edge_count, self._edge_count + 1
        try:
            write_times = self._pump.write(self._config.hub_port, pack_frames([sync_frame(count)]))
        except DeviceError as fault:
            self.counts["sync_refused"] += 1
            self.due_ns = now_ns + SYNC_RETRY_NS
            self._report_fault("sync", now_ns, f"{fault.problem}. Its boards get no SYNC frames")
            return
        self.counts["sync_sent"] += 1
        if len(self._edges) >= MAX_PENDING_EDGES:
            self._drop_edge(next(iter(self._edges)))
        self._edges[count & 0xFF] = [count, write_times.before_ns, 0]

    def _handle_chunk(self, chunk: Chunk) -> None:
        if chunk.change is PortChange.GONE:
            for board in self._boards:
                board.disconnect_bus(chunk.text)
            self._edges.clear()
            return
        if chunk.change is PortChange.BACK:
            self._reset_boards(chunk.received_ns)
        late = chunk.late_ns > 0
        for board in self._boards:
            board.counts.late_chunks += late
        board_by_key = self._board_by_key
        for frame in unpack_frames(chunk.data, chunk.received_ns):
            if frame.flags & _NO_DATA:
                self._handle_report_frame(frame)
                continue
            if self._is_bus_off:  # the bus works again without a report
                self._reset_boards(frame.timestamp_ns)
            key = frame.key
            owner = board_by_key[key] if key in board_by_key else self._find_board(key)
            if owner is None:
                self._handle_other_frame(frame)
            elif (latch := owner.handle_frame(frame)) is not None:
                edge = self._edges.get(latch.counter)
                if edge is not None:
                    owner.handle_sync_edge(latch, edge[0], edge[1], edge[2] or latch.received_ns)

    def _find_board(self, key: int) -> CanBoardLink | None:
        if len(self._board_by_key) >= MAX_CACHED_KEYS:
            self._board_by_key.clear()
        owner = next((board for board in self._boards if board.owns_key(key)), None)
        self._board_by_key[key] = owner
        return owner

    def _handle_other_frame(self, frame: CanFrame) -> None:
        """Handle a frame of no board: the echo of our edge, or other traffic."""
        if frame.identifier >> NODE_BITS == FrameType.REQUEST and not frame.flags:
            return  # the echo of our own request
        if frame.identifier != SYNC_IDENTIFIER or frame.flags or len(frame.data) != 1:
            self.counts["other_frames"] += 1
            return
        edge = self._edges.get(frame.data[0])
        if edge is None:
            self.counts["foreign_sync"] += 1  # sent by another host
        elif not edge[2]:
            edge[2] = max(frame.timestamp_ns, edge[1])

    def _handle_report_frame(self, frame: CanFrame) -> None:
        if frame.flags & FrameFlag.LOST:
            self.counts["lost_in_kernel"] += frame.identifier
            self._report_fault(
                "lost",
                frame.timestamp_ns,
                "frames were lost because the system had no room for them",
            )
        elif frame.flags & FrameFlag.FOREIGN:
            self.counts["foreign_frames"] += 1
        elif frame.flags & FrameFlag.ERROR:
            for report in bus_reports(frame):
                self._handle_bus_report(report, frame.timestamp_ns)

    def _handle_bus_report(self, report: BusReport, now_ns: int) -> None:
        self.counts[report.name.lower()] += 1
        if report is BusReport.BUS_OFF and not self._is_bus_off:
            self._is_bus_off = True
            self._edges.clear()
            for board in self._boards:
                board.disconnect_bus(report.value)
        elif report is BusReport.RESTARTED and self._is_bus_off:
            self._reset_boards(now_ns)
        elif report in _REMEDIES:
            self._report_fault(report.name, now_ns, f"{report.value}, {_REMEDIES[report]}")

    def _reset_boards(self, now_ns: int) -> None:
        self._is_bus_off = False
        self._edges.clear()
        self._board_by_key.clear()
        self.counts["come_back"] += 1
        for board in self._boards:
            board.reset_connection(now_ns)

    def _drop_edge(self, counter: int) -> None:
        if not self._edges.pop(counter)[2]:
            self.counts["sync_without_echo"] += 1

    def _report_fault(self, kind: str, now_ns: int, text: str) -> None:
        self._faults.report(kind, now_ns, f"bus {self._config.id}: {text}")
