"""From a recording's exchanges with the unit to the reference motion."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.messages import PtuStatus
from gyrorig_protocol.recording.recording import Recording, times_ns
from gyrorig_solver.arrays import BoolArray, FloatArray, IntArray
from gyrorig_solver.reference.counted import CountedReference, counted_reference
from gyrorig_solver.reference.counter import counter_instants
from gyrorig_solver.reference.evidence import AT_ONCE, grouped_median
from gyrorig_solver.reference.moves import AXES, Exchange, Motion, MotionReader
from gyrorig_solver.reference.polls import Polls, fit_starts
from gyrorig_solver.reference.ptu import PtuReference
from gyrorig_solver.reference.table import MoveTable
from gyrorig_solver.reference.track import lay_tracks

OUT_OF_STEP = PtuStatus.SYNCHRONY_LOST | PtuStatus.HOMING  # what such a poll says is no angle
FACTORY_BAUD = 9600.0
BITS_PER_BYTE = 10  # 8N1
QUERY_BYTES = 3  # `BT ` or `PP `
OK = 0
MOST_UNEXPLAINED = 0.5  # of the counts on the way: then the counts alone tell more
MOST_STEPS_OFF = 4.0  # the count's own step, its lag, and some for a start
WIDEST_STARTS_S = 0.005  # a start that was not polled
SETTLED_AFTER_S = 1.0  # after the told end of a move
REACH = 3  # neighbours that the judgement of a count may look at
MARGIN_S = 0.3  # about an answer that the commands do not explain


def ptu_reference(recording: Recording, origin_ns: int) -> PtuReference | CountedReference:
    """Return the unit's motion as it was told and polled.

    Where most of what it counted on its way is not what it was told, the counts alone.

    Args:
        recording: with `/ptu/position`, `/ptu/command` and the metadata `gyrorig.ptu`.
        origin_ns: capture time that counts as 0 s.

    Raises:
        InputError: there are too few polls, or the metadata lack what a move is made of.
    """
    metadata = recording.metadata.get("gyrorig.ptu", {})
    byte_s = _byte_s(metadata)
    polls, steps = _polls(recording, metadata, byte_s, origin_ns)
    rad_per_step = (
        _resolution(recording, metadata, "pan"),
        _resolution(recording, metadata, "tilt"),
    )
    exchanges = [
        Exchange(
            # It cannot act before its last byte, the delimiter, has arrived.
            (c.request_time_ns - origin_ns) * 1e-9 + (len(c.command.strip()) + 1) * byte_s,
            (c.reply_time_ns - origin_ns) * 1e-9,
            c.code == OK,
            c.command,
        )
        for c in recording.ptu_commands()
    ]
    motion = MotionReader(_settings(metadata), steps, polls.resting).read(exchanges)
    return explained_reference(_checked(motion, polls), polls, rad_per_step)


def explained_reference(
    motion: Motion, polls: Polls, rad_per_step: tuple[float, float]
) -> PtuReference | CountedReference:
    """Return the told motion where it explains the counts, else the counted one.

    A stretch that the told motion does not explain is left out, unless most are such.
    """
    span = (float(polls.lo_s[0]), float(polls.hi_s[-1]))
    reference = PtuReference.of(motion, fit_starts(motion, polls), rad_per_step, span)
    left_out, share = unexplained(reference, polls)
    if share > MOST_UNEXPLAINED:
        why = "the commands do not explain how the unit moved"
        return counted_reference(polls, rad_per_step, why if motion.moves else "no move was told")
    if not left_out:
        return reference
    why = "the counts do not follow the commands"
    lost = tuple((begin, end, why) for begin, end in left_out)
    return replace(reference, motion=replace(motion, unknown=(*motion.unknown, *lost)))


def unexplained(reference: PtuReference, polls: Polls) -> tuple[list[tuple[float, float]], float]:
    """Return where the counts leave the told motion, and the share of moving counts there.

    Times that the commands leave unknown count as unexplained too.
    """
    spans: list[tuple[float, float]] = []
    moving_count = lost_count = 0
    for axis in (0, 1):
        use = np.flatnonzero(polls.valid[:, axis])
        found = [np.zeros(0)]
        for begin in range(0, use.size, AT_ONCE):
            # A count is judged together with its neighbours.
            first, last = max(0, begin - REACH), begin + AT_ONCE + REACH
            own = slice(begin - first, begin - first + AT_ONCE)
            time_s, moving, off, known = _judged(reference, polls, use[first:last], axis)
            time_s, moving, off, known = time_s[own], moving[own], off[own], known[own]
            moving_count += int(moving.sum())
            lost_count += int(np.sum(moving & (off | ~known)))
            found.append(time_s[off & known])
        lost_s = np.concatenate(found)
        # Two answers within the margins of each other leave nothing between them.
        new = np.flatnonzero(np.diff(lost_s, prepend=-np.inf) >= 3.0 * MARGIN_S)
        last_of = np.append(new, lost_s.size)[1:] - 1
        spans += [
            (float(lost_s[a]) - MARGIN_S, float(lost_s[b]) + MARGIN_S)
            for a, b in zip(new, last_of, strict=True)
        ]
    return spans, lost_count / max(1, moving_count)


def _judged(
    reference: PtuReference, polls: Polls, which: IntArray, axis: int
) -> tuple[FloatArray, BoolArray, BoolArray, BoolArray]:
    """Return when some counts of an axis were taken, and what they say of the told motion.

    Returns:
        Times; whether the axis moved; whether it was elsewhere; whether that is known.
    """
    lo_s, hi_s, counted = polls.lo_s[which], polls.hi_s[which], polls.steps[which, axis]
    time_s = np.maximum.accumulate((lo_s + hi_s) / 2.0)
    slack_s = (hi_s - lo_s) / 2.0 + WIDEST_STARTS_S
    told = reference.angles_rad(time_s)[axis] / reference.rad_per_step[axis]
    known = np.ones(time_s.size, dtype=np.bool_)
    for begin, end, _ in reference.motion.unknown:
        known &= (time_s < begin) | (time_s > end)
    moving = np.zeros(time_s.size, dtype=np.bool_)
    changed = np.diff(counted) != 0.0
    moving[1:] |= changed
    moving[:-1] |= changed
    speed = np.abs(_speed(counted, time_s)) + np.abs(_speed(told, time_s))
    off = np.abs(counted - told) > MOST_STEPS_OFF + speed * slack_s
    # One garbled answer is no motion; it takes two neighbours.
    off[1:-1] &= off[:-2] | off[2:]
    return time_s, moving, off, known


def _speed(steps: FloatArray, time_s: FloatArray) -> FloatArray:
    """Return the speed at each count, 0 where there are too few or they are one instant."""
    if time_s.size < 2:
        return np.zeros_like(steps)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.nan_to_num(np.gradient(steps, time_s), posinf=0.0, neginf=0.0)


def _polls(
    recording: Recording, metadata: Mapping[str, str], byte_s: float, origin_ns: int
) -> tuple[Polls, tuple[int, int]]:
    """Return the polls that may be used, and where both axes stood at the first."""
    raw = recording.ptu_positions()
    kept = np.flatnonzero(raw["status"] & OUT_OF_STEP == 0)
    if kept.size < 2:
        raise InputError(
            f"{recording.path.name} has {kept.size} positions of the unit, and two are needed",
            "leave out ptu: poll: rate_hz in the rig file, so that the daemon asks often, and "
            "record again",
        )
    request_ns = times_ns(raw["request_time"])[kept]
    if np.any(request_ns[1:] < request_ns[:-1]):
        kept = kept[np.argsort(request_ns, kind="stable")]
    request, first = (
        (times_ns(raw[name])[kept] - origin_ns) * 1e-9
        for name in ("request_time", "first_byte_time")
    )
    # The unit cannot sample before it has the query, nor after its answer has begun.
    lo: FloatArray = np.asarray(request + QUERY_BYTES * byte_s, dtype=np.float64)
    hi: FloatArray = np.asarray(np.maximum(first - byte_s, lo), dtype=np.float64)
    status = raw["status"][kept]
    bits = (PtuStatus.PAN_ANSWERED, PtuStatus.TILT_ANSWERED)
    valid = np.column_stack([status & bit != 0 for bit in bits])
    steps = np.empty((kept.size, 2))
    steps[:, 0], steps[:, 1] = raw["pan_steps"][kept], raw["tilt_steps"][kept]
    polls = Polls(lo, hi, steps, valid)
    polls = _by_counter(polls, raw["controller_time"][kept].astype(np.int64), metadata)
    at_rest = []
    for axis, name in enumerate(AXES):
        answered = np.flatnonzero(polls.valid[:, axis])
        if answered.size == 0:
            raise InputError(
                f"the unit never answered its {name} position",
                "`gyrorigd doctor` says whether it does now; then record again",
            )
        at_rest.append(int(polls.steps[answered[0], axis]))
    return polls, (at_rest[0], at_rest[1])


def _number(metadata: Mapping[str, str], key: str) -> float | None:
    """Return an entry as a finite number, None where there is none.

    Raises:
        InputError: the entry is there and is no such number.
    """
    text = metadata.get(key, "")
    if not text:
        return None
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise InputError(
            f"the recording says {key} {text[:40]!r} of the unit, which is no finite number",
            "copy it again from the rig, or record again",
        )
    return value


def _byte_s(metadata: Mapping[str, str]) -> float:
    """Return how long a byte takes on the unit's line."""
    baud = _number(metadata, "baud") or FACTORY_BAUD
    if baud < 0.0:
        raise InputError(
            f"the recording says baud {baud:g} of the unit, which is below 0",
            "copy it again from the rig, or record again",
        )
    return BITS_PER_BYTE / baud


def _by_counter(polls: Polls, ticks: IntArray, metadata: Mapping[str, str]) -> Polls:
    """Return the polls with their instants from the controller's counter, where it has one."""
    counter_hz = _number(metadata, "counter_hz") or 0.0
    if not (counter_hz > 0.0 and np.all(ticks >= 0)):
        return polls
    found = counter_instants(ticks, polls.lo_s, polls.hi_s, counter_hz)
    if found is None:
        return polls
    return replace(polls, lo_s=found.at_s, hi_s=found.at_s, constant_width_s=found.width_s)


def _resolution(recording: Recording, metadata: Mapping[str, str], axis: str) -> float:
    """Return rad per step with the unit's sign, as the recording's own angles have it."""
    raw = recording.ptu_positions()
    far = int(np.argmax(np.abs(raw[f"{axis}_steps"].astype(np.int64))))
    steps, angle = int(raw[f"{axis}_steps"][far]), float(raw[axis][far])
    if steps != 0 and np.isfinite(angle) and angle != 0.0:
        return angle / steps
    arcsec = _number(metadata, f"{axis}_resolution_arcsec")
    if not arcsec:
        raise InputError(
            f"the recording lacks the unit's {axis}_resolution_arcsec, and {axis} never left 0",
            "record again with gyrorigd, which asks the unit",
        )
    return float(np.radians(arcsec / 3600.0))


def _settings(metadata: Mapping[str, str]) -> dict[str, float]:
    """Return the numeric settings that a move is made of."""
    settings = {}
    for axis in AXES:
        for kind in ("base_speed", "acceleration", "speed", "min_steps", "max_steps"):
            value = _number(metadata, f"{axis}_{kind}")
            if value is not None:
                settings[f"{axis}_{kind}"] = value
    return settings


def _checked(motion: Motion, polls: Polls) -> Motion:
    """Mark what the polls contradict: a rest where the count is not the target's."""
    unknown = list(motion.unknown)
    table = MoveTable.of(motion)
    tracks = lay_tracks(table, table.as_told)
    for axis, track in enumerate(tracks):
        own = table.own[axis]
        if own.size == 0:
            continue
        told_s = table.told_s[table.first[own]]
        until_s = np.append(told_s[1:], np.inf)
        use = np.flatnonzero(polls.valid[:, axis])
        move = np.searchsorted(told_s, polls.lo_s[use], side="right") - 1
        use, move = use[move >= 0], move[move >= 0]
        resting = polls.lo_s[use] > track.end_s[move] + SETTLED_AFTER_S
        resting &= polls.hi_s[use] < until_s[move]
        use, move = use[resting], move[resting]
        off = np.abs(polls.steps[use, axis] - table.to_steps[own[move]])
        for k in np.flatnonzero(grouped_median(off, move, own.size) > 1.0):
            last_s = until_s[k] if np.isfinite(until_s[k]) else polls.hi_s[-1]
            unknown.append((float(told_s[k]), float(last_s), "the unit is not where it was sent"))
    return replace(motion, unknown=tuple(unknown))
