"""Motions of some seconds that form a program; each starts and ends at the home position.

Rests show effects that depend on time only. Sweeps at several speeds show effects that grow with
the rate, its square or its cube. Sweeps at several tilts show effects that depend on the pose.
Reversals and stairs show errors of the gears, and moves of both axes show vibrations.

What to use when: `motion_blocks` for all blocks that fit the unit; `program_of_blocks` for a
program.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import repeat

from gyrorig_protocol.program import MotionProgram, PtuSettings, Rest, Step
from gyrorig_solver.plan.program_family import MotionSpace, moves_between

STATIC_S = 2.0  # at each end of a program
# at each end of a block that is evaluated alone; shorter than the rests within a block
BLOCK_STATIC_S = 0.3
DWELL_S = 0.3  # after each move, so that the mechanics ring down
STAIR_DWELL_S = 1.0
REST_LENGTHS_S = (20.0, 50.0, 80.0, 110.0)
SPEED_SHARES = (1.0, 0.55, 0.25, 0.1)
MIN_SPEED_DEG_S = 2.0
MAX_SWEEP_S = 5.0  # one way; a slower sweep is shorter
PASSES = (1, 4)  # to both ends
REVERSALS, REVERSAL_DEG = 6, 15.0
STAIRS = 7

Pose = tuple[float, float]  # pan and tilt, deg


@dataclass(frozen=True, slots=True)
class MotionBlock:
    """One motion with its description."""

    name: str
    steps: tuple[Step, ...]
    is_rest: bool = False  # it comes first in a program, when the board is coldest


def motion_blocks(space: MotionSpace) -> tuple[MotionBlock, ...]:
    """Return all blocks within a unit's angles and speeds."""
    return tuple(_blocks(space))


def program_of_blocks(
    blocks: Sequence[MotionBlock],
    space: MotionSpace,
    settings: PtuSettings,
    name: str,
    static_s: float = STATIC_S,
) -> MotionProgram:
    """Return the program of some blocks in sequence, rests first.

    Args:
        blocks: of the space.
        space: whose home the program enters first.
        settings: of the unit.
        name: of the program.
        static_s: rest at the beginning and at the end.
    """
    static = Step(rest=Rest(static_s, "static"))
    ordered = sorted(blocks, key=lambda block: not block.is_rest)
    steps = (step for block in ordered for step in block.steps)
    enter = space.enter_steps(DWELL_S)
    return MotionProgram(name, (static, *enter, *steps, static), settings=settings)


def _blocks(space: MotionSpace) -> Iterator[MotionBlock]:
    yield from _rests(space)
    for passes in PASSES:
        yield from _sweeps(space, passes)
    yield from _reversals(space)
    yield from _stairs(space)


def _rests(space: MotionSpace) -> Iterator[MotionBlock]:
    """Yield rests, each with a short move, so that every program has a motion."""
    swing = _path(space, [(_limited(space.pan_deg, 30.0), space.home.tilt_deg)], 1.0)
    for length_s in REST_LENGTHS_S:
        rest = Step(rest=Rest(length_s, "static"))
        yield MotionBlock(f"rest of {length_s:g} s", (rest, *swing), is_rest=True)


def _sweeps(space: MotionSpace, passes: int) -> Iterator[MotionBlock]:
    """Yield sweeps of pan at three tilts, of tilt, and of both axes together."""
    home = space.home
    for share in SPEED_SHARES:
        pan_ends = _ends(space.pan_deg, MAX_SWEEP_S * share * space.pan_speed_deg_s)
        tilt_ends = _ends(space.tilt_deg, MAX_SWEEP_S * share * space.tilt_speed_deg_s)
        speed_words = f"at {share * space.pan_speed_deg_s:.0f} deg/s"
        for tilt in (home.tilt_deg, *space.tilt_deg):
            points = [(home.pan_deg, tilt), *((pan, tilt) for pan in pan_ends * passes)]
            yield MotionBlock(
                f"pan sweeps {speed_words}, tilt {tilt:.0f} deg, {passes} times",
                _path(space, [*points, (home.pan_deg, tilt)], share),
            )
        yield MotionBlock(
            f"tilt sweeps {speed_words}, {passes} times",
            _path(space, [(home.pan_deg, tilt) for tilt in tilt_ends * passes], share),
        )
        # Pan turns by the same angle as tilt, so that both axes move all the time.
        near_ends = _ends(space.pan_deg, abs(tilt_ends[0] - tilt_ends[1]))
        diagonals = list(zip(near_ends, tilt_ends, strict=True)) * passes
        yield MotionBlock(
            f"moves of both axes {speed_words}, {passes} times", _path(space, diagonals, share)
        )


def _reversals(space: MotionSpace) -> Iterator[MotionBlock]:
    home = (space.home.pan_deg, space.home.tilt_deg)
    near = (
        (_limited(space.pan_deg, home[0] + REVERSAL_DEG), home[1]),
        (home[0], _limited(space.tilt_deg, home[1] + REVERSAL_DEG)),
    )
    for name, pose in zip(("pan", "tilt"), near, strict=True):
        yield MotionBlock(f"{name} reversals", _path(space, [pose, home] * REVERSALS, 1.0))


def _stairs(space: MotionSpace) -> Iterator[MotionBlock]:
    """Yield rests over the range of each axis, reached from one direction."""
    shares = [k / (STAIRS - 1) for k in range(STAIRS)]
    pans, tilts = (
        [low + (high - low) * share for share in shares]
        for low, high in (space.pan_deg, space.tilt_deg)
    )
    for name, poses in (
        ("pan", [(pan, space.home.tilt_deg) for pan in pans]),
        ("tilt", [(space.home.pan_deg, tilt) for tilt in tilts]),
    ):
        yield MotionBlock(f"{name} stairs", _path(space, poses, 1.0, STAIR_DWELL_S))


def _path(
    space: MotionSpace, points: Sequence[Pose], speed_share: float, dwell_s: float = DWELL_S
) -> tuple[Step, ...]:
    """Return moves from home through some poses and back home, with a rest after each."""
    home = (space.home.pan_deg, space.home.tilt_deg)
    speeds = (
        _speed(space.pan_speed_deg_s, speed_share),
        _speed(space.tilt_speed_deg_s, speed_share),
    )
    poses = [(round(pan, 1), round(tilt, 1)) for pan, tilt in (home, *points, home)]
    return moves_between(poses, repeat(speeds), dwell_s)


def _speed(fastest_deg_s: float, share: float) -> float:
    return min(fastest_deg_s, max(MIN_SPEED_DEG_S, int(fastest_deg_s * share * 10.0) / 10.0))


def _limited(limits: tuple[float, float], angle_deg: float) -> float:
    return min(max(angle_deg, limits[0]), limits[1])


def _ends(limits: tuple[float, float], span_deg: float) -> list[float]:
    """Return both ends of a span about 0, moved or cut to the limits."""
    span_deg = min(span_deg, limits[1] - limits[0])
    high = _limited((limits[0] + span_deg, limits[1]), span_deg / 2.0)
    return [high, high - span_deg]
