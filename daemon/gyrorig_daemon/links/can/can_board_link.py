"""The link to one board on a CAN bus; the bus passes its frames and edges on.

It differs from a board on a serial port in two ways. The bus owns the port: a silent board is
queried again, but the bus is not reopened for it. No board is queried for its time, because the
edges of the bus time all boards at once.
"""

import random
from collections.abc import Mapping

import msgspec

from gyrorig_daemon.clocks.capture_clock import CaptureClock
from gyrorig_daemon.config import BoardPort
from gyrorig_daemon.links.boards.board_link import BoardLink
from gyrorig_daemon.links.boards.sample_stream import BoardSinks
from gyrorig_daemon.links.pump import Pump
from gyrorig_protocol.board import Hello
from gyrorig_protocol.board_protocols import find_can_protocol
from gyrorig_protocol.can import CanBoardParser, CanFrame, LatchEvent, pack_frames
from gyrorig_protocol.recording.clock_messages import ClockPing

_MAX_CODE = (1 << 15) - 1


class CanBoardLink(BoardLink):
    """The daemon's end of one board on a bus."""

    def __init__(
        self,
        pump: Pump,
        config: BoardPort,
        clock: CaptureClock,
        sinks: BoardSinks,
        rng: random.Random,
    ) -> None:
        """Attach to no port; the bus passes on the board's frames."""
        self._can = find_can_protocol(config.format)
        self._can_parser = self._can.make_parser(config)
        location = f"bus {config.bus}"
        if config.node is not None:
            location = f"node {config.node} of {location}"
        super().__init__(pump, msgspec.structs.replace(config, port=location), clock, sinks, rng)
        self.bus_counts: Mapping[str, int] = {}  # of the bus, by cause

    def owns_key(self, key: int) -> bool:
        """Return whether frames with this key belong to the board."""
        return self._can_parser.wants(key)

    def handle_frame(self, frame: CanFrame) -> LatchEvent | None:
        """Handle one of the board's frames; return its clock value at an edge, if it has one."""
        if len(self._first_bytes) < 64:
            self._first_bytes += frame.data
        latch: LatchEvent | None = None
        for event in self._can_parser.feed(frame):
            if isinstance(event, LatchEvent):
                latch = event
            else:
                self._handle_event(event)
        return latch

    def handle_sync_edge(self, latch: LatchEvent, counter: int, sent_ns: int, echo_ns: int) -> None:
        """Use the board's clock value at an edge.

        Args:
            latch: the board's message.
            counter: number of the edge, as the host counts.
            sent_ns: the edge was not before.
            echo_ns: the edge was not after.
        """
        boot = self._boot_count
        if not self.is_known or (boot is not None and boot & 0xFF != latch.boot):
            return
        self.counts.pings += 1
        self._samples.clock.observe_edge(latch.clock_ticks, sent_ns, echo_ns)
        self._sinks.ping(
            self.board_id,
            ClockPing(
                host_send_ns=self._capture.utc_ns(sent_ns),
                host_receive_ns=self._capture.utc_ns(echo_ns),
                device_receive=latch.clock_ticks,
                device_send=latch.clock_ticks,
                nonce=counter & 0xFFFF_FFFF,
                status=0,
            ),
        )

    def disconnect_bus(self, reason: str) -> None:
        """The bus is gone."""
        self._disconnect(reason)

    def reset_connection(self, now_ns: int) -> None:
        """The bus is back: forget what was known about the board."""
        self._can_parser.reset()
        self._reset_connection(now_ns)

    def faults(self) -> dict[str, int]:
        """Return the parser's counters by cause."""
        return {cause.name.lower(): count for cause, count in self._can_parser.faults.items()}

    def values(self) -> dict[str, str]:
        """Return every counter, including those of the bus, by name."""
        bus_values = {f"bus_{name}": str(count) for name, count in self.bus_counts.items()}
        return super().values() | bus_values

    def _handle_hello(self, hello: Hello, payload: bytes) -> None:
        super()._handle_hello(hello, payload)
        gyro = next((s for s in hello.sensors if s.unit in ("dps", "rad/s")), None)
        if gyro is not None and isinstance(self._can_parser, CanBoardParser):
            codes = round(gyro.full_scale / gyro.per_count)
            self._can_parser.full_scale_counts = min(codes, _MAX_CODE)

    def _request_hello(self, now_ns: int) -> None:
        self._last_hello_request_ns = now_ns
        request = self._can.hello_request(self._config)
        if request is not None:
            self._pump.write(self._config.hub_port, pack_frames([request]))

    def _request_time(self, now_ns: int) -> None:
        """Do nothing: the bus sends edges to all boards at once."""

    def _reopen(self) -> None:
        if self._presence.is_newly_degraded:
            self._sinks.fault(f"{self._location()} {self._silence_description()}. Check the board")
        self._is_identified = (
            not self._identifies_itself
        )  # it may have been replaced: identify it again
