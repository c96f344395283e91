"""One device's clock, mapped to the capture clock as its stamps arrive.

One-way stamps give the clock up to the least latency, which they cannot show: the time a
board takes to read its sensor is in it. Pings bracket it: a request cannot have arrived
before it was sent, nor an answer have left after it arrived. The brackets of the last
half minute together are an interval that holds the truth, often of some ten
microseconds; its middle is taken (reference: timesync.md section 4, two hulls).
"""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from gyrorig_daemon.clocks.floor import FloorFilter
from gyrorig_daemon.clocks.unwrap import Unwrapper

PING_MEMORY = 150  # half a minute at five a second


@dataclass(frozen=True, slots=True)
class _Ping:
    """One bracket, in seconds from the map's origin."""

    sent_s: float
    device_receive_s: float
    device_send_s: float
    received_s: float


@dataclass(frozen=True, slots=True)
class ClockReport:
    """What the map knows, for /diagnostics."""

    mapped: bool  # False until the first second of stamps is in: arrival times stand in
    offset_s: float
    skew_ppm: float
    sigma_s: float
    restarts: int
    windows: int
    late_windows: int
    early_windows: int
    steps: int
    two_way_low_s: float | None  # true minus one-way time lies between low and high
    two_way_high_s: float | None
    correction_s: float  # added to the one-way map: the middle of both, or 0


class OnlineClock:
    """The map of one clock. Feed it every stamp in the order of arrival."""

    def __init__(
        self,
        tick_hz: float,
        counter_bits: int,
        sequence_bits: int = 16,
        skew_walk: float = 1e-8,
    ) -> None:
        """Begin without a map.

        Args:
            tick_hz: nominal ticks a second.
            counter_bits: the width after which the counter wraps.
            sequence_bits: the width of the sample counter beside it.
            skew_walk: random walk of the skew per sqrt(s).
        """
        self._tick_hz = tick_hz
        self._unwrap = Unwrapper(tick_hz, counter_bits, sequence_bits)
        self._floor = FloorFilter(skew_walk)
        self._origin_ticks = 0
        self._origin_ns = 0
        self._last_ticks = 0
        self._restarts = -1  # the first stamp is no restart
        self._pings: deque[_Ping] = deque(maxlen=PING_MEMORY)
        self._sent: deque[tuple[float, float]] = deque(maxlen=PING_MEMORY)  # at device, here
        self._low_s = -math.inf
        self._high_s = math.inf
        self._correction_s = 0.0
        self._bracketed_revision = -1  # of the floor, when all brackets were looked at

    def restart(self) -> None:
        """Begin anew: the device said that it booted."""
        self._unwrap.restart()

    def observe(
        self,
        raw: int,
        arrival_ns: int,
        wire_ns: int = 0,
        sequence: int | None = None,
        is_floor: bool = True,
    ) -> int:
        """Take one stamp and return its time on the raw monotonic clock, in ns.

        Until there is a map, the arrival stands in for it. A sample is never later
        than its arrival.

        Args:
            raw: ticks as sent.
            arrival_ns: when the frame's last byte was in the host's hands.
            wire_ns: how long the frame was on the wire: a known part of the latency.
            sequence: the device's sample counter as sent.
            is_floor: its latency has a floor. False on a bus, where frames wait for each
                other in slow beats: there `edge` gives the floor.
        """
        stamp = self._unwrap.feed(raw, arrival_ns, sequence)
        left_ns = arrival_ns - wire_ns
        if stamp.restarted:
            self._restarts += 1
            self._floor.restart()
            self._origin_ticks, self._origin_ns = stamp.ticks, left_ns
            self._pings.clear()
            self._sent.clear()
            self._low_s, self._high_s, self._correction_s = -math.inf, math.inf, 0.0
            self._bracketed_revision = -1
        self._last_ticks = max(stamp.ticks, self._origin_ticks)
        device_s = self._device_s(stamp.ticks)
        if is_floor:
            self._floor.observe(device_s, (left_ns - self._origin_ns) * 1e-9 - device_s)
        mapped_ns = self._to_ns(device_s)
        return arrival_ns if mapped_ns is None else min(mapped_ns, arrival_ns)

    @property
    def counter_bits(self) -> int:
        """The width after which the counter wraps."""
        return self._unwrap.modulus.bit_length() - 1

    @property
    def is_bracketed(self) -> bool:
        """True when pings have corrected the one-way map."""
        return self._correction_s != 0.0

    @property
    def restarts(self) -> int:
        """How often the count began anew, the first time apart."""
        return max(self._restarts, 0)

    def map_ns(self, raw: int) -> int | None:
        """Return the time of a stamp near the last one, None while there is no map."""
        return self._to_ns(self._device_s(self._nearest(raw)))

    def two_way(
        self, sent_ns: int, device_receive: int, device_send: int, received_ns: int
    ) -> None:
        """Take one ping: the truth lies between what it was sent and received at.

        Args:
            sent_ns: when the request's last byte can first have left the host.
            device_receive: 64-bit ticks when the device had it.
            device_send: 64-bit ticks when the device answered.
            received_ns: when the answer was in the host's hands, less its time on the wire.
        """
        if not self._floor.has_state:
            return
        self._bracket(
            _Ping(
                (sent_ns - self._origin_ns) * 1e-9,
                self._device_s(self._nearest(device_receive)),
                self._device_s(self._nearest(device_send)),
                (received_ns - self._origin_ns) * 1e-9,
            )
        )

    def edge(self, raw: int, sent_ns: int, echo_ns: int) -> None:
        """Take the clock at an edge that the host gave and heard itself: a floor and a bracket.

        Args:
            raw: ticks at the edge.
            sent_ns: when the edge can first have been.
            echo_ns: when the host heard it.
        """
        if self._restarts < 0:
            return  # nothing says yet which wrap it is of
        device_s = self._device_s(self._nearest(raw))
        self._floor.observe(device_s, (echo_ns - self._origin_ns) * 1e-9 - device_s)
        self.two_way(sent_ns, raw, raw, echo_ns)

    def one_way(self, device_send: int, received_ns: int) -> None:
        """Take a stamp of a sending: the truth is not later than what it was received at.

        Args:
            device_send: 64-bit ticks when the frame's first byte left the device.
            received_ns: when the frame was in the host's hands, less its time on the wire.
        """
        if not self._floor.has_state or not math.isfinite(self._low_s):
            return  # one bound alone corrects nothing
        send_s = self._device_s(self._nearest(device_send))
        received_s = (received_ns - self._origin_ns) * 1e-9
        self._sent.append((send_s, received_s))
        high_s = received_s - send_s - self._floor.latency_floor_s(send_s)
        self._high_s = min(self._high_s, high_s)

    def _bracket(self, ping: _Ping) -> None:
        self._pings.append(ping)
        floor = self._floor
        if floor.revision == self._bracketed_revision:
            # The floor is where it was: so are all brackets beside it, and only one is new.
            received_s, sent_s = ping.device_receive_s, ping.device_send_s
            low_s = ping.sent_s - received_s - floor.latency_floor_s(received_s)
            high_s = ping.received_s - sent_s - floor.latency_floor_s(sent_s)
            self._low_s, self._high_s = max(self._low_s, low_s), min(self._high_s, high_s)
        else:
            self._bracketed_revision = floor.revision
            self._bracket_anew(floor.latency_floor_s)
        if self._low_s <= self._high_s:
            self._correction_s = 0.5 * (self._low_s + self._high_s)

    def _bracket_anew(self, floor_s: Callable[[float], float]) -> None:
        self._low_s = max(
            p.sent_s - p.device_receive_s - floor_s(p.device_receive_s) for p in self._pings
        )
        sent = [(p.device_send_s, p.received_s) for p in self._pings]
        self._high_s = min(
            received_s - send_s - floor_s(send_s) for send_s, received_s in (*sent, *self._sent)
        )

    def report(self) -> ClockReport:
        """Return the state of the map."""
        state = self._floor.state()
        return ClockReport(
            mapped=self._floor.has_state,
            offset_s=state.offset_s,
            skew_ppm=state.skew * 1e6,
            sigma_s=state.offset_sigma_s if self._floor.has_state else math.inf,
            restarts=max(self._restarts, 0),
            windows=state.windows,
            late_windows=state.late_windows,
            early_windows=state.early_windows,
            steps=state.steps,
            two_way_low_s=self._low_s if math.isfinite(self._low_s) else None,
            two_way_high_s=self._high_s if math.isfinite(self._high_s) else None,
            correction_s=self._correction_s,
        )

    def _device_s(self, ticks: int) -> float:
        return (ticks - self._origin_ticks) / self._tick_hz

    def _nearest(self, raw: int) -> int:
        modulus = self._unwrap.modulus
        return raw + round((self._last_ticks - raw) / modulus) * modulus

    def _to_ns(self, device_s: float) -> int | None:
        if not self._floor.has_state:
            return None
        host_s = device_s + self._floor.latency_floor_s(device_s) + self._correction_s
        return self._origin_ns + round(host_s * 1e9)
