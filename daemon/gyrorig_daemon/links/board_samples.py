"""One board's samples: counted, dated on the capture clock, handed on.

What to use when: `BoardLink` for a board on a port; `SampleStream` is the half of it that
no port is needed for. A sample's time is the map's of its own stamp; where there is no
map yet, or the board sends no stamps, it is the arrival, in a batch less the board's own
time between that sample and the last.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from gyrorig_daemon.clocks import OnlineClock
from gyrorig_daemon.config import BoardPort
from gyrorig_daemon.links.capture_clock import CaptureClock
from gyrorig_protocol.board import Batch, FrameEvent, Hello, Sample
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.messages import ClockPing, ImuRaw, ImuStatus

FRAME_OVERHEAD_BYTES = 5  # check 2, stuffing 1, delimiters 2
BITS_PER_BYTE = 10
SEQUENCE_BITS = 16
DEFAULT_TICK_HZ = 1e6
PERIOD_TOLERANCE = 0.2  # rates are off by 5 % as a rule, by 8 % with an RC oscillator
_NO_ACCEL = (0, 0, 0)
_ACCEL_VALID = int(ImuStatus.ACCEL_VALID)  # flags of an enum cost a microsecond each
_TEMPERATURE_VALID = int(ImuStatus.TEMPERATURE_VALID)


@dataclass(frozen=True, slots=True)
class BoardSinks:
    """Where a board's messages go; publish times are on the capture clock."""

    sample: Callable[[BoardId, ImuRaw, int], None]
    ping: Callable[[BoardId, ClockPing], None]
    note: Callable[[str], None]
    fault: Callable[[str], None]


class _Epoch(Enum):
    """Why the map of a clock is begun anew."""

    STARTED = "the board said that it has started"
    MAPPED = "the board was away"


@dataclass(slots=True)
class BoardCounts:
    """What came, and what was lost, by cause."""

    samples: int = 0
    missing: int = 0  # by the board's own counter
    duplicated: int = 0
    reordered: int = 0
    restarts: int = 0
    remapped: int = 0  # its clock, after its port was gone
    pings: int = 0
    silences: int = 0
    unmapped: int = 0  # samples whose publish_time is their arrival
    hung_up: int = 0
    reopened: int = 0  # its port, because it was silent
    unidentified: int = 0  # samples not taken because it had not said yet who it is
    foreign: int = 0  # how often another board was on its port
    late_chunks: int = 0  # read after the acquisition process had stood still


class SampleStream:
    """From frames to messages, with the board's clock and its counts."""

    def __init__(self, config: BoardPort, capture: CaptureClock, sinks: BoardSinks) -> None:
        """Begin without a map of the board's clock."""
        self._config = config
        self._capture = capture
        self._sinks = sinks
        self._board_id = config.board_id
        self._speaks = config.format == "gcb1"
        self._has_edges = self._speaks and bool(config.bus)
        self._hello: Hello | None = None
        self._last_sequence: int | None = None
        self._due: _Epoch | None = None  # begins with the next stamp
        self._epochs_seen = 0
        self._last_first = 0  # of the frame that it ended
        self._last_batch: tuple[int, int] | None = None  # last sequence and its stamp
        self._frames_ns: dict[int, int] = {}  # by length of the payload
        self.counts = BoardCounts()
        self.seen = False  # a sample came, taken or not
        self.latency_ns = 0  # of the last sample, from being taken to its arrival
        self.worst_latency_ns = 0  # until somebody asks
        self.clock = self._new_clock()

    def use_hello(self, hello: Hello) -> None:
        """Take what the board says of its clock and its rate; the first time, map anew."""
        is_first, self._hello = self._hello is None, hello
        if is_first:
            self.clock = self._new_clock()
            self._due, self._epochs_seen = None, 0

    def restart(self) -> None:
        """The board says that it has started anew: nothing before holds for what follows."""
        self._begin_epoch(_Epoch.STARTED)

    def map_anew(self) -> None:
        """The board was away: its clock is mapped anew, whether it has started anew or not."""
        self._begin_epoch(_Epoch.MAPPED)

    def note_start(self) -> None:
        """The board has started anew while it was away: its epoch has begun already."""
        self.counts.restarts += 1
        self._sinks.fault(f"board {self._board_id} has started anew while it was away")

    @property
    def epochs(self) -> int:
        """How often the map of the clock was begun anew, the one that is due with it."""
        return self.clock.restarts + (self._due is not None)

    def take(self, frame: Sample | Batch, event: FrameEvent) -> None:
        """Count, date and hand on what a frame holds."""
        if isinstance(frame, Sample):
            self._take_one(frame, event)
            return
        samples = frame.samples(self._period_ticks(frame))
        last = samples[-1]
        arrival_ns = event.received_ns
        mapped_ns = arrival_ns
        if last.device_time is not None:
            wire_ns = self._frame_ns(len(event.payload))
            mapped_ns = self.clock.observe(
                last.device_time, arrival_ns, wire_ns, last.sequence, not self._has_edges
            )
            self._note_epoch()  # before it is counted: a restart is no loss of 40000 samples
        self.latency_ns = arrival_ns - mapped_ns
        self.worst_latency_ns = max(self.worst_latency_ns, self.latency_ns)
        self._count(samples)
        for sample in samples:
            taken_ns: int | None = mapped_ns
            if sample is not last and sample.device_time is not None:
                taken_ns = self.clock.map_ns(sample.device_time)
            if taken_ns is None or taken_ns == arrival_ns:
                self.counts.unmapped += 1
                taken_ns = arrival_ns - self._before_ns(sample, last)
            self._emit(sample, arrival_ns, taken_ns)

    def _take_one(self, sample: Sample, event: FrameEvent) -> None:
        """Do the same with a frame of one sample: thousands come a second."""
        arrival_ns = taken_ns = event.received_ns
        if sample.device_time is not None:
            wire_ns = self._frame_ns(len(event.payload))
            clock = self.clock
            taken_ns = clock.observe(
                sample.device_time, arrival_ns, wire_ns, sample.sequence, not self._has_edges
            )
            if clock.restarts > self._epochs_seen:
                self._note_epoch()
        latency_ns = self.latency_ns = arrival_ns - taken_ns
        self.worst_latency_ns = max(self.worst_latency_ns, latency_ns)
        self._count([sample])
        if taken_ns == arrival_ns:
            self.counts.unmapped += 1
        self._emit(sample, arrival_ns, taken_ns)

    def _before_ns(self, sample: Sample, last: Sample) -> int:
        """Return how long before the last of its batch a sample was taken, by the nominal tick."""
        if sample.device_time is None or last.device_time is None:
            return 0
        ticks = (last.device_time - sample.device_time) % (1 << 32)
        return 0 if ticks >= 1 << 31 else round(ticks / self._tick_hz * 1e9)

    def _emit(self, sample: Sample, arrival_ns: int, taken_ns: int) -> None:
        status = sample.flags & 0xFF
        if sample.accel is not None:
            status |= _ACCEL_VALID
        if sample.temperature is not None:
            status |= _TEMPERATURE_VALID
        host_ns = self._capture.utc_ns(arrival_ns)
        message = ImuRaw(
            host_ns,
            sample.device_time or 0,
            sample.sequence,
            status,
            sample.temperature or 0,
            sample.gyro,
            sample.accel or _NO_ACCEL,
        )
        self._sinks.sample(self._board_id, message, host_ns + taken_ns - arrival_ns)

    def _count(self, samples: list[Sample]) -> None:
        self.counts.samples += len(samples)
        first = samples[0].sequence
        if self._last_sequence is not None:
            step = (first - self._last_sequence) % (1 << SEQUENCE_BITS)
            if first == self._last_first:
                self.counts.duplicated += len(samples)
            elif step >= 1 << (SEQUENCE_BITS - 1):
                self.counts.reordered += 1
                return  # the one that was counted as missing has come
            else:
                self.counts.missing += step - 1
        self._last_first, self._last_sequence = first, samples[-1].sequence

    def _new_clock(self) -> OnlineClock:
        facts, columns = self._config.facts, self._config.columns
        tick_hz = facts.tick_hz or (columns and columns.tick_hz) or DEFAULT_TICK_HZ
        if self._hello is not None:
            tick_hz = self._hello.tick_hz
        self._tick_hz = tick_hz
        bits = 32 if self._speaks else facts.counter_bits or 64
        return OnlineClock(tick_hz, bits, SEQUENCE_BITS if self._speaks else 32)

    def _period_ticks(self, batch: Batch) -> float:
        """Return the ticks between two samples of a batch.

        As they passed since the last batch, because a nominal rate is no clock; the
        nominal one where no batch came before, or what passed cannot be a period.
        """
        hello = self._hello
        rate_hz = None if hello is None else hello.sensors[0].rate_hz
        nominal = 0.0 if hello is None or rate_hz is None else hello.tick_hz / rate_hz
        last = (batch.sequence + len(batch.gyro) - 1) % (1 << SEQUENCE_BITS)
        before, self._last_batch = self._last_batch, (last, batch.device_time)
        if before is None:
            return nominal
        steps = (last - before[0]) % (1 << SEQUENCE_BITS)
        passed = (batch.device_time - before[1]) % (1 << 32)
        period = passed / steps if steps else 0.0
        if nominal and abs(period / nominal - 1.0) > PERIOD_TOLERANCE:
            return nominal
        return period

    def _frame_ns(self, payload_bytes: int) -> int:
        """Return how long a frame is on the wire, by its payload."""
        found = self._frames_ns.get(payload_bytes)
        if found is None:
            overhead = FRAME_OVERHEAD_BYTES if self._speaks else 0
            found = self._frames_ns[payload_bytes] = self.wire_ns(payload_bytes + overhead)
        return found

    def wire_ns(self, byte_count: int) -> int:
        """Return how long so many bytes are on the wire; a bus's edges are exact without."""
        if self._config.bus:
            return 0
        return byte_count * BITS_PER_BYTE * 1_000_000_000 // self._config.baud

    def _begin_epoch(self, epoch: "_Epoch") -> None:
        self.clock.restart()
        self._last_sequence = self._last_batch = None
        if self.counts.samples:
            self._due = epoch

    def _note_epoch(self) -> None:
        """Count a new epoch of the clock, by whether anybody had announced it."""
        if self.clock.restarts <= self._epochs_seen:
            return
        self._epochs_seen, due, self._due = self.clock.restarts, self._due, None
        self._last_sequence = self._last_batch = None
        if due is _Epoch.MAPPED:
            self.counts.remapped += 1
        else:
            self.counts.restarts += 1
            self._sinks.fault(f"board {self._board_id} has restarted its clock")
