"""A bus and its boards on a scripted hub: bus-off, error-passive, a full queue, lost frames.

The fake bus is as faithful as a test without a controller can be: the error frames are those
that Linux writes (see `test_can_frames`), the boards' frames are made by the protocol.
"""

import random
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import pytest

from gyrorig_daemon.clocks.capture_clock import CaptureClock
from gyrorig_daemon.config import RigConfig, parse_rig
from gyrorig_daemon.links.boards.board_factory import make_board_links
from gyrorig_daemon.links.boards.board_link import BoardLink
from gyrorig_daemon.links.boards.board_presence import LinkState
from gyrorig_daemon.links.boards.sample_stream import BoardSinks
from gyrorig_daemon.links.ports.port_hub import Chunk, PortChange, WriteTimes
from gyrorig_daemon.links.pump import Pump
from gyrorig_protocol.board.json_frames import Hello, Sensor
from gyrorig_protocol.can import (
    BusReport,
    CanFrame,
    FrameFlag,
    FrameType,
    error_frame,
    gyro_frame,
    hello_frames,
    latch_frame,
    pack_frames,
    status_frame,
    unpack_frames,
)
from gyrorig_protocol.errors import DeviceError
from gyrorig_protocol.recording.clock_messages import ClockPing
from gyrorig_protocol.recording.messages import ImuRaw

MS = 1_000_000
BUS = "bus:can0"
PERIOD_US = 10_000
DOCUMENT = """
schema: gyrorig/rig/1
rig: bus-1
ptu: {port: emulated}
buses: [{id: can0, port: "socketcan:can0"}]
boards:
  - {id: A, bus: can0, node: 1}
  - {id: B, bus: can0, node: 2}
"""


@dataclass
class FakeBus:
    """Two boards of 100 Hz on a bus, and a script of what goes wrong."""

    now: int = 10_000_000_000
    epoch_ns: int = 0  # the boards' clocks begin here
    boot: int = 3
    echoes: bool = True
    is_off: bool = False
    refuses: bool = False
    up: bool = True
    lost: set[int] = field(default_factory=set)  # numbers of samples that nobody hears
    sent: list[CanFrame] = field(default_factory=list)
    due: deque[tuple[int, bytes, PortChange | None]] = field(default_factory=deque)
    count: int = 10_000_000_000 // (PERIOD_US * 1000)  # of the sample to come

    def now_ns(self) -> int:
        return self.now

    def is_up(self, port: str) -> bool:
        return self.up

    def reopen(self, port: str) -> None:
        raise AssertionError("a bus is not opened anew for one board")

    def close(self) -> None:
        pass

    def write(self, port: str, data: bytes) -> WriteTimes:
        assert port == BUS
        if self.refuses:
            raise DeviceError("socketcan:can0 (bus:can0) cannot be written: No buffer space", "")
        before = self.now
        self.now += MS // 10
        for frame in unpack_frames(data, self.now):
            self.sent.append(frame)
            if self.is_off:
                continue
            edge_ns = self.now + MS // 10
            answers: list[CanFrame] = []
            if frame.identifier == 0x80:
                if self.echoes:
                    answers.append(CanFrame(0x80, frame.data, 0, edge_ns))
                for node in (1, 2):
                    clock = (edge_ns - self.epoch_ns) // 1000 + 5 * node
                    latch = latch_frame(node, frame.data[0], self.boot, clock)
                    answers.append(stamped(latch, edge_ns + MS))
            elif frame.identifier >> 7 == FrameType.REQUEST:
                node = frame.identifier & 0x7F
                answers += [stamped(f, edge_ns) for f in hello_frames(node, self.hello(node))]
            self.push(edge_ns + MS, pack_frames(answers))
        return WriteTimes(before, self.now)

    def hello(self, node: int) -> bytes:
        sensor = Sensor(211, 250, 0.00875, 100, 25)
        return Hello(1, "1", "GY80", f"uid-{node}", self.boot, (sensor,)).encode_payload()[1:]

    def push(self, at_ns: int, data: bytes, change: PortChange | None = None) -> None:
        self.due.append((at_ns, data, change))
        self.due = deque(sorted(self.due, key=lambda entry: entry[0]))

    def samples_until(self, until_ns: int) -> None:
        """Let both boards send what is due by then."""
        while True:
            at_ns = self.epoch_ns + (self.count + 1) * PERIOD_US * 1000
            if at_ns > until_ns:
                return
            number, self.count = self.count, self.count + 1
            if self.is_off or number in self.lost:
                continue
            time = (at_ns - self.epoch_ns) // 1000
            frames: list[CanFrame] = []
            for node in (1, 2):
                if number % 10 == 0:
                    frames.append(status_frame(node, time, number, self.boot))
                frames.append(gyro_frame(node, (number % 1000, node, 0), time))
            self.push(at_ns + MS, pack_frames([stamped(f, at_ns + MS) for f in frames]))

    def read(self, deadline_ns: int) -> Chunk | None:
        self.samples_until(deadline_ns)
        if self.due and self.due[0][0] <= deadline_ns:
            at_ns, data, change = self.due.popleft()
            self.now = max(self.now, at_ns)
            if change is not None:
                self.up = change is PortChange.BACK
                return Chunk(BUS, self.now, b"", change, "the network is down")
            return Chunk(BUS, self.now, data)
        self.now = max(self.now, deadline_ns)
        return None

    def report(self, report: BusReport) -> None:
        """Inject a report of the controller."""
        self.push(self.now, pack_frames([error_frame(report, self.now)]))


def stamped(frame: CanFrame, stamp_ns: int) -> CanFrame:
    return CanFrame(frame.identifier, frame.data, frame.flags, stamp_ns)


@dataclass
class Rig:
    """What the daemon has of a bus."""

    bus: FakeBus
    config: RigConfig
    samples: dict[str, list[tuple[ImuRaw, int]]] = field(default_factory=dict)
    pings: dict[str, list[ClockPing]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.pump = Pump(self.bus)
        sinks = BoardSinks(self._sample, self._ping, self.notes.append, self.faults.append)
        capture = CaptureClock(0, 0)
        self.boards: list[BoardLink] = make_board_links(
            self.pump, self.config, capture, sinks, seed=1
        )

    def _sample(self, board: str, message: ImuRaw, taken_ns: int) -> None:
        self.samples.setdefault(str(board), []).append((message, taken_ns))

    def _ping(self, board: str, message: ClockPing) -> None:
        self.pings.setdefault(str(board), []).append(message)

    def run(self, seconds: float, is_finished: Callable[[], bool] | None = None) -> bool:
        return self.pump.run_until(self.bus.now + round(seconds * 1e9), is_finished)

    def value(self, name: str) -> int:
        return int(self.boards[0].values().get(f"bus_{name}", "0"))


@pytest.fixture
def rig() -> Rig:
    made = Rig(FakeBus(), parse_rig(DOCUMENT, "rig.yaml"))
    for board in made.boards:
        board.identify()
    return made


def test_every_sample_is_received_once_and_boards_share_edges(rig: Rig) -> None:
    rig.run(10.0)
    for board in rig.boards:
        assert board.is_known
        assert board.metadata()["link"] == "can"
        assert (board.counts.missing, board.counts.restarts, board.counts.reordered) == (0, 0, 0)
    numbers = [message.sequence for message, _ in rig.samples["B"]]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    assert len(numbers) > 990
    both = zip(rig.pings["A"], rig.pings["B"], strict=True)
    assert len(rig.pings["A"]) > 30
    for item, other in both:
        assert (item.nonce, item.host_send_ns, item.host_receive_ns) == (
            other.nonce,
            other.host_send_ns,
            other.host_receive_ns,
        )
        assert other.device_receive - item.device_receive == 5  # of the same edge
    assert not rig.faults


def test_the_clock_map_of_a_board_follows_the_edges(rig: Rig) -> None:
    rig.run(20.0)
    for node, name in ((1, "A"), (2, "B")):
        _, taken_ns = rig.samples[name][-1]
        message = rig.samples[name][-1][0]
        true_ns = rig.bus.epoch_ns + message.device_time * 1000
        # the edge is known to lie in 0.2 ms: write to echo
        assert abs(taken_ns - true_ns) < 0.11 * MS + 5_000 * node


def test_bus_off_and_back_is_a_new_epoch_and_counted(rig: Rig) -> None:
    rig.run(3.0)
    rig.bus.is_off = True
    rig.bus.report(BusReport.BUS_OFF)
    rig.run(0.5)
    assert [board.state for board in rig.boards] == [LinkState.ABSENT] * 2
    sent = len(rig.bus.sent)
    rig.run(5.0)
    assert len(rig.bus.sent) == sent  # nothing is sent to a bus that is off
    rig.bus.is_off = False
    rig.bus.report(BusReport.RESTARTED)
    assert rig.run(3.0, lambda: all(board.is_known for board in rig.boards))
    before = [len(rig.samples[name]) for name in "AB"]
    rig.run(2.0)
    assert [len(rig.samples[name]) for name in "AB"] >= [n + 190 for n in before]
    assert [board.counts.remapped for board in rig.boards] == [1, 1]
    assert [board.counts.restarts for board in rig.boards] == [0, 0]
    assert [board.counts.hung_up for board in rig.boards] == [1, 1]
    assert (rig.value("bus_off"), rig.value("restarted"), rig.value("come_back")) == (1, 1, 1)
    gone = [text for text in rig.faults if "left the bus" in text]
    assert len(gone) == 2


def test_a_bus_that_restarts_without_a_report(rig: Rig) -> None:
    rig.run(3.0)
    rig.bus.is_off = True
    rig.bus.report(BusReport.BUS_OFF)
    rig.run(2.0)
    rig.bus.is_off = False
    assert rig.run(3.0, lambda: all(board.is_known for board in rig.boards))
    assert rig.value("come_back") == 1


def test_error_passive_is_reported_once_and_nothing_is_lost(rig: Rig) -> None:
    rig.run(2.0)
    for _ in range(200):
        rig.bus.report(BusReport.ERROR_PASSIVE)
        rig.run(0.05)
    assert rig.value("error_passive") == 200
    reports = [text for text in rig.faults if "error-passive" in text]
    assert len(reports) == 1
    assert "terminators" in reports[0]
    assert [board.counts.missing for board in rig.boards] == [0, 0]
    rig.run(65.0)
    rig.bus.report(BusReport.ERROR_PASSIVE)
    rig.run(0.1)
    assert len([text for text in rig.faults if "error-passive" in text]) == 2


def test_a_full_queue_costs_edges_not_samples(rig: Rig) -> None:
    rig.run(2.0)
    rig.bus.refuses = True
    counted = [len(rig.samples[name]) for name in "AB"]
    rig.run(20.0)
    assert [len(rig.samples[name]) for name in "AB"] >= [n + 1990 for n in counted]
    assert 8 <= rig.value("sync_refused") <= 12  # tried every two seconds, not at every edge
    assert len([text for text in rig.faults if "no SYNC frames" in text]) == 1
    rig.bus.refuses = False
    edges = len(rig.pings["A"])
    rig.run(5.0)
    assert len(rig.pings["A"]) > edges + 10
    assert [board.counts.missing for board in rig.boards] == [0, 0]


def test_frames_that_the_kernel_dropped_are_counted(rig: Rig) -> None:
    rig.run(2.0)
    first = rig.bus.count
    rig.bus.lost = set(range(first, first + 35))
    rig.run(1.0)
    rig.bus.push(rig.bus.now, pack_frames([CanFrame(70, b"", int(FrameFlag.LOST))]))
    rig.run(2.0)
    assert rig.value("lost_in_kernel") == 70
    assert any("no room for them" in text for text in rig.faults)
    assert [board.counts.missing for board in rig.boards] == [35, 35]


def test_an_interface_without_echo_still_gives_edges() -> None:
    made = Rig(FakeBus(echoes=False), parse_rig(DOCUMENT, "rig.yaml"))
    for board in made.boards:
        board.identify()
    made.run(10.0)
    assert len(made.pings["A"]) > 30
    ping = made.pings["A"][-1]
    assert ping.host_receive_ns - ping.host_send_ns >= MS  # the LATCH's own arrival
    assert made.value("sync_without_echo") > 10


def test_the_interface_goes_down_and_up_again(rig: Rig) -> None:
    rig.run(2.0)
    rig.bus.push(rig.bus.now, b"", PortChange.GONE)
    rig.bus.is_off = True
    rig.run(5.0)
    assert [board.is_absent for board in rig.boards] == [True, True]
    rig.bus.is_off, rig.bus.boot, rig.bus.epoch_ns = False, 4, rig.bus.now
    rig.bus.count = 0
    rig.bus.push(rig.bus.now, b"", PortChange.BACK)
    assert rig.run(3.0, lambda: all(board.is_known for board in rig.boards))
    rig.run(2.0)
    assert [board.counts.restarts for board in rig.boards] == [1, 1]
    assert [board.counts.missing for board in rig.boards] == [0, 0]


def test_one_silent_board_does_not_disturb_the_other(rig: Rig) -> None:
    rig.run(2.0)
    mute = rig.boards[1]
    original = rig.bus.samples_until

    def only_the_first(until_ns: int) -> None:
        original(until_ns)
        rig.bus.due = deque(
            (index, only_node_one(data), change) for index, data, change in rig.bus.due
        )

    rig.bus.samples_until = only_the_first  # type: ignore[method-assign]
    rig.run(40.0)
    assert mute.state in (LinkState.SILENT, LinkState.DEGRADED)
    assert rig.boards[0].is_known
    assert rig.boards[0].counts.missing == 0
    assert any("board B on node 2 of bus can0" in text for text in rig.faults)


def only_node_one(data: bytes) -> bytes:
    return pack_frames(f for f in unpack_frames(data, 0) if f.identifier & 0x7F != 2)


def test_any_bus_traffic_is_counted_and_harmless(rig: Rig) -> None:
    rng = random.Random(4)
    rig.run(1.0)
    for _ in range(300):
        frame = CanFrame(rng.getrandbits(29), rng.randbytes(rng.randint(0, 8)), rng.getrandbits(5))
        rig.bus.push(rig.bus.now, pack_frames([frame]) + rng.randbytes(rng.randint(0, 23)))
        rig.run(0.01)
    rig.bus.push(rig.bus.now, rng.randbytes(2400))
    rig.run(5.0)
    assert all(board.is_known for board in rig.boards)
    assert [board.counts.missing for board in rig.boards] == [0, 0]
    assert rig.value("other_frames") > 10
