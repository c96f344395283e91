"""Values of the motion unit from a recording: reply times, start delays, clock and settings.

The unit samples its position at some time between the last byte of a request and the first byte of
the reply. The fit of the moves assumes the middle of this time. Therefore the start delay has a
constant error that the time offset of the boards also has; only their sum is determined.

What to use when: `measure_unit` for a recording with a unit, and `first_move_s` for the time at
which its program begins.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.motion_orders import OrderKind
from gyrorig_protocol.recording.recording import Recording, times_ns
from gyrorig_protocol.twin import Scalar, TwinClock, TwinUnit, UnitFacts
from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.reference import UNUSABLE_STATUS, PanTiltReference, ReferenceMotion
from gyrorig_solver.reference.unit.controller_counter import counter_instants
from gyrorig_solver.twin.host_latency import HostLatency
from gyrorig_solver.twin.quantities import scalar
from gyrorig_solver.twin.rig_mapping import BITS_PER_BYTE

UNIT_RECORD = "gyrorig.ptu"  # in the metadata
FACTORY_BAUD = 9600.0
QUERY_BYTES = 3.0
MOTION_KINDS = (OrderKind.TARGET, OrderKind.OFFSET, OrderKind.RATE)
CRYSTAL_WALK_PER_SQRT_S = 1e-8  # of a crystal's rate (docs/clocks.md)
MIN_POLLS = 2


@dataclass(frozen=True, slots=True)
class MeasuredUnit:
    """The section of a twin, and the part of the uncertainty that a draw changes."""

    section: TwinUnit
    start_scatter_s: float  # standard error of the start delay by the replies, without the constant


def measure_unit(recording: Recording, motion: ReferenceMotion, host: HostLatency) -> MeasuredUnit:
    """Return the values of the unit from a recording.

    Args:
        recording: with a unit.
        motion: the reference of its fit.
        host: the latency of the host in an exchange.
    """
    facts = recording.metadata.get(UNIT_RECORD, {})
    earliest_s, latest_s, ticks = _answer_windows(recording, facts)
    answer_time = None
    if earliest_s.size >= MIN_POLLS:
        width_s, scatter_s = _median(latest_s - earliest_s)
        usual_s = width_s - host.exchange_s
        std_s = math.hypot(scatter_s, host.exchange_std_s)
        answer_time = scalar(max(usual_s, 0.0), std_s, "s")
    start_delay, start_scatter_s = _start_delay(motion, host)
    section = TwinUnit(
        answer_time=answer_time,
        start_delay=start_delay,
        counter=_counter_clock(facts, ticks, earliest_s, latest_s),
        facts=_unit_facts(facts),
    )
    return MeasuredUnit(section, start_scatter_s)


def first_move_s(recording: Recording, origin_ns: int) -> float | None:
    """Return the time of the first move's request, since `origin_ns`; None without a move."""
    orders = recording.motion_orders()
    is_move = np.isin(orders["kind"], MOTION_KINDS) & (orders["accepted"] != 0)
    if not is_move.any():
        return None
    return float((times_ns(orders["request_time"])[is_move].min() - origin_ns) * 1e-9)


def _start_delay(motion: ReferenceMotion, host: HostLatency) -> tuple[Scalar | None, float]:
    """Return the usual time from the last byte of a command until its move starts.

    The second value is its standard error by the replies, s.
    """
    if not isinstance(motion, PanTiltReference) or not motion.start_delays_s.size:
        return None, 0.0
    delay_s, scatter_s = _median(motion.start_delays_s)
    std_s = math.hypot(motion.common_shift_std_s, scatter_s)
    return scalar(max(delay_s - host.write_s, 0.0), std_s, "s"), scatter_s


def _answer_windows(
    recording: Recording, facts: Mapping[str, str]
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return the earliest and latest time of each reply's position, s, and the counter."""
    raw = recording.ptu_positions()
    raw = raw[raw["status"] & UNUSABLE_STATUS == 0]
    byte_s = BITS_PER_BYTE / (_number(facts, "baud") or FACTORY_BAUD)
    query_s = (_number(facts, "poll_bytes") or QUERY_BYTES) * byte_s
    request_ns = times_ns(raw["request_time"])
    origin_ns = int(request_ns[0]) if request_ns.size else 0
    order = np.argsort(request_ns, kind="stable")
    earliest_s = (request_ns[order] - origin_ns) * 1e-9 + query_s
    latest_s = (times_ns(raw["first_byte_time"])[order] - origin_ns) * 1e-9 - byte_s
    window_s = np.maximum(latest_s - earliest_s, 0.0)
    return (
        np.asarray(earliest_s, dtype=np.float64),
        np.asarray(earliest_s + window_s, dtype=np.float64),
        np.asarray(raw["controller_time"][order].astype(np.int64)),
    )


def _median(values: FloatArray) -> tuple[float, float]:
    """Return the median and its standard error.

    The standard error is half the distance of the values whose ranks are one standard deviation of
    the binomial distribution from the middle. It holds for any distribution.
    """
    deviation = 0.5 / math.sqrt(values.size)
    low, middle, high = np.quantile(values, [max(0.5 - deviation, 0.0), 0.5, 0.5 + deviation])
    return float(middle), 0.5 * float(high - low)


def _counter_clock(
    facts: Mapping[str, str], ticks: IntArray, earliest_s: FloatArray, latest_s: FloatArray
) -> TwinClock:
    counter_hz = _number(facts, "counter_hz")
    if not counter_hz or not counter_hz > 0.0:
        return TwinClock()
    instants = None
    if np.all(ticks >= 0):
        instants = counter_instants(ticks, earliest_s, latest_s, counter_hz)
    if instants is None:
        return TwinClock(tick_hz=counter_hz)
    span_s = float(instants.at_s[-1] - instants.at_s[0])
    std = CRYSTAL_WALK_PER_SQRT_S * math.sqrt(span_s)
    return TwinClock(skew=scalar(instants.skew_ppm * 1e-6, std, "1"), tick_hz=counter_hz)


def _unit_facts(facts: Mapping[str, str]) -> UnitFacts:
    """Return the settings that the unit has reported."""
    resolution_arcsec = _number(facts, "pan_resolution_arcsec")
    return UnitFacts(
        model=facts.get("model") or None,
        serial=facts.get("serial") or None,
        resolution_arcsec=resolution_arcsec if resolution_arcsec else None,
        pan_min_steps=_whole(facts, "pan_min_steps"),
        pan_max_steps=_whole(facts, "pan_max_steps"),
        tilt_min_steps=_whole(facts, "tilt_min_steps"),
        tilt_max_steps=_whole(facts, "tilt_max_steps"),
        base_speed_steps_s=_whole(facts, "pan_base_speed"),
        acceleration_steps_s2=_whole(facts, "pan_acceleration"),
        upper_speed_steps_s=_whole(facts, "pan_upper_speed"),
        counter_hz=_number(facts, "counter_hz"),
    )


def _number(facts: Mapping[str, str], key: str) -> float | None:
    try:
        value = float(facts.get(key, ""))
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _whole(facts: Mapping[str, str], key: str) -> int | None:
    value = _number(facts, key)
    return None if value is None else round(value)
