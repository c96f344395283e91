"""Latency of the host, measured above the lower envelope of the clock mapping.

A sample arrives after the minimum latency of its link and an excess. The excess of most samples is
the jitter of the host. If the host stalls, all bytes wait and arrive together, so that samples one
period apart have excesses that decrease by one period.

What to use when: `measure_link` for the recordings of all boards.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.board import TimeReply, TimeRequest
from gyrorig_protocol.board_protocols import SerialProtocol, find_protocol
from gyrorig_protocol.errors import GyrorigError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.recording import RecordArray, times_ns
from gyrorig_protocol.twin import Scalar, Source, TwinLink
from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.data.metadata_numbers import positive_number
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.pipeline import BoardData
from gyrorig_solver.twin.host_latency import HostFloor, HostLatency
from gyrorig_solver.twin.quantities import scalar
from gyrorig_solver.twin.rig_mapping import BITS_PER_BYTE, board_line

MIN_PINGS = 50  # with fewer exchanges, none has a latency near the floor
STALL_FACTOR = 15.0  # times the mean jitter: an exponential exceeds it once in 3e6 samples
QUEUE_SHARE = 0.02  # of the jitter, from frames that wait for other frames on the line
USUAL_FLOORS_S = 110e-6  # of writing and reading together, if nothing determines them
# Times the median excess: on a bus of 500 kbit/s or more with few boards, few frames wait longer.
LONG_MEDIANS = 3.0
MIN_STALLS = 8  # fewer do not determine the shortest and the longest stall
USUAL_STALLS_S = (5e-3, 0.2)  # shortest and longest stall of a busy computer
USUAL_STALLS_STD = 0.25  # relative, of the longest stall
SAME_STALL_S = 0.02  # after a stall, all ports are served within this time


@dataclass(frozen=True, slots=True)
class Stall:
    """A time in which the host received nothing."""

    end_s: float
    length_s: float


@dataclass(frozen=True, slots=True)
class Latency:
    """The latency of the host above its floor."""

    jitter_s: float  # mean excess outside stalls
    jitter_std_s: float
    stalls: tuple[Stall, ...]
    span_s: float  # of the recordings

    @property
    def stall_interval_s(self) -> tuple[float, float]:
        """Mean time from a stall to the next one, and its uncertainty.

        Without stalls, the time is 0 and its uncertainty is the duration of the recordings.
        """
        count = len(self.stalls)
        if count == 0:
            return 0.0, self.span_s
        running_s = self.span_s - sum(stall.length_s for stall in self.stalls)
        return running_s / count, running_s / count / math.sqrt(count)

    @property
    def stall_range_s(self) -> tuple[float, float, float, float] | None:
        """Shortest and longest stall, and the uncertainty of each; None without stalls.

        The ends of a uniform distribution are estimated from the extremes of n lengths: each
        extreme is one n-th of the range inside. Few lengths do not determine the ends, so the usual
        ends or the extremes are used.
        """
        lengths = [stall.length_s for stall in self.stalls]
        if not lengths:
            return None
        low, high = min(lengths), max(lengths)
        if len(lengths) < MIN_STALLS:
            shortest_s, longest_s = min(low, USUAL_STALLS_S[0]), max(high, USUAL_STALLS_S[1])
            return shortest_s, longest_s, shortest_s, USUAL_STALLS_STD * longest_s
        margin = (high - low) / (len(lengths) - 1)
        std_s = max(margin, 1e-3)
        return max(low - margin, 0.0), high + margin, std_s, std_s


def measure_latency(boards: Sequence[GyroSamples]) -> Latency | None:
    """Return the latency of the host from the arrival times of samples.

    Args:
        boards: the samples of all boards and recordings.

    Returns:
        None if no board has arrival times, as in imported data.
    """
    excesses: list[FloatArray] = []
    stalls: list[Stall] = []
    spans: dict[int, float] = {}
    for samples in boards:
        excess_s = _excess_s(samples)
        mean_s = float(np.median(excess_s)) / math.log(2.0)
        if mean_s <= 0.0:
            continue
        is_late = excess_s > STALL_FACTOR * mean_s
        usual_s = excess_s[~is_late]
        is_on_bus = samples.metadata.get("link") == "can"
        excesses.append(_without_short_waits(usual_s) if is_on_bus else usual_s)
        spans[samples.origin_ns] = float(np.ptp(samples.time_s))
        origin_s = samples.origin_ns * 1e-9  # each board of a recording has a separate origin
        stalls += [
            Stall(origin_s + stall.end_s, stall.length_s)
            for stall in _find_stalls(samples, excess_s, is_late)
        ]
    if not excesses:
        return None
    excess_s = np.concatenate(excesses)
    return Latency(
        jitter_s=float(np.mean(excess_s)),
        jitter_std_s=math.hypot(
            float(np.std(excess_s)) / math.sqrt(excess_s.size),
            QUEUE_SHARE * float(np.mean(excess_s)),
        ),
        stalls=_merge_stalls(stalls),
        span_s=_distinct_span_s(spans),
    )


def measure_floor(pings: RecordArray, tick_hz: float, baud: float) -> HostFloor | None:
    """Return the smallest latency of the host from the pings of a board on a serial line.

    The smallest time of an exchange, without the time in the board, consists of the transmission of
    the request and of the reply and the latency floors of writing and reading. The two floors are
    not known separately.

    Args:
        pings: of a board that answers time requests.
        tick_hz: of its counter.
        baud: of its line.

    Returns:
        None with too few pings, or if the exchange is shorter than the line allows.
    """
    if pings.size < MIN_PINGS:
        return None
    request_s, reply_s = (
        len(frame.encode()) * BITS_PER_BYTE / baud
        for frame in (TimeRequest(0, 0), TimeReply(0, 0, 0, 0))
    )
    exchange_s = (times_ns(pings["host_receive"]) - times_ns(pings["host_send"])) * 1e-9
    ticks = pings["device_send"].astype(np.int64) - pings["device_receive"].astype(np.int64)
    # the counter can overflow between the two
    exchange_s, ticks = exchange_s[ticks >= 0], ticks[ticks >= 0]
    if exchange_s.size < MIN_PINGS:
        return None
    latency_s = exchange_s - ticks / tick_hz
    excess_s = latency_s - latency_s.min()
    usual_s = float(np.median(excess_s))
    floors_s = float(latency_s.min()) - request_s - reply_s
    if not floors_s > 0.0:
        return None
    excess_s = excess_s[excess_s < STALL_FACTOR * usual_s + 1e-6]
    return HostFloor(
        floor_s=floors_s / 2.0,
        std_s=floors_s / math.sqrt(12.0),
        excess_s=float(np.mean(excess_s)),
        excess_std_s=float(np.std(excess_s)) / math.sqrt(excess_s.size),
        exchange_count=excess_s.size,
    )


def _excess_s(samples: GyroSamples) -> FloatArray:
    """Return each sample's latency above the floor, shape (n,)."""
    latency_s = samples.host_s - samples.time_s
    bounds = samples.latency_bounds
    floor_s = 0.0 if bounds is None else bounds.midpoint_at(samples.time_s)
    return np.asarray(np.maximum(latency_s - floor_s, 0.0), dtype=np.float64)


def _without_short_waits(excess_s: FloatArray) -> FloatArray:
    """Return the excess above a limit, of the samples that exceed it.

    An exponential has no memory: above any limit, the mean excess is the same. Above the waits of a
    frame for other frames on the bus, it does not contain them. An adapter that is polled has no
    exponential latency: if far fewer samples exceed the limit, all are returned.
    """
    limit_s = LONG_MEDIANS * float(np.median(excess_s))
    is_long = excess_s > limit_s
    if np.mean(is_long) < 0.5 * 2.0**-LONG_MEDIANS:
        return excess_s
    return excess_s[is_long] - limit_s


def _find_stalls(samples: GyroSamples, excess_s: FloatArray, is_late: BoolArray) -> list[Stall]:
    """Return the stalls of one board: late samples that arrived together."""
    late = np.flatnonzero(is_late)
    if not late.size:
        return []
    arrival_s = samples.time_s[late] + excess_s[late]
    groups = np.split(np.arange(late.size), np.flatnonzero(np.diff(arrival_s) > SAME_STALL_S) + 1)
    # The stall started up to one period before the first sample that it delayed.
    before_s = samples.period_s / 2.0
    return [
        Stall(float(arrival_s[group].max()), float(excess_s[late[group]].max()) + before_s)
        for group in groups
    ]


def _merge_stalls(stalls: Sequence[Stall]) -> tuple[Stall, ...]:
    """Return each stall once; if several boards show it, use the longest length."""
    merged: list[Stall] = []
    for stall in sorted(stalls, key=lambda stall: stall.end_s):
        if merged and stall.end_s - merged[-1].end_s < SAME_STALL_S:
            merged[-1] = Stall(stall.end_s, max(stall.length_s, merged[-1].length_s))
        else:
            merged.append(stall)
    return tuple(merged)


def _distinct_span_s(spans: dict[int, float]) -> float:
    """Return the duration of all recordings; boards of one recording begin within a second."""
    total_s, last_ns = 0.0, -math.inf
    for origin_ns, span_s in sorted(spans.items()):
        if origin_ns - last_ns > 1e9:
            total_s += span_s
            last_ns = origin_ns
    return total_s


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredLink:
    """The link of a rig, as far as its recordings determine it."""

    section: TwinLink
    latency: Latency | None
    floors: Mapping[str, HostFloor]  # by board, of those that answer time requests

    @property
    def host_latency(self) -> HostLatency:
        """The latency of the host in an exchange with a device.

        Pings determine the sum of both floors. Without pings, the jitter of writing is unknown.
        """
        best = _best_floor(self.floors)
        read, write = (
            (0.0, 0.0) if jitter is None else (jitter.value, jitter.std or 0.0)
            for jitter in (self.section.jitter, self.section.write_jitter)
        )
        floors_s, std_s = (
            (USUAL_FLOORS_S, USUAL_FLOORS_S) if best is None else (2.0 * best.floor_s, 0.0)
        )
        return HostLatency(floors_s, std_s, *read, *write)


def measure_link(boards: Mapping[str, BoardData]) -> MeasuredLink:
    """Return the properties of the link from the arrival times of all boards."""
    latency = measure_latency(
        [samples for data in boards.values() for samples in data.samples if _is_live(samples)]
    )
    floors = {}
    for name, data in boards.items():
        floor = _floor_of_board(name, data)
        if floor is not None:
            floors[name] = floor if latency is None else floor.without_bias(latency.jitter_s)
    return MeasuredLink(_section(latency, _best_floor(floors)), latency, floors)


def _is_live(samples: GyroSamples) -> bool:
    """Return whether the samples have arrival times."""
    return not samples.is_imported and "tick_hz" in samples.metadata


def _floor_of_board(name: str, data: BoardData) -> HostFloor | None:
    """Return the latency floor from the pings of the last recording of a board."""
    recording, samples = data.recordings[-1], data.samples[-1]
    kind, baud = board_line(recording, name)
    protocol = _serial_protocol(kind)
    tick_hz = positive_number(samples.metadata, "tick_hz")
    if baud is None or tick_hz is None or protocol is None or not protocol.answers_time_requests:
        return None
    return measure_floor(recording.clock_pings(BoardId(name)), tick_hz, baud)


def _serial_protocol(name: str) -> SerialProtocol | None:
    try:
        protocol = find_protocol(name)
    except GyrorigError:
        return None
    return protocol if isinstance(protocol, SerialProtocol) else None


def _best_floor(floors: Mapping[str, HostFloor]) -> HostFloor | None:
    return min(floors.values(), key=lambda floor: floor.std_s, default=None)


def _section(latency: Latency | None, floor: HostFloor | None) -> TwinLink:
    """Return the section without values that are not determined."""
    values: dict[str, Scalar | None] = {}
    if latency is not None:
        values["jitter"] = scalar(latency.jitter_s, latency.jitter_std_s, "s")
        interval_s, interval_std_s = latency.stall_interval_s
        values["stall_interval"] = scalar(interval_s, interval_std_s, "s")
        stall_range = latency.stall_range_s
        if stall_range is not None:
            shortest_s, longest_s, shortest_std_s, longest_std_s = stall_range
            source: Source = "recording" if len(latency.stalls) >= MIN_STALLS else "default"
            values["stall_shortest"] = scalar(shortest_s, shortest_std_s, "s", source)
            values["stall_longest"] = scalar(longest_s, longest_std_s, "s", source)
    if floor is not None:
        values["floor"] = scalar(floor.floor_s, floor.std_s, "s")
        values["write_floor"] = scalar(floor.floor_s, floor.std_s, "s")
        if latency is not None:
            write_jitter_s = max(floor.excess_s - latency.jitter_s, 0.0)
            write_std_s = math.hypot(floor.excess_std_s, latency.jitter_std_s)
            values["write_jitter"] = scalar(write_jitter_s, write_std_s, "s")
    return TwinLink(**values)
