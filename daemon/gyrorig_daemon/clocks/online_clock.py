"""Online map of one device's clock to the capture clock, as timestamps arrive.

One-way timestamps give the clock up to the minimum latency, which they cannot determine: it
contains the time in which a board reads its sensor. Two-way exchanges (pings) bracket it: a
request cannot have arrived before it was sent, nor a reply have left after it arrived. The
brackets of the last half minute together give an interval that contains the truth, often of
about ten microseconds. Its midpoint is used (docs/clocks.md).
"""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from gyrorig_daemon.clocks.counter_unwrap import CounterUnwrapper
from gyrorig_daemon.clocks.latency_floor import LatencyFloorFilter

MAX_PINGS = 150  # half a minute at five per second


@dataclass(frozen=True, slots=True)
class _Ping:
    """One bracket, in seconds since the origin of the map."""

    sent_s: float
    device_receive_s: float
    device_send_s: float
    received_s: float


@dataclass(frozen=True, slots=True)
class ClockReport:
    """State of the map, for /diagnostics."""

    mapped: bool  # False during the first second of timestamps: arrival times are used
    offset_s: float
    skew_ppm: float
    sigma_s: float
    restarts: int
    windows: int
    late_windows: int
    early_windows: int
    steps: int
    two_way_low_s: float | None  # true minus one-way time is between low and high
    two_way_high_s: float | None
    correction_s: float  # added to the one-way map: the midpoint of both, or 0


class OnlineClock:
    """The map of one clock. Feed it every timestamp in the order of arrival."""

    def __init__(self, tick_hz: float, counter_bits: int, sequence_bits: int = 16) -> None:
        """Start without a map.

        Args:
            tick_hz: nominal ticks per second.
            counter_bits: width after which the counter wraps.
            sequence_bits: width of the sample counter.
        """
        self._tick_hz = tick_hz
        self._unwrapper = CounterUnwrapper(tick_hz, counter_bits, sequence_bits)
        self._floor = LatencyFloorFilter()
        self._origin_ticks = 0
        self._origin_ns = 0
        self._last_ticks = 0
        self._restarts = -1  # the first timestamp is not a restart
        self._pings: deque[_Ping] = deque(maxlen=MAX_PINGS)
        self._one_way_s: deque[tuple[float, float]] = deque(
            maxlen=MAX_PINGS
        )  # sent by the device, received here
        self._low_s = -math.inf
        self._high_s = math.inf
        self._correction_s = 0.0
        self._bracketed_revision = -1  # of the floor, when all brackets were computed

    def restart(self) -> None:
        """Start again, because the device reported a restart."""
        self._unwrapper.restart()

    def observe(
        self,
        raw: int,
        arrival_ns: int,
        wire_ns: int = 0,
        sequence: int | None = None,
        is_floor: bool = True,
    ) -> int:
        """Add one timestamp and return its time on the raw monotonic clock, in ns.

        Until there is a map, the arrival time is returned. A sample is never later than its
        arrival.

        Args:
            raw: ticks as received.
            arrival_ns: when the last byte of the frame was received.
            wire_ns: transmission time of the frame: a known part of the latency.
            sequence: the device's sample counter as received.
            is_floor: whether the latency has a minimum. False on a bus, where frames wait for
                each other in slow beats; there `observe_edge` gives the minimum.
        """
        unwrapped = self._unwrapper.feed(raw, arrival_ns, sequence)
        departure_ns = arrival_ns - wire_ns
        if unwrapped.restarted:
            self._restarts += 1
            self._floor.restart()
            self._origin_ticks, self._origin_ns = unwrapped.ticks, departure_ns
            self._pings.clear()
            self._one_way_s.clear()
            self._low_s, self._high_s, self._correction_s = -math.inf, math.inf, 0.0
            self._bracketed_revision = -1
        self._last_ticks = max(unwrapped.ticks, self._origin_ticks)
        device_s = self._device_s(unwrapped.ticks)
        if is_floor:
            self._floor.observe(device_s, (departure_ns - self._origin_ns) * 1e-9 - device_s)
        mapped_ns = self._to_ns(device_s)
        return arrival_ns if mapped_ns is None else min(mapped_ns, arrival_ns)

    @property
    def counter_bits(self) -> int:
        """The width after which the counter wraps."""
        return self._unwrapper.modulus.bit_length() - 1

    @property
    def is_bracketed(self) -> bool:
        """True if pings have corrected the one-way map."""
        return self._correction_s != 0.0

    @property
    def restarts(self) -> int:
        """Number of restarts, without the first start."""
        return max(self._restarts, 0)

    def map_ns(self, raw: int) -> int | None:
        """Return the time of a timestamp near the last one, None without a map."""
        return self._to_ns(self._device_s(self._unwrap_near(raw)))

    def observe_two_way(
        self, sent_ns: int, device_receive: int, device_send: int, received_ns: int
    ) -> None:
        """Add one ping: the truth is between its sending and its receipt.

        Args:
            sent_ns: when the last byte of the request can have left the host at the earliest.
            device_receive: 64-bit ticks when the device received it.
            device_send: 64-bit ticks when the device replied.
            received_ns: when the host had the reply, less its transmission time.
        """
        if not self._floor.has_state:
            return
        self._add_bracket(
            _Ping(
                (sent_ns - self._origin_ns) * 1e-9,
                self._device_s(self._unwrap_near(device_receive)),
                self._device_s(self._unwrap_near(device_send)),
                (received_ns - self._origin_ns) * 1e-9,
            )
        )

    def observe_edge(self, raw: int, sent_ns: int, echo_ns: int) -> None:
        """Add the clock at an edge that the host sent and received itself.

        Args:
            raw: ticks at the edge.
            sent_ns: earliest time of the edge.
            echo_ns: when the host received it.
        """
        if self._restarts < 0:
            return  # the wrap is not known yet
        device_s = self._device_s(self._unwrap_near(raw))
        self._floor.observe(device_s, (echo_ns - self._origin_ns) * 1e-9 - device_s)
        self.observe_two_way(sent_ns, raw, raw, echo_ns)

    def observe_one_way(self, device_send: int, received_ns: int) -> None:
        """Add a timestamp of a transmission: the truth is not later than its receipt.

        Args:
            device_send: 64-bit ticks when the first byte of the frame left the device.
            received_ns: when the host had the frame, less its transmission time.
        """
        if not self._floor.has_state or not math.isfinite(self._low_s):
            return  # one bound alone gives no correction
        send_s = self._device_s(self._unwrap_near(device_send))
        received_s = (received_ns - self._origin_ns) * 1e-9
        self._one_way_s.append((send_s, received_s))
        high_s = received_s - send_s - self._floor.latency_floor_s(send_s)
        self._high_s = min(self._high_s, high_s)

    def _add_bracket(self, ping: _Ping) -> None:
        self._pings.append(ping)
        floor = self._floor
        if floor.revision == self._bracketed_revision:
            # The floor is unchanged, and therefore all earlier brackets.
            received_s, sent_s = ping.device_receive_s, ping.device_send_s
            low_s = ping.sent_s - received_s - floor.latency_floor_s(received_s)
            high_s = ping.received_s - sent_s - floor.latency_floor_s(sent_s)
            self._low_s, self._high_s = max(self._low_s, low_s), min(self._high_s, high_s)
        else:
            self._bracketed_revision = floor.revision
            self._recompute_brackets(floor.latency_floor_s)
        if self._low_s <= self._high_s:
            self._correction_s = 0.5 * (self._low_s + self._high_s)

    def _recompute_brackets(self, floor_s: Callable[[float], float]) -> None:
        self._low_s = max(
            p.sent_s - p.device_receive_s - floor_s(p.device_receive_s) for p in self._pings
        )
        sent = [(p.device_send_s, p.received_s) for p in self._pings]
        self._high_s = min(
            received_s - send_s - floor_s(send_s)
            for send_s, received_s in (*sent, *self._one_way_s)
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

    def _unwrap_near(self, raw: int) -> int:
        modulus = self._unwrapper.modulus
        return raw + round((self._last_ticks - raw) / modulus) * modulus

    def _to_ns(self, device_s: float) -> int | None:
        if not self._floor.has_state:
            return None
        host_s = device_s + self._floor.latency_floor_s(device_s) + self._correction_s
        return self._origin_ns + round(host_s * 1e9)
