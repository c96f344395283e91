"""From a recording's exchanges with the unit to the reference motion."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.recording import Recording, times_ns
from gyrorig_solver.arrays import FloatArray, IntArray
from gyrorig_solver.reference.counter import counter_instants
from gyrorig_solver.reference.moves import AXES, Exchange, Motion, MotionReader
from gyrorig_solver.reference.polls import Polls, fit_starts
from gyrorig_solver.reference.ptu import PtuReference

PAN_VALID, TILT_VALID, SYNCHRONY_LOST, HOMING = 1 << 0, 1 << 1, 1 << 2, 1 << 3
BITS_PER_BYTE = 10  # 8N1
QUERY_BYTES = 3  # `BT ` or `PP `
OK = 0


def ptu_reference(recording: Recording, origin_ns: int) -> PtuReference:
    """Return the unit's motion as it was told and polled.

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
    span = (float(polls.lo_s[0]), float(polls.hi_s[-1]))
    motion = _checked(motion, polls)
    return PtuReference.of(motion, fit_starts(motion, polls), rad_per_step, span)


def _polls(
    recording: Recording, metadata: Mapping[str, str], byte_s: float, origin_ns: int
) -> tuple[Polls, tuple[int, int]]:
    """Return the polls that may be used, and where both axes stood at the first."""
    raw = recording.ptu_positions()
    raw = raw[raw["status"] & (HOMING | SYNCHRONY_LOST) == 0]
    if raw.size < 2:
        raise InputError(
            f"{recording.path.name} has {raw.size} positions of the unit", "record with polling on"
        )
    request = (times_ns(raw["request_time"]) - origin_ns) * 1e-9
    first = (times_ns(raw["first_byte_time"]) - origin_ns) * 1e-9
    # The unit cannot sample before it has the query, nor after its answer has begun.
    lo: FloatArray = np.asarray(request + QUERY_BYTES * byte_s, dtype=np.float64)
    hi: FloatArray = np.asarray(np.maximum(first - byte_s, lo), dtype=np.float64)
    valid = np.column_stack([raw["status"] & PAN_VALID != 0, raw["status"] & TILT_VALID != 0])
    steps = np.column_stack([raw["pan_steps"], raw["tilt_steps"]]).astype(np.float64)
    order = np.argsort(lo, kind="stable")
    polls = Polls(lo[order], hi[order], steps[order], valid[order])
    polls = _by_counter(polls, raw["controller_time"][order].astype(np.int64), metadata)
    at_rest = []
    for axis, name in enumerate(AXES):
        answered = np.flatnonzero(polls.valid[:, axis])
        if answered.size == 0:
            raise InputError(f"the unit never answered its {name} position", "record again")
        at_rest.append(int(polls.steps[answered[0], axis]))
    return polls, (at_rest[0], at_rest[1])


def _byte_s(metadata: Mapping[str, str]) -> float:
    """Return how long a byte takes on the unit's line."""
    try:
        return BITS_PER_BYTE / float(metadata.get("baud", "9600"))
    except (ValueError, ZeroDivisionError) as fault:
        raise InputError("metadata baud is no number", "the recording is damaged") from fault


def _by_counter(polls: Polls, ticks: IntArray, metadata: Mapping[str, str]) -> Polls:
    """Return the polls with their instants from the controller's counter, where it has one."""
    text = metadata.get("counter_hz", "")
    try:
        counter_hz = float(text or 0.0)
    except ValueError as fault:
        raise InputError(f"metadata counter_hz is {text[:40]!r}", "it must be a number") from fault
    if not (np.isfinite(counter_hz) and counter_hz > 0.0 and np.all(ticks >= 0)):
        return polls
    found = counter_instants(ticks, polls.lo_s, polls.hi_s, counter_hz)
    if found is None:
        return polls
    return replace(polls, lo_s=found.at_s, hi_s=found.at_s, constant_width_s=found.width_s)


def _resolution(recording: Recording, metadata: Mapping[str, str], axis: str) -> float:
    """Return rad per step with the unit's sign, as the recording's own angles have it."""
    raw = recording.ptu_positions()
    far = int(np.argmax(np.abs(raw[f"{axis}_steps"].astype(np.int64))))
    if raw[f"{axis}_steps"][far] != 0:
        return float(raw[axis][far] / raw[f"{axis}_steps"][far])
    try:
        return float(np.radians(float(metadata[f"{axis}_resolution_arcsec"]) / 3600.0))
    except (KeyError, ValueError) as fault:
        raise InputError(f"metadata lack {axis}_resolution_arcsec", "record again") from fault


def _settings(metadata: Mapping[str, str]) -> dict[str, float]:
    """Return the numeric settings that a move is made of."""
    settings = {}
    for axis in AXES:
        for kind in ("base_speed", "acceleration", "speed", "min_steps", "max_steps"):
            text = metadata.get(f"{axis}_{kind}")
            if text is None:
                continue
            try:
                settings[f"{axis}_{kind}"] = float(text)
            except ValueError as fault:
                raise InputError(
                    f"metadata {axis}_{kind} is {text[:40]!r}", "it must be a number"
                ) from fault
    return settings


def _checked(motion: Motion, polls: Polls) -> Motion:
    """Mark what the polls contradict: a rest where the count is not the target's."""
    unknown = list(motion.unknown)
    still = np.zeros(motion.classes)
    for axis in (0, 1):
        own = [m for m in motion.moves if m.axis == axis]
        for move, following in zip(own, [*own[1:], None], strict=False):
            begin = move.course(move.starts_s, still, 0.0).end_s + 1.0
            end = following.told_s if following else np.inf
            resting = (polls.lo_s > begin) & (polls.hi_s < end) & polls.valid[:, axis]
            counts = polls.steps[resting, axis]
            if counts.size and np.median(np.abs(counts - move.to_steps)) > 1.0:
                last = end if np.isfinite(end) else float(polls.hi_s[-1])
                unknown.append((move.told_s, last, "the unit is not where it was sent"))
    return replace(motion, unknown=tuple(unknown))
