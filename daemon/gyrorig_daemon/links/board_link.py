"""One board: its bytes to samples with times, its clock, and what went wrong.

The parser and the clock know nothing of ports; this ties them to one. A board that
speaks GCB1 is asked who it is after opening and after silence, and for its clock about
five times a second at random moments: a regular question would beat against the frames
of USB (reference: timesync.md section 3.3).
"""

import random
from collections.abc import Callable
from dataclasses import dataclass

from gyrorig_daemon.clocks import ClockReport, OnlineClock
from gyrorig_daemon.config import BoardPort
from gyrorig_daemon.links.board_facts import board_metadata, make_parser
from gyrorig_daemon.links.capture_clock import CaptureClock
from gyrorig_daemon.links.hub import Chunk
from gyrorig_daemon.links.pump import Pump
from gyrorig_protocol.board import (
    Batch,
    BoardEvent,
    FrameEvent,
    FrameFault,
    Hello,
    HelloRequest,
    Sample,
    Slow,
    TimeReply,
    TimeRequest,
)
from gyrorig_protocol.errors import DeviceError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.messages import ClockPing, ImuRaw, ImuStatus

PING_MEAN_S = 0.2
SILENCE_S = 2.0
HELLO_PATIENCE_S = 5.0
HELLO_EVERY_S = 1.0
PINGS_HELD = 32
FRAME_OVERHEAD_BYTES = 5  # check 2, stuffing 1, delimiters 2
BITS_PER_BYTE = 10
SEQUENCE_BITS = 16
DEFAULT_TICK_HZ = 1e6
PERIOD_TOLERANCE = 0.2  # rates are off by 5 % as a rule, by 8 % with an RC oscillator
_ACCEL_VALID = int(ImuStatus.ACCEL_VALID)  # flags of an enum cost a microsecond each
_TEMPERATURE_VALID = int(ImuStatus.TEMPERATURE_VALID)


@dataclass(frozen=True, slots=True)
class BoardSinks:
    """Where a board's messages go; publish times are on the capture clock."""

    sample: Callable[[BoardId, ImuRaw, int], None]
    ping: Callable[[BoardId, ClockPing], None]
    note: Callable[[str], None]
    fault: Callable[[str], None]


@dataclass(slots=True)
class BoardCounts:
    """What came, and what was lost, by cause."""

    samples: int = 0
    missing: int = 0  # by the board's own counter
    duplicated: int = 0
    reordered: int = 0
    restarts: int = 0
    pings: int = 0
    silences: int = 0
    unmapped: int = 0  # samples whose publish_time is their arrival
    hung_up: int = 0


class BoardLink:
    """The daemon's end of one board's line; also the timer of its questions."""

    def __init__(
        self,
        pump: Pump,
        config: BoardPort,
        clock: CaptureClock,
        sinks: BoardSinks,
        rng: random.Random,
    ) -> None:
        self._pump = pump
        self._config = config
        self._capture = clock
        self._sinks = sinks
        self._rng = rng
        self.board_id = config.board_id
        self.hello: Hello | None = None
        self.hello_bytes: list[bytes] = []  # payloads as received, for the recording
        self.counts = BoardCounts()
        self.gone = False
        self._speaks = config.format == "gcb1"
        self._parser = make_parser(config)
        self._clock = self._new_clock()
        self._boot: int | None = None
        self._last_sequence: int | None = None
        self._last_batch: tuple[int, int] | None = None  # last sequence and its stamp
        self._last_sample_ns = pump.now_ns()
        self._last_asked_ns = pump.now_ns()
        self._silent = False
        self._pings: dict[int, tuple[int, int]] = {}
        self._next_nonce = rng.getrandbits(32)
        self._first_bytes = b""
        self.due_ns = pump.now_ns()
        pump.attach(config.hub_port, self._take)
        pump.add_timer(self)

    def identify(self) -> None:
        """Wait until the board has said who it is and sent a sample.

        Raises:
            DeviceError: it is silent, or what comes is not what a board sends.
        """
        end_ns = self._pump.now_ns() + int(HELLO_PATIENCE_S * 1e9)
        while self._pump.now_ns() < end_ns and not self._is_known():
            if self._speaks and not self.gone:
                self._pump.write(self._config.hub_port, HelloRequest().encode())
            next_ns = self._pump.now_ns() + int(HELLO_EVERY_S * 1e9)
            self._pump.run_until(min(next_ns, end_ns), self._is_known)
        if self.gone:
            raise DeviceError(f"{self._where()} hung up", "check the cable")
        if not self._first_bytes:
            raise DeviceError(f"{self._where()} is silent", "check its power, the cable, the port")
        if not self.counts.samples:
            raise DeviceError(
                f"{self._where()} sends no {self._config.format} samples but "
                f"{self._first_bytes[:24]!r}",
                "check the port, the baud rate and the format",
            )
        if self._speaks and self.hello is None:
            raise DeviceError(f"{self._where()} does not say who it is", "check its firmware")
        self.metadata()  # raises where the board and the configuration leave too much open

    def metadata(self) -> dict[str, str]:
        """Return the recording's `gyrorig.board.<id>` record."""
        return board_metadata(self._config, self.hello)

    def clock_report(self) -> ClockReport:
        """Return the state of the board's clock map."""
        return self._clock.report()

    def faults(self) -> dict[str, int]:
        """Return the parser's counters by cause."""
        return {cause.name.lower(): count for cause, count in self._parser.faults.items()}

    def map_ns(self, device_time: int) -> int | None:
        """Return the raw monotonic time of a device stamp, None without a map."""
        return self._clock.map_ns(device_time)

    def fire(self, now_ns: int) -> None:
        """Ask for the clock; after a silence, ask who is there."""
        self.due_ns = now_ns + int(self._rng.uniform(0.25, 1.75) * PING_MEAN_S * 1e9)
        if self.gone:
            return
        silent = now_ns - self._last_sample_ns > SILENCE_S * 1e9
        if silent and not self._silent:
            self._silent = True
            self.counts.silences += 1
            self._sinks.fault(f"{self._where()} has sent no sample for {SILENCE_S:g} s")
        if not self._speaks:
            return
        try:
            if silent and now_ns - self._last_asked_ns > HELLO_EVERY_S * 1e9:
                self._last_asked_ns = now_ns
                self._pump.write(self._config.hub_port, HelloRequest().encode())
            elif self.hello is not None and not silent:
                self._ping(now_ns)
        except DeviceError:
            self._lose()

    def _ping(self, now_ns: int) -> None:
        nonce = self._next_nonce
        self._next_nonce = (nonce + 1) & 0xFFFF_FFFF
        frame = TimeRequest(nonce, self._capture.utc_ns(now_ns)).encode()
        stamp = self._pump.write(self._config.hub_port, frame)
        if len(self._pings) >= PINGS_HELD:
            del self._pings[next(iter(self._pings))]
        self._pings[nonce] = (stamp.before_ns, stamp.before_ns + self._wire_ns(len(frame)))

    def _take(self, chunk: Chunk) -> None:
        if not chunk.data:
            self._lose()
            return
        if len(self._first_bytes) < 64:
            self._first_bytes += chunk.data[:64]
        for event in self._parser.feed(chunk.data, chunk.received_ns):
            self._take_event(event)

    def _take_event(self, event: BoardEvent) -> None:
        if isinstance(event, FrameFault):
            return
        match event.frame:
            case Sample() as sample:
                self._take_samples([sample], event)
            case Batch() as batch:
                self._take_samples(batch.samples(self._period_ticks(batch)), event)
            case Slow() as slow:
                self._check_boot(slow.boot)
            case Hello() as hello:
                self._take_hello(hello, event.payload)
            case TimeReply() as reply:
                self._take_ping(reply, event)

    def _take_samples(self, samples: list[Sample], event: FrameEvent) -> None:
        self._count(samples)
        self._last_sample_ns = event.received_ns
        if self._silent:
            self._silent = False
            self._sinks.note(f"{self._where()} sends samples again")
        last = samples[-1]
        arrival_ns = event.received_ns
        mapped_ns = arrival_ns
        if last.device_time is not None:
            wire_ns = self._wire_ns(len(event.payload) + self._overhead())
            mapped_ns = self._clock.observe(last.device_time, arrival_ns, wire_ns, last.sequence)
            self._note_restarts()
        for sample in samples:
            taken_ns: int | None = mapped_ns
            if sample is not last and sample.device_time is not None:
                taken_ns = self._clock.map_ns(sample.device_time)
            if taken_ns is None or taken_ns == arrival_ns:
                self.counts.unmapped += 1
                taken_ns = arrival_ns
            self._emit(sample, arrival_ns, taken_ns)

    def _emit(self, sample: Sample, arrival_ns: int, taken_ns: int) -> None:
        status = sample.flags & 0xFF
        if sample.accel is not None:
            status |= _ACCEL_VALID
        if sample.temperature is not None:
            status |= _TEMPERATURE_VALID
        message = ImuRaw(
            host_time_ns=self._capture.utc_ns(arrival_ns),
            device_time=sample.device_time or 0,
            sequence=sample.sequence,
            status=status,
            temperature=sample.temperature or 0,
            gyro=sample.gyro,
            accel=sample.accel or (0, 0, 0),
        )
        self._sinks.sample(self.board_id, message, self._capture.utc_ns(taken_ns))

    def _count(self, samples: list[Sample]) -> None:
        self.counts.samples += len(samples)
        first = samples[0].sequence
        if self._last_sequence is not None:
            step = (first - self._last_sequence) % (1 << SEQUENCE_BITS)
            if step == 0:
                self.counts.duplicated += 1
            elif step >= 1 << (SEQUENCE_BITS - 1):
                self.counts.reordered += 1
                return  # the one that was counted as missing has come
            else:
                self.counts.missing += step - 1
        self._last_sequence = samples[-1].sequence

    def _take_hello(self, hello: Hello, payload: bytes) -> None:
        if payload not in self.hello_bytes and len(self.hello_bytes) < 16:
            self.hello_bytes.append(payload)
        if self.hello is None:
            self.hello = hello
            self._clock = self._new_clock()
        elif hello.config != self.hello.config:
            self._sinks.fault(f"board {self.board_id} has changed its configuration")
            self.hello = hello
        self._check_boot(hello.boot)

    def _check_boot(self, boot: int) -> None:
        if self._boot is not None and boot != self._boot:
            self._clock.restart()
            self._last_sequence = None
            self._pings.clear()
        self._boot = boot

    def _note_restarts(self) -> None:
        restarts = self._clock.restarts
        if restarts > self.counts.restarts:
            self.counts.restarts = restarts
            self._last_sequence = None
            self._sinks.fault(f"board {self.board_id} has restarted its clock")

    def _take_ping(self, reply: TimeReply, event: FrameEvent) -> None:
        sent = self._pings.pop(reply.nonce, None)
        if sent is None:
            return
        before_ns, there_ns = sent
        self.counts.pings += 1
        back_ns = event.received_ns - self._wire_ns(len(event.payload) + FRAME_OVERHEAD_BYTES)
        self._clock.two_way(there_ns, reply.device_receive, reply.device_send, back_ns)
        self._sinks.ping(
            self.board_id,
            ClockPing(
                host_send_ns=self._capture.utc_ns(before_ns),
                host_receive_ns=self._capture.utc_ns(event.received_ns),
                device_receive=reply.device_receive,
                device_send=reply.device_send,
                nonce=reply.nonce,
                status=0,
            ),
        )

    def _lose(self) -> None:
        if not self.gone:
            self.gone = True
            self.counts.hung_up += 1
            self._sinks.fault(f"{self._where()} hung up")

    def _is_known(self) -> bool:
        spoken = self.hello is not None or not self._speaks
        return self.gone or (spoken and self.counts.samples > 0)

    def _new_clock(self) -> OnlineClock:
        facts, columns = self._config.facts, self._config.columns
        tick_hz = facts.tick_hz or (columns and columns.tick_hz) or DEFAULT_TICK_HZ
        if self.hello is not None:
            tick_hz = self.hello.tick_hz
        bits = 32 if self._speaks else facts.counter_bits or 64
        return OnlineClock(tick_hz, bits, SEQUENCE_BITS if self._speaks else 32)

    def _period_ticks(self, batch: Batch) -> float:
        """Return the ticks between two samples of a batch.

        As they passed since the last batch, because a nominal rate is no clock; the
        nominal one where no batch came before, or what passed cannot be a period.
        """
        hello = self.hello
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

    def _overhead(self) -> int:
        return FRAME_OVERHEAD_BYTES if self._speaks else 0

    def _wire_ns(self, byte_count: int) -> int:
        return byte_count * BITS_PER_BYTE * 1_000_000_000 // self._config.baud

    def _where(self) -> str:
        return f"board {self.board_id} on {self._config.port}"
