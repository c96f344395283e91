"""Samples of one board: counted, timestamped on the capture clock, passed on.

What to use when: `BoardLink` for a board on a port; `SampleStream` is the part that needs no
port. The time of a sample comes from the clock map. Without a map, or if the board sends no
timestamps, it is the arrival time; within a batch, less the board's own time between that
sample and the last one.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from gyrorig_daemon.clocks import OnlineClock
from gyrorig_daemon.clocks.capture_clock import CaptureClock
from gyrorig_daemon.config import BoardPort
from gyrorig_daemon.links.fault_limiter import FaultLimiter
from gyrorig_protocol.board import Batch, FrameEvent, Hello, Sample
from gyrorig_protocol.board_protocols import SerialProtocol, find_protocol
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.clock_messages import ClockPing
from gyrorig_protocol.recording.messages import ImuRaw, ImuStatus

BITS_PER_BYTE = 10
SEQUENCE_BITS = 16
DEFAULT_TICK_HZ = 1e6
PERIOD_TOLERANCE = 0.2  # typical error of the rate 5 %, with an RC oscillator 8 %
_NO_ACCEL = (0, 0, 0)
_ACCEL_VALID = int(ImuStatus.ACCEL_VALID)  # combining enum flags takes 1 us each
_TEMPERATURE_VALID = int(ImuStatus.TEMPERATURE_VALID)


@dataclass(frozen=True, slots=True)
class BoardSinks:
    """Where the messages of a board go; publish times are on the capture clock."""

    sample: Callable[[BoardId, ImuRaw, int], None]
    ping: Callable[[BoardId, ClockPing], None]
    note: Callable[[str], None]
    fault: Callable[[str], None]


class _EpochReason(Enum):
    """Why a new clock epoch starts."""

    STARTED = "the board reported a restart"
    MAPPED = "the board was disconnected"


@dataclass(slots=True)
class BoardCounts:
    """Received and lost samples by cause."""

    samples: int = 0
    missing: int = 0  # according to the board's counter
    duplicated: int = 0
    reordered: int = 0
    restarts: int = 0
    remapped: int = 0  # the clock, after its port was gone
    pings: int = 0
    silences: int = 0
    unmapped: int = 0  # samples with their arrival as publish_time
    hung_up: int = 0
    reopened: int = 0  # the port, because the board was silent
    unidentified: int = 0  # samples ignored because the board had not identified itself
    foreign: int = 0  # how often another board was on the port
    late_chunks: int = 0  # read after a stall of the acquisition process


class SampleStream:
    """Converts frames to messages, with the board's clock and counters."""

    def __init__(self, config: BoardPort, capture: CaptureClock, sinks: BoardSinks) -> None:
        """Start without a clock map."""
        self._config = config
        self._capture = capture
        self._sinks = sinks
        self.faults = FaultLimiter(sinks.fault)  # also for those of the board's link
        self._board_id = config.board_id
        self._protocol = find_protocol(config.format, bool(config.bus))
        self._has_edges = self._protocol.sends_clock_at_edges
        self._hello: Hello | None = None
        self._last_sequence: int | None = None
        self._pending_epoch: _EpochReason | None = None  # starts with the next timestamp
        self._counted_epochs = 0
        self._last_first_sequence = 0  # first sequence of the last frame
        self._last_batch: tuple[int, int] | None = None  # last sequence and its timestamp
        self._frame_durations_ns: dict[int, int] = {}  # by payload length
        self.counts = BoardCounts()
        self.has_samples = False  # a sample arrived, used or not
        self.latency_ns = 0  # of the last sample, from measurement to arrival
        self.worst_latency_ns = 0  # since it was last read
        self.clock = self._new_clock()

    def apply_hello(self, hello: Hello) -> None:
        """Use the board's clock rate and sample rate; start a new map for another clock rate."""
        previous, self._hello = self._hello, hello
        if previous is None or previous.tick_hz != hello.tick_hz:
            self.clock = self._new_clock()
            self._pending_epoch, self._counted_epochs = None, 0

    def restart(self) -> None:
        """Start a new epoch, because the board reported a restart."""
        self._begin_epoch(_EpochReason.STARTED)

    def remap(self) -> None:
        """Start a new map, because the board was disconnected; it may have restarted or not."""
        self._begin_epoch(_EpochReason.MAPPED)

    def count_restart_while_away(self) -> None:
        """Count a restart while the board was disconnected; the new epoch has started already."""
        self.counts.restarts += 1
        self._sinks.fault(f"board {self._board_id} has restarted while it was disconnected")

    @property
    def epoch_count(self) -> int:
        """Number of clock epochs, including the one that starts with the next timestamp."""
        return self.clock.restarts + (self._pending_epoch is not None)

    def handle_frame(self, frame: Sample | Batch, event: FrameEvent) -> None:
        """Count, timestamp and pass on the samples of a frame."""
        if isinstance(frame, Sample):
            self._handle_sample(frame, event)
            return
        samples = frame.to_samples(self._period_ticks(frame))
        last = samples[-1]
        arrival_ns = event.received_ns
        mapped_ns = arrival_ns
        if last.device_time is not None:
            wire_ns = self.frame_duration_ns(len(event.payload))
            mapped_ns = self.clock.observe(
                last.device_time, arrival_ns, wire_ns, last.sequence, not self._has_edges
            )
            self._count_epoch(arrival_ns)  # first: a restart is not a loss of 40000 samples
        self.latency_ns = arrival_ns - mapped_ns
        self.worst_latency_ns = max(self.worst_latency_ns, self.latency_ns)
        self._count(samples)
        for sample in samples:
            taken_ns: int | None = mapped_ns
            if sample is not last and sample.device_time is not None:
                taken_ns = self.clock.map_ns(sample.device_time)
            if taken_ns is None or taken_ns == arrival_ns:
                self.counts.unmapped += 1
                taken_ns = arrival_ns - self._time_before_last_ns(sample, last)
            self._emit(sample, arrival_ns, taken_ns)

    def _handle_sample(self, sample: Sample, event: FrameEvent) -> None:
        """Do the same for a frame of one sample; there are thousands per second."""
        arrival_ns = taken_ns = event.received_ns
        if sample.device_time is not None:
            wire_ns = self.frame_duration_ns(len(event.payload))
            clock = self.clock
            taken_ns = clock.observe(
                sample.device_time, arrival_ns, wire_ns, sample.sequence, not self._has_edges
            )
            if clock.restarts > self._counted_epochs:
                self._count_epoch(arrival_ns)
        latency_ns = self.latency_ns = arrival_ns - taken_ns
        self.worst_latency_ns = max(self.worst_latency_ns, latency_ns)
        self._count([sample])
        if taken_ns == arrival_ns:
            self.counts.unmapped += 1
        self._emit(sample, arrival_ns, taken_ns)

    def _time_before_last_ns(self, sample: Sample, last: Sample) -> int:
        """Return the time between a sample and the last of its batch, by the nominal tick."""
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
        first_sequence = samples[0].sequence
        if self._last_sequence is not None:
            step = (first_sequence - self._last_sequence) % (1 << SEQUENCE_BITS)
            if first_sequence == self._last_first_sequence:
                self.counts.duplicated += len(samples)
            elif step >= 1 << (SEQUENCE_BITS - 1):
                self.counts.reordered += 1
                return  # it was counted as missing before
            else:
                self.counts.missing += step - 1
        self._last_first_sequence, self._last_sequence = first_sequence, samples[-1].sequence

    def _new_clock(self) -> OnlineClock:
        facts, scales = self._config.facts, self._protocol.scales(self._config)
        tick_hz = float(scales.get("tick_hz") or facts.tick_hz or DEFAULT_TICK_HZ)
        if self._hello is not None:
            tick_hz = self._hello.tick_hz
        self._tick_hz = tick_hz
        bits = self._protocol.counter_bits or scales.get("counter_bits") or facts.counter_bits
        return OnlineClock(tick_hz, int(bits or 64), self._protocol.sequence_bits)

    def _period_ticks(self, batch: Batch) -> float:
        """Return the ticks between two samples of a batch.

        Measured since the last batch, because the nominal rate is inaccurate. The nominal period
        without a previous batch, or if the measured one is implausible.
        """
        hello = self._hello
        rate_hz = None if hello is None else hello.sensors[0].rate_hz
        nominal = 0.0 if hello is None or rate_hz is None else hello.tick_hz / rate_hz
        last = (batch.sequence + len(batch.gyro) - 1) % (1 << SEQUENCE_BITS)
        previous, self._last_batch = self._last_batch, (last, batch.device_time)
        if previous is None:
            return nominal
        steps = (last - previous[0]) % (1 << SEQUENCE_BITS)
        passed = (batch.device_time - previous[1]) % (1 << 32)
        period = passed / steps if steps else 0.0
        if nominal and abs(period / nominal - 1.0) > PERIOD_TOLERANCE:
            return nominal
        return period

    def frame_duration_ns(self, payload_bytes: int) -> int:
        """Return the transmission time of a frame from its payload length."""
        duration_ns = self._frame_durations_ns.get(payload_bytes)
        if duration_ns is None:
            protocol = self._protocol
            overhead = protocol.overhead_bytes if isinstance(protocol, SerialProtocol) else 0
            duration_ns = self._frame_durations_ns[payload_bytes] = self.wire_ns(
                payload_bytes + overhead
            )
        return duration_ns

    def wire_ns(self, byte_count: int) -> int:
        """Return the transmission time of bytes; 0 on a bus, where edges are exact."""
        if self._config.bus:
            return 0
        return byte_count * BITS_PER_BYTE * 1_000_000_000 // self._config.baud

    def _begin_epoch(self, reason: "_EpochReason") -> None:
        self.clock.restart()
        self._last_sequence = self._last_batch = None
        if self.counts.samples:
            self._pending_epoch = reason

    def _count_epoch(self, now_ns: int) -> None:
        """Count a new clock epoch as announced or as a fault."""
        if self.clock.restarts <= self._counted_epochs:
            return
        self._counted_epochs, reason, self._pending_epoch = (
            self.clock.restarts,
            self._pending_epoch,
            None,
        )
        self._last_sequence = self._last_batch = None
        if reason is _EpochReason.MAPPED:
            self.counts.remapped += 1
        else:
            self.counts.restarts += 1
            self.faults.report("restart", now_ns, f"board {self._board_id} has restarted its clock")
