"""The link to one board: its identity, its clock, and whether it still sends samples.

Parser and samples know nothing of ports; this module connects them to one. A board whose
protocol has requests is asked for a HELLO after its port was opened and after silence, and for
its time about five times per second at random moments. Regular requests would beat with the 1 ms
frames of USB, which biases the clock map (docs/clocks.md). After a port was closed and opened,
the board must identify itself before a sample is used, and its clock is mapped again.
`BoardPresence` has the state of the link.
"""

import random
from dataclasses import fields

from gyrorig_daemon.clocks import ClockReport
from gyrorig_daemon.clocks.capture_clock import CaptureClock
from gyrorig_daemon.config import BoardPort
from gyrorig_daemon.links.boards.board_metadata import board_metadata
from gyrorig_daemon.links.boards.board_presence import SILENCE_S, BoardPresence, LinkState
from gyrorig_daemon.links.boards.pending_pings import PendingPings
from gyrorig_daemon.links.boards.sample_stream import BoardSinks, SampleStream
from gyrorig_daemon.links.fault_limiter import FaultLimiter
from gyrorig_daemon.links.ports.port_hub import Chunk, PortChange
from gyrorig_daemon.links.pump import Pump
from gyrorig_protocol.board import (
    Batch,
    BoardEvent,
    FrameEvent,
    FrameFault,
    Hello,
    Sample,
    Slow,
    TimeReply,
)
from gyrorig_protocol.board_protocols import SerialProtocol, find_protocol
from gyrorig_protocol.errors import DeviceError

MEAN_PING_INTERVAL_S = 0.2
HELLO_TIMEOUT_S = 5.0
HELLO_INTERVAL_S = 1.0
WRITE_RETRY_S = 60.0  # pause after a port took no bytes, because each attempt delays all others
FIRST_BYTES_LIMIT = 64
_SLOW_COUNTERS = ("sensor_overruns", "frames_dropped", "bus_errors", "saturations")


class BoardLink:
    """The daemon's end of one board's line; also the timer of its requests.

    `counts` are those of the samples, and the silences and disconnections of this line.
    """

    def __init__(
        self,
        pump: Pump,
        config: BoardPort,
        clock: CaptureClock,
        sinks: BoardSinks,
        rng: random.Random,
    ) -> None:
        """Attach to the board's port, whether it is open or not."""
        now_ns = pump.now_ns()
        self._pump = pump
        self._config = config
        self._capture = clock
        self._sinks = sinks
        self._rng = rng
        self.board_id = config.board_id
        self.hello: Hello | None = None
        self.hello_bytes: list[bytes] = []  # payloads as received, for the recording
        self.slow: Slow | None = None  # last report of the losses that the board counted
        self._samples = SampleStream(config, clock, sinks)
        self._notes = FaultLimiter(sinks.note)
        self.counts = self._samples.counts
        self._presence = BoardPresence(pump.is_up(config.hub_port), now_ns)
        protocol = find_protocol(config.format, bool(config.bus))
        self._serial = protocol if isinstance(protocol, SerialProtocol) else None
        self._parser = None if self._serial is None else self._serial.make_parser(config)
        self._identifies_itself = protocol.identifies_itself
        self._is_identified = not protocol.identifies_itself  # since the port was opened
        self._pinned_uid: str | None = config.facts.uid if protocol.identifies_itself else None
        self._boot_count: int | None = None
        self._epoch_count_at_boot = 0
        self._was_disconnected = False
        self._last_hello_request_ns = now_ns
        self._write_retry_ns = 0
        self._is_reopening = False
        self._foreign_uid = ""
        self._pings = PendingPings(clock, rng.getrandbits(32))
        self._first_bytes = b""
        self.due_ns = now_ns
        pump.attach(config.hub_port, self._handle_chunk)
        pump.add_timer(self)

    @property
    def state(self) -> LinkState:
        """State of the link."""
        return self._presence.state

    @property
    def is_known(self) -> bool:
        """True if the board has identified itself since its port was opened, and sends samples."""
        return self.state is LinkState.KNOWN

    @property
    def is_absent(self) -> bool:
        """True while its port does not exist."""
        return self.state is LinkState.ABSENT

    def identify(self) -> None:
        """Wait until the board has identified itself and sent a sample.

        Raises:
            DeviceError: it is silent, or what it sends is not its format.
        """
        end_ns = self._pump.now_ns() + int(HELLO_TIMEOUT_S * 1e9)
        while self._pump.now_ns() < end_ns and not self._is_identification_over():
            if self._identifies_itself and not self.is_absent:
                self._request_hello(self._pump.now_ns())
            next_ns = self._pump.now_ns() + int(HELLO_INTERVAL_S * 1e9)
            self._pump.run_until(min(next_ns, end_ns), self._is_identification_over)
        if self.is_absent:
            raise DeviceError(
                f"{self._location()} was unplugged", "check the cable and the power of the board"
            )
        if self.state is LinkState.FOREIGN:
            raise DeviceError(self._foreign_description(), "check the ports in the rig file")
        if not self.is_known:
            raise DeviceError(
                f"{self._location()} {self._silence_description()}",
                "check the power and the cable of the board, and its port, baud rate and "
                "format in the rig file",
            )
        self.metadata()  # raises if a required value is unknown
        self.pin_identity()

    def metadata(self) -> dict[str, str]:
        """Return the record `gyrorig.board.<id>` of a recording."""
        return board_metadata(self._config, self.hello)

    def pin_identity(self) -> None:
        """Accept samples of this very board only from now on: a recording is about one board."""
        if self.hello is not None and self.hello.uid:
            self._pinned_uid = self.hello.uid

    def unpin_identity(self) -> None:
        """Accept another board in its place; the next recording identifies it."""
        self._pinned_uid = self._config.facts.uid if self._identifies_itself else None
        if self.state is LinkState.FOREIGN:
            self._reset_connection(self._pump.now_ns())

    def clock_report(self) -> ClockReport:
        """Return the state of the clock map."""
        return self._samples.clock.report()

    def latencies_ns(self) -> tuple[int, int] | None:
        """Return the latency of the last sample, and the largest since the last call.

        None while the board's clock is not mapped: arrival times are used then.
        """
        samples = self._samples
        worst_ns, samples.worst_latency_ns = samples.worst_latency_ns, 0
        return (samples.latency_ns, worst_ns) if samples.clock.report().mapped else None

    def faults(self) -> dict[str, int]:
        """Return the parser's counters by cause."""
        faults = {} if self._parser is None else self._parser.faults
        return {cause.name.lower(): count for cause, count in faults.items()}

    def values(self) -> dict[str, str]:
        """Return every counter, also those of the board, by name for /diagnostics and status."""
        values = {
            field.name: str(getattr(self.counts, field.name)) for field in fields(self.counts)
        }
        values |= {f"fault_{cause}": str(count) for cause, count in self.faults().items()}
        values["state"] = self.state.name.lower()
        slow = self.slow
        if slow is not None:
            values |= {f"board_{name}": str(getattr(slow, name)) for name in _SLOW_COUNTERS}
            if slow.supply_mv is not None:
                values["board_supply_mv"] = str(slow.supply_mv)
        return values

    def map_ns(self, device_time: int) -> int | None:
        """Return the raw monotonic time of a device timestamp, None without a map."""
        return self._samples.clock.map_ns(device_time)

    def fire(self, now_ns: int) -> None:
        """Request the time; after a silence, request a HELLO."""
        self.due_ns = now_ns + int(self._rng.uniform(0.25, 1.75) * MEAN_PING_INTERVAL_S * 1e9)
        if self.is_absent:
            return
        # buffered chunks are not silence: measure from the last processed time
        processed_until_ns = min(now_ns, self._pump.processed_until_ns)
        if self._presence.detect_silence(processed_until_ns):
            self.counts.silences += 1
            self._sinks.fault(f"{self._location()} has sent no sample for {SILENCE_S:g} s")
        if self._presence.is_reopening_due(processed_until_ns):
            self._reopen()
            return
        if not self._identifies_itself or now_ns < self._write_retry_ns:
            return
        try:
            if self.is_known:
                self._request_time(now_ns)
            elif now_ns - self._last_hello_request_ns > HELLO_INTERVAL_S * 1e9:
                self._request_hello(now_ns)
        except DeviceError as fault:
            # Samples may still arrive; if it was unplugged, the hub reports it. Each further
            # request would delay everything else until its deadline.
            self._write_retry_ns = now_ns + int(WRITE_RETRY_S * 1e9)
            self._sinks.fault(f"{fault.problem}. No requests are sent for {WRITE_RETRY_S:g} s")

    def _request_hello(self, now_ns: int) -> None:
        self._last_hello_request_ns = now_ns
        if self._serial is not None:
            self._pump.write(self._config.hub_port, self._serial.hello_request())

    def _request_time(self, now_ns: int) -> None:
        if self._serial is None or not self._serial.answers_time_requests:
            return
        frame = self._serial.time_request(*self._pings.next_request(now_ns))
        write_times = self._pump.write(self._config.hub_port, frame)
        self._pings.record_sent(write_times, self._samples.wire_ns(len(frame)))

    def _handle_chunk(self, chunk: Chunk) -> None:
        if chunk.change is PortChange.GONE:
            self._disconnect(chunk.text)
        elif chunk.change is PortChange.BACK:
            self._is_reopening = False
            self._reset_connection(chunk.received_ns)
        if self.is_absent:
            return
        self.counts.late_chunks += chunk.late_ns > 0
        if len(self._first_bytes) < FIRST_BYTES_LIMIT:
            self._first_bytes += chunk.data[:FIRST_BYTES_LIMIT]
        if self._parser is not None:
            if chunk.is_after_loss:
                self._parser.reset()  # the bytes before the loss and after it are not one line
            for event in self._parser.feed(chunk.data, chunk.received_ns):
                self._handle_event(event)

    def _handle_event(self, event: BoardEvent) -> None:
        if isinstance(event, FrameFault):
            return
        if isinstance(event.frame, Sample):  # nearly always
            self._handle_samples(event.frame, event)
            return
        match event.frame:
            case Batch() as frame:
                self._handle_samples(frame, event)
            case Slow() as slow:
                self._handle_slow(slow, event)
            case Hello() as hello:
                self._handle_hello(hello, event.payload)
            case TimeReply() as reply:
                self._handle_time_reply(reply, event)

    def _handle_samples(self, frame: Sample | Batch, event: FrameEvent) -> None:
        self._samples.has_samples = True
        if not self._is_identified:  # board unknown, and the times in a batch, too
            self.counts.unidentified += 1 if isinstance(frame, Sample) else len(frame.gyro)
            return
        before, state = self._presence.last_sample_ns, self.state
        self._presence.mark_sample(event.received_ns)
        if self.counts.samples and state is not LinkState.KNOWN:
            gap_s = (event.received_ns - before) * 1e-9
            text = f"{self._location()} sends samples again, after {gap_s:.3f} s"
            if state is LinkState.FOREIGN:  # two boards on one port can alternate at every frame
                self._notes.report("again", event.received_ns, text)
            else:
                self._sinks.note(text)
        self._samples.handle_frame(frame, event)

    def _handle_slow(self, slow: Slow, event: FrameEvent) -> None:
        if not self._is_identified:
            return
        self.slow = slow
        self._check_boot_count(slow.boot)
        wire_ns = self._samples.frame_duration_ns(len(event.payload))
        self._samples.clock.observe_one_way(slow.device_time, event.received_ns - wire_ns)

    def _handle_hello(self, hello: Hello, payload: bytes) -> None:
        if self._pinned_uid is not None and hello.uid != self._pinned_uid:
            self._reject_foreign(hello)
            return
        if self.hello is not None and hello.uid != self.hello.uid:
            self.hello_bytes.clear()
            self._boot_count = None
            self._samples.remap()
        if payload not in self.hello_bytes and len(self.hello_bytes) < 16:
            self.hello_bytes.append(payload)
        previous = self.hello
        if previous is not None and hello.uid == previous.uid and hello.config != previous.config:
            text = f"board {self.board_id} has changed its configuration"
            self._samples.faults.report("configuration", self._pump.now_ns(), text)
        if previous is None or (hello.uid, hello.config) != (previous.uid, previous.config):
            self.hello = hello
            self._samples.apply_hello(hello)
        self._is_identified = True
        self._check_boot_count(hello.boot)

    def _reject_foreign(self, hello: Hello) -> None:
        """Ignore a board that is not the one of the recording."""
        if self.state is LinkState.FOREIGN:
            return
        self.counts.foreign += 1
        self._is_identified = False
        self._foreign_uid = hello.uid
        self._presence.mark_foreign()
        text = f"{self._foreign_description()}. Its samples are not recorded"
        self._samples.faults.report("foreign", self._pump.now_ns(), text)

    def _check_boot_count(self, boot: int) -> None:
        """Start a new clock epoch after a restart, unless the clock showed it already."""
        samples = self._samples
        if self._boot_count is not None and boot != self._boot_count:
            if self._was_disconnected:
                samples.count_restart_while_away()
            elif samples.epoch_count == self._epoch_count_at_boot:
                samples.restart()
                self._pings.clear()
        self._boot_count, self._epoch_count_at_boot, self._was_disconnected = (
            boot,
            samples.epoch_count,
            False,
        )

    def _handle_time_reply(self, reply: TimeReply, event: FrameEvent) -> None:
        wire_ns = self._samples.frame_duration_ns(len(event.payload))
        answer = self._pings.match_reply(reply, event.received_ns)
        if answer is None:
            return
        earliest_arrival_ns, message = answer
        self.counts.pings += 1
        self._samples.clock.observe_two_way(
            earliest_arrival_ns,
            reply.device_receive,
            reply.device_send,
            event.received_ns - wire_ns,
        )
        self._sinks.ping(self.board_id, message)

    def _reopen(self) -> None:
        self.counts.reopened += 1
        self._is_reopening = True
        if self._presence.is_newly_degraded:
            self._sinks.fault(
                f"{self._location()} {self._silence_description()}, although its port was "
                f"reopened {self._presence.reopen_count - 1} times. Check the board"
            )
        self._first_bytes = b""
        self._pump.reopen(self._config.hub_port)

    def _silence_description(self) -> str:
        if not self._first_bytes:
            return "is silent"
        if not self._is_identified and self._samples.has_samples:
            return "does not identify itself"
        return f"sends no {self._config.format} samples but {self._first_bytes[:24]!r}"

    def _disconnect(self, reason: str) -> None:
        if self._is_reopening:  # once; if it cannot be opened, that is reported next
            self._is_reopening = False
            return
        if self.is_absent:
            return
        self._presence.mark_absent()
        self.counts.hung_up += 1
        self._sinks.fault(f"{self._location()} is gone: {reason}")

    def _reset_connection(self, now_ns: int) -> None:
        """Forget what was known about the board, because its port was opened again."""
        self._presence.mark_reopened(now_ns)
        if self._parser is not None:
            self._parser.reset()
        self._samples.remap()
        self._samples.has_samples = False
        self._pings.clear()
        self._was_disconnected = True
        self._is_identified = not self._identifies_itself
        self._write_retry_ns = 0
        self._last_hello_request_ns = now_ns - int(HELLO_INTERVAL_S * 1e9) - 1  # at once
        self.due_ns = now_ns
        self._pump.check_timers_now()

    def _is_identification_over(self) -> bool:
        return self.is_absent or self.is_known or self.state is LinkState.FOREIGN

    def _foreign_description(self) -> str:
        return (
            f"{self._location()} is another board: its uid is {self._foreign_uid!r} "
            f"instead of {self._pinned_uid!r}"
        )

    def _location(self) -> str:
        return f"board {self.board_id} on {self._config.port}"
