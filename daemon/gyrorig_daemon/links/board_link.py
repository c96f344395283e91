"""One board on its port: who it is, what it is asked, and when it falls silent.

The parser and the samples know nothing of ports; this ties them to one. A board that
speaks GCB1 is asked who it is after opening and after silence, and for its clock about
five times a second at random moments: a regular question would beat against the frames
of USB (reference: timesync.md section 3.3).
"""

import random

from gyrorig_daemon.clocks import ClockReport
from gyrorig_daemon.config import BoardPort
from gyrorig_daemon.links.board_facts import board_metadata, make_parser
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
    TimeRequest,
)
from gyrorig_protocol.errors import DeviceError
from gyrorig_protocol.recording.messages import ClockPing

PING_MEAN_S = 0.2
SILENCE_S = 2.0
HELLO_PATIENCE_S = 5.0
HELLO_EVERY_S = 1.0
PINGS_HELD = 32


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
        self._pump = pump
        self._config = config
        self._capture = clock
        self._sinks = sinks
        self._rng = rng
        self.board_id = config.board_id
        self.hello: Hello | None = None
        self.hello_bytes: list[bytes] = []  # payloads as received, for the recording
        self._samples = SampleStream(config, clock, sinks)
        self.counts = self._samples.counts
        self.gone = False
        self._speaks = config.format == "gcb1"
        self._parser = make_parser(config)
        self._boot: int | None = None
        self._last_sample_ns = pump.now_ns()
        self._last_asked_ns = pump.now_ns()
        self._silent = False
        self._is_deaf = False  # its port takes no bytes
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
        return self._samples.clock.report()

    def faults(self) -> dict[str, int]:
        """Return the parser's counters by cause."""
        return {cause.name.lower(): count for cause, count in self._parser.faults.items()}

    def map_ns(self, device_time: int) -> int | None:
        """Return the raw monotonic time of a device stamp, None without a map."""
        return self._samples.clock.map_ns(device_time)

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
        if not self._speaks or self._is_deaf:
            return
        try:
            if silent and now_ns - self._last_asked_ns > HELLO_EVERY_S * 1e9:
                self._last_asked_ns = now_ns
                self._pump.write(self._config.hub_port, HelloRequest().encode())
            elif self.hello is not None and not silent:
                self._ping(now_ns)
        except DeviceError as fault:
            # Its samples may go on; if it hung up, the port says so itself. Each further
            # question would hold up everything else until its deadline.
            self._is_deaf = True
            self._sinks.fault(f"{fault.what}; it is asked no more")

    def _ping(self, now_ns: int) -> None:
        nonce = self._next_nonce
        self._next_nonce = (nonce + 1) & 0xFFFF_FFFF
        frame = TimeRequest(nonce, self._capture.utc_ns(now_ns)).encode()
        stamp = self._pump.write(self._config.hub_port, frame)
        if len(self._pings) >= PINGS_HELD:
            del self._pings[next(iter(self._pings))]
        self._pings[nonce] = (stamp.before_ns, stamp.before_ns + self._samples.wire_ns(len(frame)))

    def _take(self, chunk: Chunk) -> None:
        if chunk.change is PortChange.GONE:
            self._lose()
        if not chunk.data:
            return
        if len(self._first_bytes) < 64:
            self._first_bytes += chunk.data[:64]
        for event in self._parser.feed(chunk.data, chunk.received_ns):
            self._take_event(event)

    def _take_event(self, event: BoardEvent) -> None:
        if isinstance(event, FrameFault):
            return
        match event.frame:
            case Sample() | Batch() as frame:
                self._samples.take(frame, event)
                self._last_sample_ns = event.received_ns
                if self._silent:
                    self._silent = False
                    self._sinks.note(f"{self._where()} sends samples again")
            case Slow() as slow:
                self._check_boot(slow.boot)
            case Hello() as hello:
                self._take_hello(hello, event.payload)
            case TimeReply() as reply:
                self._take_ping(reply, event)

    def _take_hello(self, hello: Hello, payload: bytes) -> None:
        if payload not in self.hello_bytes and len(self.hello_bytes) < 16:
            self.hello_bytes.append(payload)
        known = self.hello
        if known is not None and hello.config != known.config:
            self._sinks.fault(f"board {self.board_id} has changed its configuration")
        if known is None or hello.config != known.config:
            self.hello = hello
            self._samples.use_hello(hello)
        self._check_boot(hello.boot)

    def _check_boot(self, boot: int) -> None:
        if self._boot is not None and boot != self._boot:
            self._samples.restart()
            self._pings.clear()
        self._boot = boot

    def _take_ping(self, reply: TimeReply, event: FrameEvent) -> None:
        sent = self._pings.pop(reply.nonce, None)
        if sent is None:
            return
        before_ns, there_ns = sent
        self.counts.pings += 1
        back_ns = event.received_ns - self._samples.wire_ns(
            len(event.payload) + FRAME_OVERHEAD_BYTES
        )
        self._samples.clock.two_way(there_ns, reply.device_receive, reply.device_send, back_ns)
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

    def _where(self) -> str:
        return f"board {self.board_id} on {self._config.port}"
