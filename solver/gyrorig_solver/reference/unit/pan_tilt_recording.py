"""The reference motion of a pan-tilt unit, read from a recording.

What to use when: `read_pan_tilt_reference` for a recording; `choose_reference` for a motion and
polls that are already known.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.messages import PtuStatus
from gyrorig_protocol.recording.recording import Recording, times_ns
from gyrorig_solver.data import BoolArray, FloatArray, IntArray
from gyrorig_solver.data.metadata_numbers import decimal_number
from gyrorig_solver.reference.unit.axis_trajectory import build_trajectories
from gyrorig_solver.reference.unit.controller_counter import counter_instants
from gyrorig_solver.reference.unit.counted_reference import CountedReference, counted_reference
from gyrorig_solver.reference.unit.move_fit import UnitPolls, fit_moves
from gyrorig_solver.reference.unit.move_table import MoveTable
from gyrorig_solver.reference.unit.pan_tilt_reference import PanTiltReference
from gyrorig_solver.reference.unit.poll_likelihood import POLLS_PER_PIECE, grouped_median
from gyrorig_solver.reference.unit.recorded_orders import read_orders
from gyrorig_solver.reference.unit.unit_moves import AXES, MotionReader, UnitMotion

_MAX_SETTING = 1e12
UNUSABLE_STATUS = (
    PtuStatus.SYNCHRONY_LOST | PtuStatus.HOMING
)  # with these bits the position is not an angle
FIXED_AXIS_RAD = 1e-7  # step of an axis that the unit lacks; this axis is always exactly at 0
FACTORY_BAUD = 9600.0
BITS_PER_BYTE = 10  # 8N1
QUERY_BYTES = 3  # `BT ` or `PP `, unless the recording states another number
# of the counts in motion; with a larger share, only the counts are used
MAX_UNEXPLAINED_SHARE = 0.5
MAX_COUNT_ERROR_STEPS = 4.0  # the quantum of the count, its lag, and some start error
MAX_START_ERROR_S = 0.005  # of a start that was not polled
REST_DELAY_S = 1.0  # after the planned end of a move
NEIGHBOURS = 3  # neighbours used in the check of a count
UNKNOWN_MARGIN_S = 0.3  # before and after a count that the commands do not explain


def read_pan_tilt_reference(
    recording: Recording, origin_ns: int
) -> PanTiltReference | CountedReference:
    """Return the motion of the unit from its commands and polled positions.

    If the commands do not explain most counts in motion, the counts alone are used.

    0 s is the capture time `origin_ns`.

    Raises:
        InputError: there are too few polls, or the metadata lack a setting of the unit.
    """
    metadata = recording.metadata.get("gyrorig.ptu", {})
    byte_s = _byte_s(metadata)
    polls, steps = _read_polls(recording, metadata, byte_s, origin_ns)
    rad_per_step = (
        _rad_per_step(recording, metadata, "pan"),
        _rad_per_step(recording, metadata, "tilt"),
    )
    orders = read_orders(recording, byte_s, origin_ns)
    motion = MotionReader(_settings(metadata), steps, polls.count_at_rest).read(orders)
    return choose_reference(_mark_contradictions(motion, polls), polls, rad_per_step)


def choose_reference(
    motion: UnitMotion, polls: UnitPolls, rad_per_step: tuple[float, float]
) -> PanTiltReference | CountedReference:
    """Return the commanded motion if it explains the counts, otherwise the counted motion.

    Spans that the commanded motion does not explain are marked as unknown.
    """
    span = (float(polls.earliest_s[0]), float(polls.latest_s[-1]))
    reference = PanTiltReference.of(motion, fit_moves(motion, polls), rad_per_step, span)
    left_out, share = unexplained_spans(reference, polls)
    if share > MAX_UNEXPLAINED_SHARE:
        reason = "the commands do not explain how the unit moved"
        return counted_reference(
            polls,
            rad_per_step,
            reason if motion.moves else "the recording has no command of a move",
        )
    if not left_out:
        return reference
    reason = "the position counts do not follow the commands"
    unexplained_with_reason = tuple((begin, end, reason) for begin, end in left_out)
    return replace(
        reference,
        motion=replace(motion, unknown_spans=(*motion.unknown_spans, *unexplained_with_reason)),
    )


def unexplained_spans(
    reference: PanTiltReference, polls: UnitPolls
) -> tuple[list[tuple[float, float]], float]:
    """Return the spans in which the counts contradict the motion, and their share of counts.

    The share is of the counts in motion. Unknown spans of the motion are also unexplained.
    """
    spans: list[tuple[float, float]] = []
    moving_count = lost_count = 0
    for axis in (0, 1):
        use = np.flatnonzero(polls.valid[:, axis])
        lost_times = [np.zeros(0)]
        for begin in range(0, use.size, POLLS_PER_PIECE):
            # A count is checked together with its neighbours.
            first, last = max(0, begin - NEIGHBOURS), begin + POLLS_PER_PIECE + NEIGHBOURS
            inner_rows = slice(begin - first, begin - first + POLLS_PER_PIECE)
            time_s, moving, is_off, known = _compare_counts(reference, polls, use[first:last], axis)
            time_s = time_s[inner_rows]
            moving = moving[inner_rows]
            is_off = is_off[inner_rows]
            known = known[inner_rows]
            moving_count += int(moving.sum())
            lost_count += int(np.sum(moving & (is_off | ~known)))
            lost_times.append(time_s[is_off & known])
        lost_s = np.concatenate(lost_times)
        # Two such counts within the margins of each other form one span.
        new = np.flatnonzero(np.diff(lost_s, prepend=-np.inf) >= 3.0 * UNKNOWN_MARGIN_S)
        last_of = np.append(new, lost_s.size)[1:] - 1
        spans += [
            (float(lost_s[a]) - UNKNOWN_MARGIN_S, float(lost_s[b]) + UNKNOWN_MARGIN_S)
            for a, b in zip(new, last_of, strict=True)
        ]
    return spans, lost_count / max(1, moving_count)


def _compare_counts(
    reference: PanTiltReference, polls: UnitPolls, rows: IntArray, axis: int
) -> tuple[FloatArray, BoolArray, BoolArray, BoolArray]:
    """Compare some counts of an axis with the commanded motion.

    Returns:
        Times; masks of moving, contradicting and known counts.
    """
    earliest_s = polls.earliest_s[rows]
    latest_s = polls.latest_s[rows]
    counted = polls.steps[rows, axis]
    time_s = np.maximum.accumulate((earliest_s + latest_s) / 2.0)
    slack_s = (latest_s - earliest_s) / 2.0 + MAX_START_ERROR_S
    planned = reference.angles_rad(time_s)[axis] / reference.rad_per_step[axis]
    known = np.ones(time_s.size, dtype=np.bool_)
    for begin, end, _ in reference.motion.unknown_spans:
        known &= (time_s < begin) | (time_s > end)
    moving = np.zeros(time_s.size, dtype=np.bool_)
    changed = np.diff(counted) != 0.0
    moving[1:] |= changed
    moving[:-1] |= changed
    speed = np.abs(_speed(counted, time_s)) + np.abs(_speed(planned, time_s))
    is_off = np.abs(counted - planned) > MAX_COUNT_ERROR_STEPS + speed * slack_s
    # A single garbled reply is ignored; two neighbours must contradict.
    is_off[1:-1] &= is_off[:-2] | is_off[2:]
    return time_s, moving, is_off, known


def _speed(steps: FloatArray, time_s: FloatArray) -> FloatArray:
    """Return the speed at each count, 0 if there are too few or all have the same time."""
    if time_s.size < 2:
        return np.zeros_like(steps)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.nan_to_num(np.gradient(steps, time_s), posinf=0.0, neginf=0.0)


def _read_polls(
    recording: Recording, metadata: Mapping[str, str], byte_s: float, origin_ns: int
) -> tuple[UnitPolls, tuple[int, int]]:
    """Return the usable polls, and the positions of both axes at the first one."""
    raw = recording.ptu_positions()
    usable = np.flatnonzero(raw["status"] & UNUSABLE_STATUS == 0)
    if usable.size < 2:
        raise InputError(
            f"the recording {recording.path.name} needs two or more usable positions of the "
            f"pan-tilt unit, but contains only {usable.size}",
            "if the rig file sets a low `rate_hz` under `ptu: poll`, remove this key. Then record "
            "again",
        )
    request_ns = times_ns(raw["request_time"])[usable]
    if np.any(request_ns[1:] < request_ns[:-1]):
        usable = usable[np.argsort(request_ns, kind="stable")]
    request, first = (
        (times_ns(raw[name])[usable] - origin_ns) * 1e-9
        for name in ("request_time", "first_byte_time")
    )
    # The unit samples after it has received the query and before its reply begins.
    query_bytes = _finite_number(metadata, "poll_bytes") or QUERY_BYTES
    earliest: FloatArray = np.asarray(request + query_bytes * byte_s, dtype=np.float64)
    latest: FloatArray = np.asarray(np.maximum(first - byte_s, earliest), dtype=np.float64)
    status = raw["status"][usable]
    bits = (PtuStatus.PAN_ANSWERED, PtuStatus.TILT_ANSWERED)
    valid = np.column_stack([status & bit != 0 for bit in bits])
    steps = np.empty((usable.size, 2))
    steps[:, 0], steps[:, 1] = raw["pan_steps"][usable], raw["tilt_steps"][usable]
    for axis, name in enumerate(AXES):
        if not _has_axis(metadata, name):  # the axis stays at 0
            valid[:, axis], steps[:, axis] = True, 0.0
    polls = UnitPolls(earliest, latest, steps, valid)
    polls = _use_controller_counter(
        polls, raw["controller_time"][usable].astype(np.int64), metadata
    )
    at_rest = []
    for axis, name in enumerate(AXES):
        answered = np.flatnonzero(polls.valid[:, axis])
        if answered.size == 0:
            raise InputError(
                f"the pan-tilt unit never replied with its {name} position",
                "check with `gyrorigd doctor` that the unit replies, and record again",
            )
        at_rest.append(int(polls.steps[answered[0], axis]))
    return polls, (at_rest[0], at_rest[1])


def _finite_number(metadata: Mapping[str, str], key: str) -> float | None:
    """Return an entry as a finite number, None if it is missing.

    Raises:
        InputError: the entry is not a finite number.
    """
    text = metadata.get(key, "")
    if not text:
        return None
    value = decimal_number(text)
    if value is None or abs(value) > _MAX_SETTING:
        raise InputError(
            f"the value {text[:40]!r} of the unit's setting {key} in the recording is not a number "
            f"of at most {_MAX_SETTING:g}",
            "copy the recording again from the rig, or record again",
        )
    return value


def _has_axis(metadata: Mapping[str, str], name: str) -> bool:
    """Return whether the unit has an axis; an old recording does not state its axes."""
    return name in metadata.get("axes", " ".join(AXES)).split()


def _byte_s(metadata: Mapping[str, str]) -> float:
    """Return the transmission time of a byte on the serial line of the unit."""
    baud = _finite_number(metadata, "baud") or FACTORY_BAUD
    if baud < 0.0:
        raise InputError(
            f"the recording states {baud:g} as the baud rate of the pan-tilt unit, but a baud rate "
            "is above 0",
            "copy the recording again from the rig, or record again",
        )
    return BITS_PER_BYTE / baud


def _use_controller_counter(
    polls: UnitPolls, ticks: IntArray, metadata: Mapping[str, str]
) -> UnitPolls:
    """Return the polls with instants from the controller's counter, if it has one."""
    counter_hz = _finite_number(metadata, "counter_hz") or 0.0
    if not (counter_hz > 0.0 and np.all(ticks >= 0)):
        return polls
    instants = counter_instants(ticks, polls.earliest_s, polls.latest_s, counter_hz)
    if instants is None:
        return polls
    return replace(
        polls, earliest_s=instants.at_s, latest_s=instants.at_s, constant_width_s=instants.width_s
    )


def _rad_per_step(recording: Recording, metadata: Mapping[str, str], axis: str) -> float:
    """Return rad per step with the sign of the unit, from the angles in the recording."""
    raw = recording.ptu_positions()
    farthest = int(np.argmax(np.abs(raw[f"{axis}_steps"].astype(np.int64))))
    steps, angle = int(raw[f"{axis}_steps"][farthest]), float(raw[axis][farthest])
    if steps != 0 and np.isfinite(angle) and angle != 0.0:
        return angle / steps
    if not _has_axis(metadata, axis):
        return FIXED_AXIS_RAD
    arcsec = _finite_number(metadata, f"{axis}_resolution_arcsec")
    if not arcsec:
        raise InputError(
            f"the step size of the {axis} axis is unknown, because the recording lacks the value "
            f"{axis}_resolution_arcsec, and all its {axis} angles are 0",
            "record again with gyrorigd, which reads the step size from the unit",
        )
    return float(np.radians(arcsec / 3600.0))


def _settings(metadata: Mapping[str, str]) -> dict[str, float]:
    """Return the numeric settings that define a move."""
    settings = {}
    for axis in AXES:
        for kind in ("base_speed", "acceleration", "speed", "min_steps", "max_steps"):
            value = _finite_number(metadata, f"{axis}_{kind}")
            if value is not None:
                settings[f"{axis}_{kind}"] = value
    return settings


def _mark_contradictions(motion: UnitMotion, polls: UnitPolls) -> UnitMotion:
    """Mark rests as unknown if their counts contradict the target."""
    unknown_spans = list(motion.unknown_spans)
    table = MoveTable.of(motion)
    trajectories = build_trajectories(table, table.commanded_parameters)
    for axis, trajectory in enumerate(trajectories):
        axis_moves = table.moves_of_axis[axis]
        if axis_moves.size == 0:
            continue
        command_s = table.command_times_s[table.first_command[axis_moves]]
        until_s = np.append(command_s[1:], np.inf)
        poll_rows = np.flatnonzero(polls.valid[:, axis])
        move = np.searchsorted(command_s, polls.earliest_s[poll_rows], side="right") - 1
        poll_rows, move = poll_rows[move >= 0], move[move >= 0]
        resting = polls.earliest_s[poll_rows] > trajectory.end_s[move] + REST_DELAY_S
        resting &= polls.latest_s[poll_rows] < until_s[move]
        poll_rows, move = poll_rows[resting], move[resting]
        count_error = np.abs(polls.steps[poll_rows, axis] - table.to_steps[axis_moves[move]])
        for k in np.flatnonzero(grouped_median(count_error, move, axis_moves.size) > 1.0):
            last_s = until_s[k] if np.isfinite(until_s[k]) else polls.latest_s[-1]
            unknown_spans.append(
                (float(command_s[k]), float(last_s), "the unit did not reach its target")
            )
    return replace(motion, unknown_spans=tuple(unknown_spans))
