"""One board's link in simulated time: unplugged, reset, silent, swapped, damaged, and back."""

import random
from collections.abc import Callable

import msgspec
import numpy as np
import pytest

from gyrorig_daemon.clocks.capture_clock import CaptureClock
from gyrorig_daemon.config import BoardFacts, BoardPort
from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.emulator_settings import BoardFaults, BoardSettings, RigSettings
from gyrorig_daemon.emulator.virtual_hub import VirtualHub
from gyrorig_daemon.links.boards.board_link import BoardLink
from gyrorig_daemon.links.boards.board_presence import BoardPresence, LinkState
from gyrorig_daemon.links.boards.sample_stream import BoardSinks, SampleStream
from gyrorig_daemon.links.ports.port_hub import Chunk, PortHub, WriteTimes
from gyrorig_daemon.links.pump import Pump
from gyrorig_protocol.board import FrameEvent, Sample
from gyrorig_protocol.errors import DeviceError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.clock_messages import ClockPing
from gyrorig_protocol.recording.messages import ImuRaw

ORIGIN_NS = 5_000_000_000
UTC_NS = 1_790_000_000_000_000_000
A, B = "board:A", "board:B"
NO_FAULTS, NO_FACTS = BoardFaults(), BoardFacts()


def at_ns(seconds: float) -> int:
    return ORIGIN_NS + round(seconds * 1e9)


class Desk:
    """Two emulated boards, their links, and all that the links said."""

    def __init__(
        self,
        *,
        faults: BoardFaults = NO_FAULTS,
        facts: BoardFacts = NO_FACTS,
        batch: int = 1,
        wrap: Callable[[VirtualHub], PortHub] = lambda hub: hub,
        prepare: Callable[[VirtualHub], None] = lambda hub: None,
    ) -> None:
        boards = (
            BoardSettings("A", faults=faults, batch=batch),
            BoardSettings("B"),
        )
        self.rig = EmulatedRig(RigSettings(seed=4, ptu=None, boards=boards), ORIGIN_NS)
        self.hub = VirtualHub(self.rig)
        prepare(self.hub)
        self.pump = Pump(wrap(self.hub))
        self.samples: dict[str, list[tuple[ImuRaw, int]]] = {"A": [], "B": []}
        self.notices: list[str] = []
        sinks = BoardSinks(self._take, self._ping, self.notices.append, self.notices.append)
        capture = CaptureClock(UTC_NS, ORIGIN_NS)
        self.links = [
            BoardLink(
                self.pump,
                BoardPort(id=name, port=f"/dev/{name}", baud=460800, facts=board_facts),
                capture,
                sinks,
                random.Random(seed),
            )
            for seed, (name, board_facts) in enumerate((("A", facts), ("B", BoardFacts())))
        ]
        self.link, self.other = self.links

    def run(self, until_s: float) -> None:
        self.pump.run_until(at_ns(until_s))

    def sequences(self, name: str = "A") -> list[int]:
        return [message.sequence for message, _ in self.samples[name]]

    def taken_s(self, name: str = "A") -> list[float]:
        return [(taken_ns - UTC_NS) * 1e-9 for _, taken_ns in self.samples[name]]

    def assert_other_is_whole(self) -> None:
        """Whatever became of A, B lost nothing."""
        assert np.all(np.diff(self.sequences("B")) == 1)
        assert self.other.counts.missing == 0

    def _take(self, board_id: BoardId, message: ImuRaw, taken_ns: int) -> None:
        self.samples[str(board_id)].append((message, taken_ns))

    def _ping(self, board_id: BoardId, message: ClockPing) -> None:
        assert message.host_receive_ns >= message.host_send_ns, board_id


def test_a_board_identifies_itself() -> None:
    desk = Desk()
    assert desk.link.state is LinkState.UNKNOWN
    desk.run(0.2)
    assert desk.link.is_known
    assert desk.link.values()["state"] == "known"


def test_a_board_that_is_connected_late() -> None:
    desk = Desk(prepare=lambda hub: hub.unplug(A, ORIGIN_NS, at_ns(3.0)))
    desk.run(1.0)
    assert (desk.link.state, desk.link.is_absent) == (LinkState.ABSENT, True)
    assert desk.samples["A"] == []
    desk.run(4.0)
    assert desk.link.is_known
    assert 85 < len(desk.samples["A"]) < 110
    desk.assert_other_is_whole()


@pytest.mark.parametrize("batch", [1, 8])
def test_a_board_that_is_replugged(batch: int) -> None:
    desk = Desk(batch=batch)
    desk.hub.unplug(A, at_ns(3.0), at_ns(6.0))
    desk.run(9.0)
    link = desk.link
    assert link.is_known
    counts = link.counts
    assert (counts.hung_up, counts.remapped, counts.restarts, counts.missing) == (1, 1, 0, 0)
    assert not any("restarted" in text for text in desk.notices)
    sequences = desk.sequences()
    gap = int(np.argmax(np.diff(sequences)))
    assert sum(step != 1 for step in np.diff(sequences)) == 1
    assert sequences[gap + 1] - sequences[gap] == pytest.approx(300, rel=0.1)
    # what comes before it has said who it is is not taken: some ten milliseconds
    assert sequences[gap + 1] - sequences[gap] < 1.1 * 300 + 2 * batch
    assert link.counts.unidentified < 3 * batch + 1
    assert desk.notices[0] == "board A on /dev/A is gone: it was unplugged"
    assert desk.notices[1].startswith("board A on /dev/A sends samples again, after 3.")
    desk.assert_other_is_whole()
    taken = np.array(desk.taken_s())
    assert np.all(np.diff(taken) > 0.0)
    # a fresh map: the stamps after the gap lie on the true rate, not on the old offset
    arrivals = [(m.host_time_ns - UTC_NS) * 1e-9 for m, _ in desk.samples["A"]]
    assert np.all(np.array(arrivals) - taken >= 0.0)
    assert np.max(np.array(arrivals) - taken) < 0.02 * batch + 0.02


@pytest.mark.parametrize("silence_s", [0.0, 0.05, 0.5])
@pytest.mark.parametrize("at_s", [3.0, 3.13])
def test_a_reset_is_one_new_epoch(at_s: float, silence_s: float) -> None:
    desk = Desk(faults=BoardFaults(reset_at_s=(at_s,), reset_silence_s=silence_s))
    desk.run(5.5)
    link = desk.link
    assert link.counts.restarts == 1
    assert desk.notices.count("board A has restarted its clock") == 1
    assert link.counts.missing <= 1  # nothing joined over the reset
    taken = np.array(desk.taken_s())
    assert np.all(np.diff(taken) > 0.0)
    assert np.max(np.diff(taken)) < silence_s + 0.1
    desk.assert_other_is_whole()


def test_a_reset_while_it_is_unplugged_and_two_in_a_row() -> None:
    desk = Desk(faults=BoardFaults(reset_at_s=(4.0, 7.0, 7.3), reset_silence_s=0.1))
    desk.hub.unplug(A, at_ns(3.0), at_ns(5.0))
    desk.run(9.0)
    assert (desk.link.counts.restarts, desk.link.counts.remapped) == (3, 1)
    assert sum("has restarted while it was disconnected" in text for text in desk.notices) == 1
    assert desk.link.is_known
    assert np.all(np.diff(desk.taken_s()) > 0.0)
    assert desk.link.hello is not None
    boots = {payload[payload.find(b'"boot":') :][:9] for payload in desk.link.hello_bytes}
    assert len(boots) >= 3


def test_another_board_on_the_port_is_not_recorded() -> None:
    desk = Desk()
    desk.run(2.0)
    for link in desk.links:
        link.pin_identity()
    for port in (A, B):
        desk.hub.unplug(port, at_ns(2.5), at_ns(3.0))
    desk.run(2.7)
    desk.hub.swap(A, B)
    known = len(desk.samples["A"]), len(desk.samples["B"])
    desk.run(6.0)
    assert [link.state for link in desk.links] == [LinkState.FOREIGN] * 2
    assert (len(desk.samples["A"]), len(desk.samples["B"])) == known
    assert desk.link.counts.foreign == 1
    assert sum("is another board: " in text for text in desk.notices) == 2
    for port in (A, B):
        desk.hub.unplug(port, at_ns(6.5), at_ns(7.0))
    desk.run(6.7)
    desk.hub.swap(A, B)
    desk.run(9.0)
    assert all(link.is_known for link in desk.links)


def test_a_board_can_be_replaced_between_recordings() -> None:
    desk = Desk()
    desk.run(2.0)
    desk.link.pin_identity()
    first = desk.link.metadata()["uid"]
    for port in (A, B):
        desk.hub.unplug(port, at_ns(2.5), at_ns(3.0))
    desk.run(2.7)
    desk.hub.swap(A, B)
    desk.run(5.0)
    assert desk.link.state is LinkState.FOREIGN
    desk.link.unpin_identity()
    desk.run(7.0)
    assert desk.link.is_known
    assert desk.link.metadata()["uid"] != first
    assert len(desk.link.hello_bytes) == 1


def test_a_board_with_another_uid_than_configured() -> None:
    desk = Desk(facts=BoardFacts(uid="0badc0de"))
    with pytest.raises(DeviceError, match=r"another board: .* instead of '0badc0de'"):
        desk.link.identify()
    desk.run(3.0)
    assert desk.link.state is LinkState.FOREIGN
    assert desk.samples["A"] == []


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fifth of all patience: ports are opened anew after 1, 2, 4 s."""
    monkeypatch.setattr("gyrorig_daemon.links.boards.board_presence.REOPEN_AFTER_S", 1.0)
    monkeypatch.setattr("gyrorig_daemon.links.boards.board_presence.SILENCE_S", 0.4)


@pytest.mark.usefixtures("impatient")
def test_a_silent_port_is_reopened_and_then_reported() -> None:
    desk = Desk(faults=BoardFaults(reset_at_s=(1.0,), reset_silence_s=10.0))
    desk.run(1.9)
    assert (desk.link.state, desk.link.counts.reopened) == (LinkState.SILENT, 0)
    desk.run(10.5)
    assert (desk.link.state, desk.link.counts.reopened) == (LinkState.DEGRADED, 3)
    assert sum("Check the board" in text for text in desk.notices) == 1
    assert desk.link.counts.hung_up == 0
    desk.run(13.0)
    assert desk.link.is_known
    assert any("sends samples again, after 10." in text for text in desk.notices)
    desk.assert_other_is_whole()


@pytest.mark.usefixtures("impatient")
def test_bytes_that_are_not_samples() -> None:
    desk = Desk(faults=BoardFaults(garbage=True))
    desk.run(8.5)
    assert desk.link.state is LinkState.DEGRADED
    (notice,) = (text for text in desk.notices if "Check the board" in text)
    assert "sends no gcb1 samples but b'" in notice
    assert int(desk.link.values()["fault_crc"]) + int(desk.link.values()["fault_cobs"]) > 0
    desk.assert_other_is_whole()


def test_the_reopening_interval_doubles_up_to_a_minute() -> None:
    presence, now_s, opened_s = BoardPresence(True, 0), 0, []
    presence.mark_sample(0)
    while now_s < 400:
        now_s += 1
        presence.detect_silence(now_s * 1_000_000_000)
        if presence.is_reopening_due(now_s * 1_000_000_000):
            opened_s.append(now_s)
            presence.mark_reopened(now_s * 1_000_000_000)
    assert opened_s[:6] == [5, 15, 35, 75, 135, 195]
    assert presence.state is LinkState.DEGRADED


class Deaf:
    """A hub whose port A takes no bytes for a while."""

    def __init__(self, hub: VirtualHub, from_s: float, until_s: float) -> None:
        self._hub, self._from_ns, self._until_ns = hub, at_ns(from_s), at_ns(until_s)
        self.refused = 0

    def now_ns(self) -> int:
        return self._hub.now_ns()

    def write(self, port: str, data: bytes) -> WriteTimes:
        if port == A and self._from_ns <= self.now_ns() < self._until_ns:
            self.refused += 1
            raise DeviceError("board:A cannot be written: it does not take bytes")
        return self._hub.write(port, data)

    def read(self, deadline_ns: int) -> Chunk | None:
        return self._hub.read(deadline_ns)

    def is_up(self, port: str) -> bool:
        return self._hub.is_up(port)

    def reopen(self, port: str) -> None:
        self._hub.reopen(port)

    def close(self) -> None:
        self._hub.close()


def test_a_port_that_takes_no_requests_is_asked_rarely(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gyrorig_daemon.links.boards.board_link.WRITE_RETRY_S", 4.0)
    deaf: list[Deaf] = []

    def wrap(hub: VirtualHub) -> Deaf:
        deaf.append(Deaf(hub, 2.0, 8.0))
        return deaf[0]

    desk = Desk(wrap=wrap)
    desk.run(8.0)
    assert deaf[0].refused == 2
    assert desk.link.is_known
    assert desk.link.counts.missing == 0  # its samples go on
    pings = desk.link.counts.pings
    desk.run(12.0)
    assert desk.link.counts.pings > pings


@pytest.mark.parametrize("batch", [1, 8])
def test_no_sample_is_used_before_the_board_is_identified(batch: int) -> None:
    desk = Desk(batch=batch, wrap=lambda hub: Deaf(hub, 0.0, 100.0))
    desk.rig.boards["A"]._other_frames.clear()  # its own HELLO at power-up was lost
    desk.run(3.0)
    assert desk.samples["A"] == []
    assert desk.link.counts.unidentified > 250
    assert desk.link.state is LinkState.UNKNOWN
    with pytest.raises(DeviceError, match="cannot be written"):
        desk.link.identify()


def test_losses_reported_by_the_board_are_kept() -> None:
    desk = Desk()
    desk.run(3.0)
    values = desk.link.values()
    assert values["board_sensor_overruns"] == values["board_frames_dropped"] == "0"
    assert values["board_supply_mv"] == "3300"
    assert desk.link.slow is not None


def test_a_reset_is_not_counted_as_lost_samples() -> None:
    notices: list[str] = []
    sinks = BoardSinks(lambda *_: None, lambda *_: None, notices.append, notices.append)
    config = BoardPort(id="A", port="/dev/A")
    stream = SampleStream(config, CaptureClock(UTC_NS, ORIGIN_NS), sinks)
    for number in (*range(39_000, 40_000), *range(100)):
        ticks = number * 10_000 % (1 << 32)
        arrival_ns = ORIGIN_NS + 10_000_000 * (number if number >= 39_000 else number + 40_000)
        frame = Sample(0, number, ticks, (0, 0, 0))
        stream.handle_frame(frame, FrameEvent(frame, arrival_ns, 0, b""))
    assert (stream.counts.missing, stream.counts.reordered) == (0, 0)
    assert stream.counts.restarts == 1
    assert notices == ["board A has restarted its clock"]


def test_a_board_that_restarts_its_clock_all_the_time_is_recorded_once_per_minute() -> None:
    notices: list[str] = []
    sinks = BoardSinks(lambda *_: None, lambda *_: None, notices.append, notices.append)
    stream = SampleStream(BoardPort(id="A", port="/dev/A"), CaptureClock(UTC_NS, ORIGIN_NS), sinks)
    for number in range(15_000):  # 150 s; each clock lasts 1 s
        ticks = number % 100 * 10_000 + 1_000_000 * (number // 100 % 2)
        frame = Sample(0, number % 100, ticks, (0, 0, 0))
        arrival_ns = ORIGIN_NS + 10_000_000 * number
        stream.handle_frame(frame, FrameEvent(frame, arrival_ns, 0, b""))
    assert stream.counts.restarts > 50
    assert len(notices) == 3
    assert notices[1].startswith("board A has restarted its clock (")
    omitted_count = sum(int(text.split("(")[1].split()[0]) for text in notices[1:])
    assert 3 + omitted_count <= stream.counts.restarts


def test_a_board_that_alternates_its_configuration_is_recorded_once_per_minute() -> None:
    desk = Desk()
    desk.run(1.0)
    hello = desk.link.hello
    assert hello is not None
    for number in range(100):
        changed = msgspec.structs.replace(hello, config=f"c{number % 2}")
        payload = f"hello {number}".encode()
        desk.link._handle_event(FrameEvent(changed, desk.pump.now_ns(), 0, payload))
    assert desk.notices == ["board A has changed its configuration"]
    desk.run(70.0)
    changed = msgspec.structs.replace(hello, config="c2")
    desk.link._handle_event(FrameEvent(changed, desk.pump.now_ns(), 0, b"hello"))
    assert desk.notices[1:] == [
        "board A has changed its configuration (99 more since the last report of this fault)"
    ]


@pytest.mark.parametrize("batch", [1, 8])
def test_duplicated_frames_are_counted(batch: int) -> None:
    desk = Desk(faults=BoardFaults(duplicate_frame_every=7), batch=batch)
    desk.run(5.0)
    counts, sequences = desk.link.counts, np.array(desk.sequences())
    assert counts.duplicated == len(sequences) - len(np.unique(sequences)) > 5
    assert (counts.reordered, counts.missing) == (0, 0)


def test_lost_samples_are_counted_exactly() -> None:
    faults = BoardFaults(drop_frame_every=50, duplicate_frame_every=70)
    desk = Desk(faults=faults)
    desk.run(10.0)
    sequences = np.array(desk.sequences())
    steps = np.diff(sequences)
    assert desk.link.counts.missing == int(np.sum(steps[steps > 1] - 1)) > 15
    assert desk.link.counts.duplicated == int(np.sum(steps == 0)) > 10
    assert desk.link.counts.reordered == 0


def test_swapped_samples_are_counted() -> None:
    desk = Desk(faults=BoardFaults(swap_frames_every=40))
    desk.run(10.0)
    steps = np.diff(desk.sequences())
    assert desk.link.counts.reordered == int(np.sum(steps < 0)) > 15
    assert set(np.unique(steps)) == {-1, 1, 2}
    assert desk.link.counts.restarts == 0


class Lagging:
    """A hub that hands out what came seconds ago, as to a daemon that has no time."""

    def __init__(self, hub: VirtualHub, lag_s: float) -> None:
        self._hub, self._lag_ns = hub, round(lag_s * 1e9)

    def __getattr__(self, name: str) -> object:
        return getattr(self._hub, name)

    def now_ns(self) -> int:
        return self._hub.now_ns() + self._lag_ns

    def read(self, deadline_ns: int) -> Chunk | None:
        while (chunk := self._hub.read(deadline_ns)) is None:  # something always waits
            deadline_ns += 1_000_000
        return chunk


def test_buffered_chunks_are_not_silence() -> None:
    desk = Desk(wrap=lambda hub: Lagging(hub, 30.0))  # type: ignore[arg-type,return-value]
    desk.pump.run_until(at_ns(40.0))
    assert desk.link.is_known
    assert (desk.link.counts.silences, desk.link.counts.reopened) == (0, 0)
    desk.assert_other_is_whole()


class Late:
    """A hub whose reading process stood still once."""

    def __init__(self, hub: VirtualHub, at_s: float) -> None:
        self._hub, self._at_ns = hub, at_ns(at_s)
        self._left = 3

    def __getattr__(self, name: str) -> object:
        return getattr(self._hub, name)

    def read(self, deadline_ns: int) -> Chunk | None:
        chunk = self._hub.read(deadline_ns)
        if chunk is None or chunk.received_ns < self._at_ns or not self._left:
            return chunk
        self._left -= 1
        return chunk._replace(late_ns=1_200_000_000)


def test_late_timestamps_are_reported_once() -> None:
    desk = Desk(wrap=lambda hub: Late(hub, 5.0))  # type: ignore[arg-type,return-value]
    stamps: list[tuple[str, int, int]] = []
    desk.pump.on_stall = lambda *stall: stamps.append(stall)
    desk.run(5.5)
    ((who, begin_ns, end_ns),) = stamps
    assert who == "the acquisition process"
    assert end_ns - begin_ns == 1_200_000_000
    assert desk.pump.late_stalls == 1
    assert sum(link.counts.late_chunks for link in desk.links) == 3


@pytest.mark.parametrize("seed", [1, 2])
def test_no_fault_gives_a_sample_a_wrong_time(seed: int) -> None:
    """Pulled, reset, damaged and silent at random: late at worst, and the other board whole."""
    rng = random.Random(seed)
    pulls = [(at_s, rng.choice([0.002, 0.3, 2.0])) for at_s in np.arange(rng.uniform(0, 5), 17, 5)]
    faults = BoardFaults(
        reset_at_s=tuple(sorted(rng.uniform(1.0, 17.0) for _ in range(3))),
        reset_silence_s=rng.choice([0.05, 0.5, 2.0]),
        drop_frame_every=37,
        flip_bit_every=61,
        garbage_every=71,
    )

    def prepare(hub: VirtualHub) -> None:
        for at_s, away_s in pulls:
            hub.unplug(A, at_ns(at_s), at_ns(at_s + away_s))

    desk = Desk(faults=faults, prepare=prepare)
    desk.run(21.0)
    assert desk.link.is_known
    assert len(desk.samples["A"]) > 700
    clock = desk.rig.boards["A"].clock
    late_us = [
        (clock.ticks(taken_ns - UTC_NS + ORIGIN_NS) - message.device_time) % (1 << 32)
        for message, taken_ns in desk.samples["A"]
    ]
    signed_us = np.array(late_us, dtype=np.int64)
    signed_us[signed_us >= 1 << 31] -= 1 << 32
    assert np.max(np.abs(signed_us)) < 20_000  # arrivals, before there is a map
    assert np.median(np.abs(signed_us)) < 200
    desk.assert_other_is_whole()
