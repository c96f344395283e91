"""One board on its port: who it is, what it is asked, and when it falls silent.

The parser and the samples know nothing of ports; this ties them to one. A board that
speaks GCB1 is asked who it is after opening and after silence, and for its clock about
five times a second at random moments: a regular question would beat against the frames
of USB (reference: timesync.md section 3.3). A port that goes away and comes back is
a new beginning: the board is asked who it is before a sample is taken, and its clock is
mapped anew. How present it is, `Presence` knows.
"""

import random
from dataclasses import fields

from gyrorig_daemon.clocks import ClockReport
from gyrorig_daemon.config import BoardPort
from gyrorig_daemon.links.board_facts import board_metadata, make_parser
from gyrorig_daemon.links.board_pings import PingBook
from gyrorig_daemon.links.board_presence import SILENCE_S, LinkState, Presence
from gyrorig_daemon.links.board_samples import (
    FRAME_OVERHEAD_BYTES,
    BoardSinks,
    SampleStream,
)
from gyrorig_daemon.links.capture_clock import CaptureClock
from gyrorig_daemon.links.hub import Chunk, PortChange
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
)
from gyrorig_protocol.errors import DeviceError

PING_MEAN_S = 0.2
HELLO_PATIENCE_S = 5.0
HELLO_EVERY_S = 1.0
DEAF_S = 60.0  # a port that took no bytes is left alone so long: each try holds up all others
FIRST_BYTES = 64
_SLOW_COUNTERS = ("sensor_overruns", "frames_dropped", "bus_errors", "saturations")


class BoardLink:
    """The daemon's end of one board's line; also the timer of its questions.

    `counts` are the samples', and this line's silences and hang-ups.
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
        self.slow: Slow | None = None  # what it last said of its own losses
        self._samples = SampleStream(config, clock, sinks)
        self.counts = self._samples.counts
        self._presence = Presence(pump.is_up(config.hub_port), now_ns)
        self._speaks = config.format == "gcb1"
        self._parser = make_parser(config)
        self._is_confirmed = not self._speaks  # it said who it is since the port was opened
        self._pinned_uid: str | None = config.facts.uid if self._speaks else None
        self._boot: int | None = None
        self._epochs_at_boot = 0
        self._was_away = False
        self._last_asked_ns = now_ns
        self._deaf_until_ns = 0
        self._is_reopening = False
        self._foreign_uid = ""
        self._pings = PingBook(clock, rng.getrandbits(32))
        self._first_bytes = b""
        self.due_ns = now_ns
        pump.attach(config.hub_port, self._take)
        pump.add_timer(self)

    @property
    def state(self) -> LinkState:
        """How present the board is."""
        return self._presence.state

    @property
    def known(self) -> bool:
        """True when the board has said who it is since its port was opened, and sends."""
        return self.state is LinkState.KNOWN

    @property
    def gone(self) -> bool:
        """True while its port is not there."""
        return self.state is LinkState.ABSENT

    def identify(self) -> None:
        """Wait until the board has said who it is and sent a sample.

        Raises:
            DeviceError: it is silent, or what comes is not what a board sends.
        """
        end_ns = self._pump.now_ns() + int(HELLO_PATIENCE_S * 1e9)
        while self._pump.now_ns() < end_ns and not self._is_settled():
            if self._speaks and not self.gone:
                self._ask_who(self._pump.now_ns())
            next_ns = self._pump.now_ns() + int(HELLO_EVERY_S * 1e9)
            self._pump.run_until(min(next_ns, end_ns), self._is_settled)
        if self.gone:
            raise DeviceError(f"{self._where()} hung up", "check its cable and its power")
        if self.state is LinkState.FOREIGN:
            raise DeviceError(self._foreign(), "check the ports in the rig's configuration")
        if not self.known:
            raise DeviceError(
                f"{self._where()} {self._complaint()}",
                "check its power, the cable, the port, the baud rate and the format",
            )
        self.metadata()  # raises where the board and the configuration leave too much open
        self.pin()

    def metadata(self) -> dict[str, str]:
        """Return the recording's `gyrorig.board.<id>` record."""
        return board_metadata(self._config, self.hello)

    def pin(self) -> None:
        """From here on take samples of this very board only: a recording is about it."""
        if self.hello is not None and self.hello.uid:
            self._pinned_uid = self.hello.uid

    def unpin(self) -> None:
        """Another board may take its place; the next recording asks who it is."""
        self._pinned_uid = self._config.facts.uid if self._speaks else None
        if self.state is LinkState.FOREIGN:
            self._begin_anew(self._pump.now_ns())

    def clock_report(self) -> ClockReport:
        """Return the state of the board's clock map."""
        return self._samples.clock.report()

    def latencies_ns(self) -> tuple[int, int] | None:
        """Return how late samples come: the last, and the worst since this was asked.

        None where the board's clock is not mapped: arrivals stand in for it then.
        """
        samples = self._samples
        worst_ns, samples.worst_latency_ns = samples.worst_latency_ns, 0
        return (samples.latency_ns, worst_ns) if samples.clock.report().mapped else None

    def faults(self) -> dict[str, int]:
        """Return the parser's counters by cause."""
        return {cause.name.lower(): count for cause, count in self._parser.faults.items()}

    def values(self) -> dict[str, str]:
        """Return every counter, the board's own too, by name: for /diagnostics and status."""
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
        """Return the raw monotonic time of a device stamp, None without a map."""
        return self._samples.clock.map_ns(device_time)

    def fire(self, now_ns: int) -> None:
        """Ask for the clock; after a silence, ask who is there."""
        self.due_ns = now_ns + int(self._rng.uniform(0.25, 1.75) * PING_MEAN_S * 1e9)
        if self.gone:
            return
        # what waits to be handed out is no silence: judged by how far that has come
        seen_ns = min(now_ns, self._pump.served_ns)
        if self._presence.falls_silent(seen_ns):
            self.counts.silences += 1
            self._sinks.fault(f"{self._where()} has sent no sample for {SILENCE_S:g} s")
        if self._presence.wants_reopening(seen_ns):
            self._reopen()
            return
        if not self._speaks or now_ns < self._deaf_until_ns:
            return
        try:
            if self.known:
                self._ping(now_ns)
            elif now_ns - self._last_asked_ns > HELLO_EVERY_S * 1e9:
                self._ask_who(now_ns)
        except DeviceError as fault:
            # Its samples may go on; if it hung up, the port says so itself. Each further
            # question would hold up everything else until its deadline.
            self._deaf_until_ns = now_ns + int(DEAF_S * 1e9)
            self._sinks.fault(f"{fault.what}; it is asked no more")

    def _ask_who(self, now_ns: int) -> None:
        self._last_asked_ns = now_ns
        self._pump.write(self._config.hub_port, HelloRequest().encode())

    def _ping(self, now_ns: int) -> None:
        frame = self._pings.question(now_ns)
        stamp = self._pump.write(self._config.hub_port, frame)
        self._pings.sent(stamp, self._samples.wire_ns(len(frame)))

    def _take(self, chunk: Chunk) -> None:
        if chunk.change is PortChange.GONE:
            self._lose(chunk.text)
        elif chunk.change is PortChange.BACK:
            self._is_reopening = False
            self._begin_anew(chunk.received_ns)
        if self.gone:
            return
        self.counts.late_chunks += chunk.late_ns > 0
        if len(self._first_bytes) < FIRST_BYTES:
            self._first_bytes += chunk.data[:FIRST_BYTES]
        for event in self._parser.feed(chunk.data, chunk.received_ns):
            self._take_event(event)

    def _take_event(self, event: BoardEvent) -> None:
        if isinstance(event, FrameFault):
            return
        if isinstance(event.frame, Sample):  # nearly always
            self._take_samples(event.frame, event)
            return
        match event.frame:
            case Batch() as frame:
                self._take_samples(frame, event)
            case Slow() as slow:
                self._take_slow(slow, event)
            case Hello() as hello:
                self._take_hello(hello, event.payload)
            case TimeReply() as reply:
                self._take_ping(reply, event)

    def _take_samples(self, frame: Sample | Batch, event: FrameEvent) -> None:
        self._samples.seen = True
        if not self._is_confirmed:  # not known yet whose, nor when a batch's were taken
            self.counts.unidentified += 1 if isinstance(frame, Sample) else len(frame.gyro)
            return
        before, state = self._presence.heard_ns, self.state
        self._presence.hear(event.received_ns)
        if self.counts.samples and state is not LinkState.KNOWN:
            gap_s = (event.received_ns - before) * 1e-9
            self._sinks.note(f"{self._where()} sends samples again, after {gap_s:.3f} s without")
        self._samples.take(frame, event)

    def _take_slow(self, slow: Slow, event: FrameEvent) -> None:
        if not self._is_confirmed:
            return
        self.slow = slow
        self._check_boot(slow.boot)
        wire_ns = self._samples.wire_ns(len(event.payload) + FRAME_OVERHEAD_BYTES)
        self._samples.clock.one_way(slow.device_time, event.received_ns - wire_ns)

    def _take_hello(self, hello: Hello, payload: bytes) -> None:
        if self._pinned_uid is not None and hello.uid != self._pinned_uid:
            self._refuse(hello)
            return
        if self.hello is not None and hello.uid != self.hello.uid:
            self.hello_bytes.clear()
            self._boot = None
            self._samples.map_anew()
        if payload not in self.hello_bytes and len(self.hello_bytes) < 16:
            self.hello_bytes.append(payload)
        known = self.hello
        if known is not None and hello.uid == known.uid and hello.config != known.config:
            self._sinks.fault(f"board {self.board_id} has changed its configuration")
        if known is None or (hello.uid, hello.config) != (known.uid, known.config):
            self.hello = hello
            self._samples.use_hello(hello)
        self._is_confirmed = True
        self._check_boot(hello.boot)

    def _refuse(self, hello: Hello) -> None:
        """Take nothing from a board that another recording would be about."""
        if self.state is LinkState.FOREIGN:
            return
        self.counts.foreign += 1
        self._is_confirmed = False
        self._foreign_uid = hello.uid
        self._presence.find_foreign()
        self._sinks.fault(f"{self._foreign()}; its samples are not taken")

    def _check_boot(self, boot: int) -> None:
        """Begin a new epoch where the board has started anew, unless its clock told already."""
        samples = self._samples
        if self._boot is not None and boot != self._boot:
            if self._was_away:
                samples.note_start()
            elif samples.epochs == self._epochs_at_boot:
                samples.restart()
                self._pings.clear()
        self._boot, self._epochs_at_boot, self._was_away = boot, samples.epochs, False

    def _take_ping(self, reply: TimeReply, event: FrameEvent) -> None:
        wire_ns = self._samples.wire_ns(len(event.payload) + FRAME_OVERHEAD_BYTES)
        answered = self._pings.answer(reply, event.received_ns)
        if answered is None:
            return
        there_ns, message = answered
        self.counts.pings += 1
        self._samples.clock.two_way(
            there_ns, reply.device_receive, reply.device_send, event.received_ns - wire_ns
        )
        self._sinks.ping(self.board_id, message)

    def _reopen(self) -> None:
        self.counts.reopened += 1
        self._is_reopening = True
        if self._presence.just_degraded:
            self._sinks.fault(
                f"{self._where()} {self._complaint()}, though its port was opened anew "
                f"{self._presence.reopened - 1} times: look at it"
            )
        self._first_bytes = b""
        self._pump.reopen(self._config.hub_port)

    def _complaint(self) -> str:
        if not self._first_bytes:
            return "is silent"
        if not self._is_confirmed and self._samples.seen:
            return "does not say who it is"
        return f"sends no {self._config.format} samples but {self._first_bytes[:24]!r}"

    def _lose(self, why: str) -> None:
        if self._is_reopening:  # once: if it cannot be opened, that is said next
            self._is_reopening = False
            return
        if self.gone:
            return
        self._presence.lose()
        self.counts.hung_up += 1
        self._sinks.fault(f"{self._where()} is gone: {why}")

    def _begin_anew(self, now_ns: int) -> None:
        """The port is open again: nothing that was known of the board holds any more."""
        self._presence.come_back(now_ns)
        self._parser.reset()
        self._samples.map_anew()
        self._samples.seen = False
        self._pings.clear()
        self._was_away = True
        self._is_confirmed = not self._speaks
        self._deaf_until_ns = 0
        self._last_asked_ns = now_ns - int(HELLO_EVERY_S * 1e9) - 1  # at once
        self.due_ns = now_ns
        self._pump.hurry()

    def _is_settled(self) -> bool:
        return self.gone or self.known or self.state is LinkState.FOREIGN

    def _foreign(self) -> str:
        return (
            f"{self._where()} is another board: it says {self._foreign_uid!r} "
            f"instead of {self._pinned_uid!r}"
        )

    def _where(self) -> str:
        return f"board {self.board_id} on {self._config.port}"
