"""The two families of programs that the planner searches.

A round visits the tilt poses from the lowest to the highest and back. At each pose, pan sweeps
`passes` times over its span, and tilt can swing to the far end and back. On the way to the next
pose, pan can move together with tilt. At the end of a round, pan can weave: it moves over its span
and back in parts, and tilt moves to and fro with each part. A cycle consists of a round and the
same round with pan mirrored. Each rate then occurs with both signs, so that no gain error looks
like a bias. Cycles repeat.

A stay (`once`) visits each pose once and makes all its sweeps there. The sweeps go from the middle
of pan's span to an end and back, to both ends in turn. A quantisation error at a rest between two
sweeps at the same tilt does not change the mean rate, and therefore not the bias; between sweeps at
different tilts it does. To separate causes, a stay can have several speeds and end at the first
pose again. Every move ends in a short rest.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.program import MotionProgram, Move, PtuSettings, Repeat, Rest, Step
from gyrorig_solver.plan.program_timeline import simulate_program
from gyrorig_solver.plan.unit_model import UnitModel

# Low, so that moves have ramps; a unit jumps to its base speed at once, and the jump makes it ring.
BASE_SPEED_DEG_S = 3.0
STATIC_S = 2.0  # minimum at each end, for the noise at rest and the first polls
LIMIT_MARGIN_DEG = 1.0  # from the unit's limits, which homing moves by about a step

# The choices of each field. With two poses, the calibration absorbs a non-orthogonality of the axes
# completely; the total uncertainty shows the cost of that. Accelerations are at most those of the
# programs made by hand; a dwell of 0.3 s lets the mechanics ring down (10 to 60 Hz, Q 5 to 20).
CHOICES: dict[str, tuple[float, ...]] = {
    "poses": (2, 3, 4, 5),
    "passes": (0, 1, 2, 3, 4),
    "swings": (0, 1, 2, 3, 4),
    "along": (False, True),
    "weave": (0, 2, 4, 6),
    "pan_span": (0.25, 0.4, 0.55, 0.7, 0.85, 1.0),
    "tilt_span": (0.4, 0.6, 0.8, 1.0),
    "pan_speed": (0.4, 0.6, 0.8, 1.0),
    "tilt_speed": (0.4, 0.6, 0.8, 1.0),
    "acceleration_deg_s2": (100.0, 150.0, 200.0),
    "dwell_s": (0.3, 0.5, 0.8),
}
# Fields that a stay does not use.
ROUND_ONLY_DEFAULTS: dict[str, float] = {"along": False, "weave": 0}

# Speeds of a stay's sweeps and swings, in turn, relative to the speeds of the design: the fastest
# one, and three that separate the square and the cube of a rate.
SPEED_LADDER = (1.0, 0.6, 0.35, 0.2)

Steps = tuple[Step, ...]


class Waypoint(NamedTuple):
    """The target of a move, and its share of the design's speeds."""

    pan_deg: float
    tilt_deg: float
    speed_share: float = 1.0


@dataclass(frozen=True, slots=True)
class MotionSpace:
    """The angle ranges and speeds of a program."""

    pan_deg: tuple[float, float]
    tilt_deg: tuple[float, float]
    pan_speed_deg_s: float
    tilt_speed_deg_s: float
    slowest_deg_s: float = 0.0  # of both axes

    @classmethod
    def of(cls, unit: UnitModel, fastest_deg_s: float) -> "MotionSpace":
        """Return the motion space of a unit; `fastest_deg_s` is the sensor's limit."""
        spans = []
        for axis in unit.axes:
            margin = min(LIMIT_MARGIN_DEG, (axis.high_deg - axis.low_deg) / 10.0)
            spans.append((axis.low_deg + margin, axis.high_deg - margin))
        # Rounded down to one decimal, as a person would write them.
        fast = [int(min(axis.fastest_deg_s, fastest_deg_s) * 10.0) / 10.0 for axis in unit.axes]
        slowest = max(math.ceil(axis.slowest_deg_s * 10.0) / 10.0 for axis in unit.axes)
        return cls(spans[0], spans[1], fast[0], fast[1], min(slowest, *fast))

    @property
    def home(self) -> Waypoint:
        """The allowed waypoint nearest to pan 0, tilt 0."""
        pan, tilt = (min(max(0.0, low), high) for low, high in (self.pan_deg, self.tilt_deg))
        return Waypoint(pan, tilt)

    def enter_steps(self, dwell_s: float) -> "Steps":
        """Return the move from pan 0, tilt 0 to home, with a rest; none if home is there.

        A session begins where the unit is, usually at 0, which can be outside the rig's limits.
        """
        if self.home[:2] == (0.0, 0.0):
            return ()
        move = Move(
            pan_deg=self.home.pan_deg,
            tilt_deg=self.home.tilt_deg,
            pan_speed_deg_s=self.pan_speed_deg_s,
            tilt_speed_deg_s=self.tilt_speed_deg_s,
        )
        return Step(move=move), Step(rest=Rest(dwell_s))

    def limited_speed(self, speed_deg_s: float) -> float:
        """Return a speed with one decimal, at least the slowest one."""
        return max(self.slowest_deg_s, round(speed_deg_s, 1))


@dataclass(frozen=True, slots=True)
class ProgramDesign:
    """One member of the family; spans and speeds are fractions of the motion space."""

    poses: int  # of tilt, evenly spaced from the lowest to the highest
    passes: int  # of pan, at each pose; of a stay: there and back
    swings: int  # of tilt alone, there and back, at each pose
    along: bool  # pan also moves on the way to the next pose
    weave: int  # parts of pan's way in which tilt moves to and fro; 0: no weave
    pan_span: float
    tilt_span: float
    pan_speed: float
    tilt_speed: float
    acceleration_deg_s2: float
    dwell_s: float
    once: bool = False  # a stay
    speeds: int = 1  # of a stay's sweeps and swings, from `SPEED_LADDER`
    again: bool = False  # the stay ends at the first pose

    @property
    def is_valid(self) -> bool:
        """False if pan would never move."""
        return self.passes > 0 or self.along or self.weave > 0

    def settings(self, space: MotionSpace) -> PtuSettings:
        """Return the unit settings, which are sent before the first move."""
        return PtuSettings(
            base_speed_deg_s=min(BASE_SPEED_DEG_S, space.pan_speed_deg_s, space.tilt_speed_deg_s),
            acceleration_deg_s2=self.acceleration_deg_s2,
            default_speed_deg_s=space.limited_speed(self.pan_speed * space.pan_speed_deg_s),
        )

    def start_waypoint(self, space: MotionSpace) -> Waypoint:
        """Return the waypoint at which a cycle, or all sweeps, start and end."""
        return self._waypoint(0.0 if self.once else -1.0, -1.0, space)

    def round_waypoints(self, space: MotionSpace) -> tuple[Waypoint, ...]:
        """Return the waypoints of a round, from one end of pan to the other."""
        return tuple(self._waypoint(pan, tilt, space) for pan, tilt in self._round_path())

    def cycle_waypoints(
        self, space: MotionSpace, max_points: int | None = None
    ) -> tuple[Waypoint, ...]:
        """Return the waypoints of a whole or a shortened cycle; the last equals the first."""
        path = self._round_path()[:max_points]
        mirrored = [(-pan, tilt) for pan, tilt in path]
        waypoints = [self._waypoint(pan, tilt, space) for pan, tilt in (*path, *mirrored, path[0])]
        return tuple(
            waypoint
            for k, waypoint in enumerate(waypoints)
            if k == 0 or waypoint != waypoints[k - 1]
        )

    def stay_waypoints(self, space: MotionSpace) -> tuple[tuple[Waypoint, ...], ...]:
        """Return the waypoints that repeat at each pose; each list ends where it starts."""
        stays = []
        for level in (*self._tilt_levels(), *([-1.0] if self.again else [])):
            far_end = -1.0 if level > 0.0 else 1.0
            points = [(0.0, level, 1.0)]
            for k in range(self.passes):
                # A slower sweep is shorter, so that all sweeps last about equally long.
                speed_share = SPEED_LADDER[k % self.speeds]
                pan_end = speed_share * (-1.0 if k // self.speeds % 2 != k % 2 else 1.0)
                points += [(pan_end, level, speed_share), (0.0, level, speed_share)]
            for k in range(self.swings):
                speed_share = SPEED_LADDER[k % self.speeds]
                points += [(0.0, far_end, speed_share), (0.0, level, speed_share)]
            stays.append(
                tuple(
                    self._waypoint(pan, tilt, space, speed_share)
                    for pan, tilt, speed_share in points
                )
            )
        return tuple(stays)

    def motion_steps(self, waypoints: Sequence[Waypoint], space: MotionSpace) -> Steps:
        """Return moves from the first waypoint through all others, with a rest after each."""
        pan_speed = self.pan_speed * space.pan_speed_deg_s
        tilt_speed = self.tilt_speed * space.tilt_speed_deg_s
        speeds = (
            (
                space.limited_speed(pan_speed * point.speed_share),
                space.limited_speed(tilt_speed * point.speed_share),
            )
            for point in waypoints[1:]
        )
        return moves_between([waypoint[:2] for waypoint in waypoints], speeds, self.dwell_s)

    def lead_steps(self, space: MotionSpace) -> tuple[Steps, Steps]:
        """Return the moves to the start, and back home; pan moves only at the tilt of home."""
        start = self.start_waypoint(space)
        outward = (space.home, Waypoint(start.pan_deg, space.home.tilt_deg), start)
        lead = (*space.enter_steps(self.dwell_s), *self.motion_steps(outward, space))
        return lead, self.motion_steps(outward[::-1], space)[:-1]

    def _waypoint(
        self, pan: float, tilt: float, space: MotionSpace, speed_share: float = 1.0
    ) -> Waypoint:
        return Waypoint(
            _position_in_range(space.pan_deg, pan * self.pan_span),
            _position_in_range(space.tilt_deg, tilt * self.tilt_span),
            speed_share,
        )

    def _tilt_levels(self) -> list[float]:
        return [-1.0 + 2.0 * k / (self.poses - 1) for k in range(self.poses)]

    def _round_path(self) -> list[tuple[float, float]]:
        pan, tilt = -1.0, -1.0
        places = [(pan, tilt)]
        for to_pan, to_tilt in self._round_moves():
            pan = pan if to_pan is None else to_pan
            tilt = tilt if to_tilt is None else to_tilt
            places.append((pan, tilt))
        if pan < 0.0:
            places.append((1.0, tilt))
        return places

    def _round_moves(self) -> Iterator[tuple[float | None, float | None]]:
        """Yield the target of each move, both axes from -1 to 1; None for no motion."""
        pan = -1.0
        level = self._tilt_levels()
        visits = [*range(self.poses), *range(self.poses - 2, 0, -1)]
        for current, following in zip(visits, [*visits[1:], 0], strict=True):
            for _ in range(self.passes):
                pan = -pan
                yield pan, None
            for _ in range(self.swings):
                yield None, -1.0 if level[current] > 0.0 else 1.0
                yield None, level[current]
            if self.along:
                pan = -pan
            yield (pan if self.along else None), level[following]
        parts = range(1, self.weave + 1)
        for direction in (1.0, -1.0):
            for k in parts:
                position = pan * direction * (1.0 - 2.0 * k / self.weave)
                yield position, (1.0 if k % 2 else -1.0)


def moves_between(
    poses: Sequence[tuple[float, float]], speeds: Iterable[tuple[float, float]], dwell_s: float
) -> Steps:
    """Return moves from the first pose through all others, with a rest after each.

    Args:
        poses: pan and tilt in deg; a pose that equals the previous one needs no move.
        speeds: of pan and tilt, in deg/s, to each pose after the first.
        dwell_s: the length of each rest.
    """
    steps: list[Step] = []
    for (before, target), (pan_speed, tilt_speed) in zip(pairwise(poses), speeds, strict=False):
        pans, tilts = target[0] != before[0], target[1] != before[1]
        if not pans and not tilts:
            continue
        move = Move(
            pan_deg=target[0] if pans else None,
            tilt_deg=target[1] if tilts else None,
            pan_speed_deg_s=pan_speed if pans else None,
            tilt_speed_deg_s=tilt_speed if tilts else None,
        )
        steps += [Step(move=move), Step(rest=Rest(dwell_s))]
    return tuple(steps)


def draw_design(rng: np.random.Generator, once: bool = False) -> ProgramDesign:
    """Draw a random design, uniform over the choices of each field."""
    chosen = {name: choices[int(rng.integers(len(choices)))] for name, choices in CHOICES.items()}
    if once:
        chosen |= ROUND_ONLY_DEFAULTS | {"passes": max(1, chosen["passes"])}
    return ProgramDesign(**chosen, once=once)  # type: ignore[arg-type] # the table holds each field's kind


def build_program(
    design: ProgramDesign, space: MotionSpace, unit: UnitModel, duration_s: float
) -> MotionProgram:
    """Return a design as a program of the largest number of cycles in a given time.

    The program has whole cycles and one shortened cycle, or as many sweeps at each pose as the time
    allows. It returns home, and the rests at both ends fill the remaining time.

    Raises:
        UsageError: the time is too short for one cycle.
    """
    lead, back = design.lead_steps(space)

    def made(cycles: int, extra: int, static_s: float) -> MotionProgram:
        rest = Step(rest=Rest(static_s, "static"))
        build = _stay_steps if design.once else _round_steps
        return MotionProgram(
            "planned",
            (rest, *lead, *build(design, space, cycles, extra), *back, rest),
            settings=design.settings(space),
        )

    def lasts_s(program: MotionProgram) -> float:
        return simulate_program(program, unit).duration_s

    fixed_s = lasts_s(made(0, 0, STATIC_S))
    cycle_s = lasts_s(made(1, 0, STATIC_S)) - fixed_s
    cycles = int((duration_s - fixed_s) / cycle_s)
    if cycles < 1:
        raise UsageError(
            f"a duration of {duration_s:g} s is too short for a motion program of this kind",
            f"give a duration of at least {fixed_s + cycle_s:.0f} s",
        )
    extra = len(design.stay_waypoints(space) if design.once else design.round_waypoints(space)) - 1
    while extra > 0 and lasts_s(made(cycles, extra, STATIC_S)) > duration_s:
        extra -= 1
    # A rest ends only after the reply to the poll that is in progress.
    late_s = 2.0 * unit.poll_interval_s
    left_s = max(0.0, duration_s - lasts_s(made(cycles, extra, STATIC_S)) - late_s)
    return made(cycles, extra, STATIC_S + int(left_s / 2.0 * 100.0) / 100.0)


def _round_steps(design: ProgramDesign, space: MotionSpace, cycles: int, extra: int) -> Steps:
    """Return the cycles, and one cycle with only the first `extra` moves of its rounds."""
    cycle = design.motion_steps(design.cycle_waypoints(space), space)
    partial = design.motion_steps(design.cycle_waypoints(space, extra + 1), space) if extra else ()
    return ((Step(repeat=Repeat(cycles, cycle)),) if cycles > 1 else cycle * cycles) + partial


def _stay_steps(design: ProgramDesign, space: MotionSpace, cycles: int, extra: int) -> Steps:
    """Return `cycles` times the sweeps of each pose, and once more at the first `extra` poses."""
    stays = design.stay_waypoints(space)
    steps: list[Step] = []
    for k, waypoints in enumerate(stays):
        count = cycles + (k < extra)
        sweeps = design.motion_steps(waypoints, space)
        steps += [Step(repeat=Repeat(count, sweeps))] if count > 1 else sweeps * count
        steps += design.motion_steps((waypoints[0], stays[(k + 1) % len(stays)][0]), space)
    return tuple(steps)


def _position_in_range(limits: tuple[float, float], fraction: float) -> float:
    """Return a position in a span, `fraction` from -1 to 1, rounded to a tenth of a degree."""
    middle, half = (limits[0] + limits[1]) / 2.0, (limits[1] - limits[0]) / 2.0
    return round(middle + fraction * half, 1) + 0.0
