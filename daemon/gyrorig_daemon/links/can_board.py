"""One board on a CAN bus: a `BoardLink` whose frames and edges its bus hands it.

What differs from a board on a port of its own: the bus owns the port, so a silent board is
asked again but the bus is not opened anew for it; and no board is asked for its clock,
because the bus's edges tell every board's at once.
"""

import random
from collections.abc import Mapping

import msgspec

from gyrorig_daemon.config import BoardPort
from gyrorig_daemon.links.board_link import BoardLink
from gyrorig_daemon.links.board_samples import BoardSinks
from gyrorig_daemon.links.capture_clock import CaptureClock
from gyrorig_daemon.links.pump import Pump
from gyrorig_protocol.board import Hello
from gyrorig_protocol.can import (
    BoardFrameParser,
    BoundMap,
    CanFrame,
    LatchEvent,
    SignalParser,
    bind,
    hello_request_frame,
    pack_frames,
)
from gyrorig_protocol.recording.messages import ClockPing

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
        """Attach to nothing: the bus hands over what is this board's."""
        self._can: BoardFrameParser | SignalParser
        if config.signals is None:
            self._can = BoardFrameParser(config.node or 0)
            place = f"node {config.node} of bus {config.bus}"
        else:
            bound = bind(config.signals, config.id)
            self._can = SignalParser(bound)
            config = _told(config, bound)
            place = f"bus {config.bus}"
        super().__init__(pump, msgspec.structs.replace(config, port=place), clock, sinks, rng)
        self.bus_counts: Mapping[str, int] = {}  # the bus's own, by cause

    def wants(self, key: int) -> bool:
        """Return whether frames of this key are this board's."""
        return self._can.wants(key)

    def take_frame(self, frame: CanFrame) -> LatchEvent | None:
        """Take one of this board's frames; return its clock at an edge if that is what it is."""
        if len(self._first_bytes) < 64:
            self._first_bytes += frame.data
        latch: LatchEvent | None = None
        for event in self._can.feed(frame):
            if isinstance(event, LatchEvent):
                latch = event
            else:
                self._take_event(event)
        return latch

    def take_edge(self, latch: LatchEvent, counter: int, sent_ns: int, echo_ns: int) -> None:
        """Take this board's clock at an edge.

        Args:
            latch: what the board said.
            counter: of the edge, as the host counts.
            sent_ns: the edge cannot have been before.
            echo_ns: nor after.
        """
        boot = self._boot
        if not self.known or (boot is not None and boot & 0xFF != latch.boot):
            return
        self.counts.pings += 1
        self._samples.clock.edge(latch.clock, sent_ns, echo_ns)
        self._sinks.ping(
            self.board_id,
            ClockPing(
                host_send_ns=self._capture.utc_ns(sent_ns),
                host_receive_ns=self._capture.utc_ns(echo_ns),
                device_receive=latch.clock,
                device_send=latch.clock,
                nonce=counter & 0xFFFF_FFFF,
                status=0,
            ),
        )

    def lose_bus(self, why: str) -> None:
        """The bus is gone."""
        self._lose(why)

    def begin_anew(self, now_ns: int) -> None:
        """The bus is back: nothing that was known of the board holds any more."""
        self._can.reset()
        self._begin_anew(now_ns)

    def faults(self) -> dict[str, int]:
        """Return the parser's counters by cause."""
        return {cause.name.lower(): count for cause, count in self._can.faults.items()}

    def values(self) -> dict[str, str]:
        """Return every counter, the bus's too, by name."""
        of_bus = {f"bus_{name}": str(count) for name, count in self.bus_counts.items()}
        return super().values() | of_bus

    def _take_hello(self, hello: Hello, payload: bytes) -> None:
        super()._take_hello(hello, payload)
        gyro = next((s for s in hello.sensors if s.unit in ("dps", "rad/s")), None)
        if gyro is not None and isinstance(self._can, BoardFrameParser):
            codes = round(gyro.full_scale / gyro.per_count)
            self._can.full_scale_counts = min(codes, _MAX_CODE)

    def _ask_who(self, now_ns: int) -> None:
        self._last_asked_ns = now_ns
        request = hello_request_frame(self._config.node or 0)
        self._pump.write(self._config.hub_port, pack_frames([request]))

    def _ping(self, now_ns: int) -> None:
        """The bus gives edges to all boards at once."""

    def _reopen(self) -> None:
        if self._presence.just_degraded:
            self._sinks.fault(f"{self._where()} {self._complaint()}: look at it")
        self._is_confirmed = not self._speaks  # it may have been exchanged: ask who is there


def _told(config: BoardPort, bound: BoundMap) -> BoardPort:
    """Return a board whose facts hold what its signal map says of its counts."""
    facts = config.facts
    counter_bits = None if bound.time is None else bound.time.signal.length
    known = {
        "sensor": facts.sensor or bound.sensor or None,
        "gyro_scale_rad_s": bound.gyro_scale_rad_s,
        "accel_scale_m_s2": bound.accel_scale_m_s2,
        "temperature_scale_c": bound.temperature_scale_c,
        "temperature_offset_c": None if bound.temperature is None else 0.0,
        "tick_hz": bound.tick_hz,
        "counter_bits": counter_bits,
    }
    return msgspec.structs.replace(config, facts=msgspec.structs.replace(facts, **known))
