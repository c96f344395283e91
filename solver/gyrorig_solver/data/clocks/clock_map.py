"""The clock map: sample times on the capture clock, from ticks and arrival times."""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from gyrorig_solver.data.arrays import BoolArray, FloatArray, IntArray
from gyrorig_solver.data.clocks.clock_faults import ClockFault, CounterArray
from gyrorig_solver.data.clocks.latency_floor import LatencyFloor, find_latency_floor
from gyrorig_solver.data.clocks.lower_envelope import Envelope
from gyrorig_solver.data.clocks.tick_unwrapping import PIECE_SAMPLES, unwrap_ticks

_QUANTILE_SAMPLES = 1 << 20  # delays sufficient for their percentiles


@dataclass(frozen=True, slots=True, eq=False)
class ClockMap:
    """Sample times on the capture clock, up to one constant.

    The constant is the minimum latency of the link. One-way timestamps cannot determine it; it
    is also contained in the time offset that the motion determines.
    """

    time_s: FloatArray  # (n,), capture clock, seconds since the recording's origin
    segment: IntArray  # (n,), counts segments between restarts and steps
    late: BoolArray  # (n,)
    skew_ppm: float  # of the device's clock against the capture clock, longest segment
    wander_bound_s: float  # e* of docs/clocks.md, the error of an ideal envelope
    latency_s: FloatArray  # (3,), median, 99th percentile and largest delay above the floor
    restarts: int
    wraps: int
    steps: int = 0  # of one of the clocks, without a restart
    faults: tuple[ClockFault, ...] = ()  # the restarts and steps
    method: str = "line"  # of the longest segment
    sigma_s: float = 0.0  # predicted wander of the times, longest segment
    disagreement_s: float = 0.0  # rms between envelope and smoother, if both were computed
    structure_reason: str = ""  # why the latency is structured, "" if it is not
    walk_per_sqrt_s: float = field(default=float("nan"))  # of the clock's rate, if estimated
    latency_floor: Envelope | None = None  # of the longest segment, over its device time

    @property
    def segment_count(self) -> int:
        """Number of segments of continuous device time."""
        return int(self.segment[-1]) + 1 if self.segment.size else 0


def map_clock(
    ticks: IntArray,
    host_s: FloatArray,
    tick_hz: float,
    counter_bits: int,
    sequence: CounterArray | None = None,
    *,
    sequence_bits: int | None = None,
    is_sensor_clock: bool = False,
    overwrite: bool = False,
) -> ClockMap:
    """Return sample times from raw ticks and arrival times.

    Args:
        ticks: as sent, shape (n,).
        host_s: arrival of each frame's last byte, shape (n,), not decreasing.
        tick_hz: nominal ticks per second.
        counter_bits: width of the tick counter.
        sequence: the sample counter as sent, shape (n,), if there is one.
        sequence_bits: width of the sample counter; None: 16 if no value exceeds 65535,
            otherwise 32.
        is_sensor_clock: the ticks are the sample counter, whose rate drifts with the temperature.
        overwrite: allows the use of the memory of `ticks` for the result and of `host_s` as
            work space; `host_s` is restored up to rounding. Saves 370 MB for 8 h at 800 Hz.
    """
    if not overwrite:
        ticks, host_s = np.array(ticks, np.int64), np.array(host_s, np.float64)
    unwrapped = unwrap_ticks(
        ticks, host_s, tick_hz, counter_bits, sequence,
        sequence_bits=sequence_bits, overwrite=True,
    )  # fmt: skip
    edges = np.searchsorted(unwrapped.segment, np.arange(int(unwrapped.segment[-1]) + 2))
    floors: list[tuple[float, LatencyFloor]] = []
    times, lag_s = unwrapped.device_s, host_s  # in place, because each array of 8 h takes 184 MB
    lag_s -= times
    delays: list[FloatArray] = []
    largest_s, stride = 0.0, max(1, host_s.size // _QUANTILE_SAMPLES)
    for a, b in pairwise(edges.tolist()):
        segment_time_s, segment_lag_s = times[a:b], lag_s[a:b]
        floor_fit = find_latency_floor(
            *_sorted_by_time(segment_time_s, segment_lag_s), is_sensor_clock=is_sensor_clock
        )
        floors.append((float(segment_time_s[-1] - segment_time_s[0]), floor_fit))
        for start in range(a, b, PIECE_SAMPLES):
            rows = slice(start, min(start + PIECE_SAMPLES, b))
            floor_delay_s = floor_fit.envelope.delay_at(times[rows])
            latency_s = lag_s[rows] - floor_delay_s
            largest_s = max(largest_s, float(latency_s.max()))
            delays.append(latency_s[-(start - a) % stride :: stride].copy())
            lag_s[rows] += times[rows]
            times[rows] += floor_delay_s
    longest_floor = max(floors, key=lambda pair: pair[0])[1]
    skew = _mean_slope(longest_floor)
    return ClockMap(
        time_s=times,
        segment=unwrapped.segment,
        late=unwrapped.late_mask,
        skew_ppm=-1e6 * skew / (1.0 + skew),
        wander_bound_s=max(floor_fit.wander_bound_s for _, floor_fit in floors),
        latency_s=np.array([*np.percentile(np.concatenate(delays), (50.0, 99.0)), largest_s]),
        restarts=unwrapped.restarts,
        wraps=unwrapped.wraps,
        steps=unwrapped.steps,
        faults=unwrapped.faults,
        method=longest_floor.method,
        sigma_s=longest_floor.sigma_s,
        disagreement_s=longest_floor.disagreement_s,
        structure_reason=next(
            (floor_fit.structure_reason for _, floor_fit in floors if floor_fit.structure_reason),
            "",
        ),
        walk_per_sqrt_s=longest_floor.walk_per_sqrt_s,
        latency_floor=longest_floor.envelope,
    )


def _sorted_by_time(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return both sorted by the first one; usually they are sorted already."""
    if np.all(x[1:] >= x[:-1]):
        return x, y
    order = np.argsort(x, kind="stable")
    return x[order], y[order]


def _mean_slope(floor: LatencyFloor) -> float:
    knot_s, delay_s = floor.envelope.knot_s, floor.envelope.delay_s
    if knot_s.size < 2:
        return 0.0
    return float((delay_s[-1] - delay_s[0]) / (knot_s[-1] - knot_s[0]))
