"""The programs among which the planner chooses, of two kinds.

A round visits the poses of tilt from the lowest to the highest and back. At each pose pan
sweeps `passes` times over its span and tilt may swing to the far end and back; on the way
to the next pose pan may turn along. At its end pan may weave: go there and back in parts
while tilt goes to and fro with each part. A cycle is a round and the same with pan mirrored:
each rate comes with both signs, so that no gain looks like a bias. Cycles repeat.

A stay (`once`) comes to each pose once and does all of its sweeps there, from the middle of
pan's span to an end and back, to both ends in turn. A detent's error at a rest between two
sweeps at the same tilt leaves the mean rate alone, and so the bias; between sweeps at
different tilts it does not. What a stay has beyond that tells the causes of an error apart:
several speeds, and the first pose again at the end; that each sweep stops in the middle and
goes on in the same direction does so anyway. Every move ends in a short rest.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.program import MotionProgram, Move, Repeat, Rest, Step, UnitSettings
from gyrorig_solver.plan.timeline import lay_out
from gyrorig_solver.plan.unit import UnitModel

# Low, so that moves ramp: up to the base speed a unit starts at once, and rings.
BASE_SPEED_DEG_S = 3.0
STATIC_S = 2.0  # at least, at each end: for the noise at rest, and for the first polls
MARGIN_DEG = 1.0  # from the unit's limits, which homing moves by a step or so

# What each number of a design may be. With two poses the calibration takes axes that are not
# square for its own, unseen at any size (notes on discovery, section 5). Accelerations up to
# what the programs made by hand use; a dwell of 0.3 s lets the mechanics ring down (unit's
# notes, section 7: 10 to 60 Hz, Q 5 to 20).
CHOICES: dict[str, tuple[float, ...]] = {
    "poses": (3, 4, 5),
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
# What of these a stay has not.
ROUNDS_ONLY: dict[str, float] = {"along": False, "weave": 0}

# What a stay's sweeps and swings go at, in turn, in parts of its speeds: the fastest, and
# three that a rate's square and cube tell apart.
LADDER = (1.0, 0.6, 0.35, 0.2)

Steps = tuple[Step, ...]


class Place(NamedTuple):
    """Where a move goes, and how fast in parts of the design's speeds."""

    pan_deg: float
    tilt_deg: float
    share: float = 1.0


@dataclass(frozen=True, slots=True)
class Space:
    """Where and how fast a program may turn."""

    pan_deg: tuple[float, float]
    tilt_deg: tuple[float, float]
    pan_speed_deg_s: float
    tilt_speed_deg_s: float

    @classmethod
    def of(cls, unit: UnitModel, fastest_deg_s: float) -> "Space":
        """Return the space of a unit, `fastest_deg_s` being what the sensor may see."""
        spans = []
        for axis in unit.axes:
            margin = min(MARGIN_DEG, (axis.high_deg - axis.low_deg) / 10.0)
            spans.append((axis.low_deg + margin, axis.high_deg - margin))
        # Rounded down, as a person would write them.
        fast = [int(min(axis.fastest_deg_s, fastest_deg_s) * 10.0) / 10.0 for axis in unit.axes]
        return cls(spans[0], spans[1], fast[0], fast[1])

    @property
    def home(self) -> Place:
        """The allowed place nearest to pan 0, tilt 0."""
        pan, tilt = (min(max(0.0, low), high) for low, high in (self.pan_deg, self.tilt_deg))
        return Place(pan, tilt)


@dataclass(frozen=True, slots=True)
class Design:
    """One member of the family. Fractions are of what the space allows."""

    poses: int  # of tilt, evenly from the lowest to the highest
    passes: int  # of pan, at each pose; of a stay: there and back
    swings: int  # of tilt alone, there and back, at each pose
    along: bool  # pan turns along on the way to the next pose
    weave: int  # parts of pan's way in which tilt goes to and fro; 0: none
    pan_span: float
    tilt_span: float
    pan_speed: float
    tilt_speed: float
    acceleration_deg_s2: float
    dwell_s: float
    once: bool = False  # a stay
    speeds: int = 1  # of a stay's sweeps and swings, from the ladder
    again: bool = False  # it ends at the first pose

    @property
    def sound(self) -> bool:
        """False where pan would never turn."""
        return self.passes > 0 or self.along or self.weave > 0

    def settings(self, space: Space) -> UnitSettings:
        """Return what the unit is told before the first move."""
        return UnitSettings(
            base_speed_deg_s=BASE_SPEED_DEG_S,
            acceleration_deg_s2=self.acceleration_deg_s2,
            default_speed_deg_s=round(self.pan_speed * space.pan_speed_deg_s, 1),
        )

    def begin(self, space: Space) -> Place:
        """Return where a cycle, or all sweeps, begin and end."""
        return self._place(0.0 if self.once else -1.0, -1.0, space)

    def round(self, space: Space, upto: int | None = None) -> tuple[Place, ...]:
        """Return the places of a round, from one end of pan to the other, or of its begin."""
        way = self._way()
        return tuple(self._place(pan, tilt, space) for pan, tilt in way[:upto])

    def cycle(self, space: Space, upto: int | None = None) -> tuple[Place, ...]:
        """Return the places of a cycle, the last as the first, or of one cut short."""
        way = self._way()[:upto]
        mirrored = [(-pan, tilt) for pan, tilt in way]
        places = [self._place(pan, tilt, space) for pan, tilt in (*way, *mirrored, way[0])]
        return tuple(place for k, place in enumerate(places) if k == 0 or place != places[k - 1])

    def stays(self, space: Space) -> tuple[tuple[Place, ...], ...]:
        """Return the places that are repeated at each pose, each last as its first."""
        found = []
        for level in (*self._levels(), *([-1.0] if self.again else [])):
            far = -1.0 if level > 0.0 else 1.0
            at = [(0.0, level, 1.0)]
            for k in range(self.passes):
                # The slower, the shorter: each sweep lasts about as long.
                share = LADDER[k % self.speeds]
                end = share * (-1.0 if k // self.speeds % 2 != k % 2 else 1.0)
                at += [(end, level, share), (0.0, level, share)]
            for k in range(self.swings):
                share = LADDER[k % self.speeds]
                at += [(0.0, far, share), (0.0, level, share)]
            found.append(tuple(self._place(pan, tilt, space, share) for pan, tilt, share in at))
        return tuple(found)

    def steps(self, places: Sequence[Place], space: Space) -> Steps:
        """Return moves from the first place through all others, a rest after each."""
        out = []
        for before, to in pairwise(places):
            turns, leans = to.pan_deg != before.pan_deg, to.tilt_deg != before.tilt_deg
            if not turns and not leans:
                continue
            pan_speed = round(self.pan_speed * space.pan_speed_deg_s * to.share, 1)
            tilt_speed = round(self.tilt_speed * space.tilt_speed_deg_s * to.share, 1)
            move = Move(
                pan_deg=to.pan_deg if turns else None,
                tilt_deg=to.tilt_deg if leans else None,
                pan_speed_deg_s=pan_speed if turns else None,
                tilt_speed_deg_s=tilt_speed if leans else None,
            )
            out += [Step(move=move), Step(rest=Rest(self.dwell_s))]
        return tuple(out)

    def lead(self, space: Space) -> tuple[Steps, Steps]:
        """Return the moves from home to the begin and back: pan at home's tilt only."""
        begin = self.begin(space)
        there = (space.home, Place(begin.pan_deg, space.home.tilt_deg), begin)
        return self.steps(there, space), self.steps(there[::-1], space)[:-1]

    def _place(self, pan: float, tilt: float, space: Space, share: float = 1.0) -> Place:
        return Place(
            _within(space.pan_deg, pan * self.pan_span),
            _within(space.tilt_deg, tilt * self.tilt_span),
            share,
        )

    def _levels(self) -> list[float]:
        return [-1.0 + 2.0 * k / (self.poses - 1) for k in range(self.poses)]

    def _way(self) -> list[tuple[float, float]]:
        pan, tilt = -1.0, -1.0
        places = [(pan, tilt)]
        for to_pan, to_tilt in self._moves():
            pan = pan if to_pan is None else to_pan
            tilt = tilt if to_tilt is None else to_tilt
            places.append((pan, tilt))
        if pan < 0.0:
            places.append((1.0, tilt))
        return places

    def _moves(self) -> Iterator[tuple[float | None, float | None]]:
        """Yield where each move goes, both axes from -1 to 1; None: stays."""
        pan = -1.0
        level = self._levels()
        way = [*range(self.poses), *range(self.poses - 2, 0, -1)]
        for here, following in zip(way, [*way[1:], 0], strict=True):
            for _ in range(self.passes):
                pan = -pan
                yield pan, None
            for _ in range(self.swings):
                yield None, -1.0 if level[here] > 0.0 else 1.0
                yield None, level[here]
            if self.along:
                pan = -pan
            yield (pan if self.along else None), level[following]
        parts = range(1, self.weave + 1)
        for turn in (1.0, -1.0):
            for k in parts:
                at = pan * turn * (1.0 - 2.0 * k / self.weave)
                yield at, (1.0 if k % 2 else -1.0)


def drawn(rng: np.random.Generator, once: bool = False) -> Design:
    """Return a design whose every number is one of its choices, drawn evenly."""
    picked = {name: choices[int(rng.integers(len(choices)))] for name, choices in CHOICES.items()}
    if once:
        picked |= ROUNDS_ONLY | {"passes": max(1, picked["passes"])}
    return Design(**picked, once=once)  # type: ignore[arg-type] # the table holds each field's kind


def program_of(design: Design, space: Space, unit: UnitModel, seconds: float) -> MotionProgram:
    """Return a design as a program that lasts as long as it may.

    Whole cycles and one cut short, or as many sweeps at each pose as time allows; home, and
    what is left as rests.

    Raises:
        UsageError: not even one cycle fits.
    """
    lead, back = design.lead(space)

    def made(cycles: int, extra: int, static_s: float) -> MotionProgram:
        rest = Step(rest=Rest(static_s, "static"))
        build = _stay_steps if design.once else _round_steps
        return MotionProgram(
            "planned",
            (rest, *lead, *build(design, space, cycles, extra), *back, rest),
            settings=design.settings(space),
        )

    def lasts_s(program: MotionProgram) -> float:
        return lay_out(program, unit).duration_s

    fixed_s = lasts_s(made(0, 0, STATIC_S))
    cycle_s = lasts_s(made(1, 0, STATIC_S)) - fixed_s
    cycles = int((seconds - fixed_s) / cycle_s)
    if cycles < 1:
        raise UsageError(
            f"{seconds:g} s is too short for a program that shows anything",
            f"this one needs {fixed_s + cycle_s:.0f} s",
        )
    extra = len(design.stays(space) if design.once else design.round(space)) - 1
    while extra > 0 and lasts_s(made(cycles, extra, STATIC_S)) > seconds:
        extra -= 1
    # A rest ends with the question that is under way then.
    late_s = 2.0 * unit.poll_interval_s
    left_s = max(0.0, seconds - lasts_s(made(cycles, extra, STATIC_S)) - late_s)
    return made(cycles, extra, STATIC_S + int(left_s / 2.0 * 100.0) / 100.0)


def _round_steps(design: Design, space: Space, cycles: int, extra: int) -> Steps:
    """Return cycles, and one that has only the first `extra` moves of its rounds."""
    cycle = design.steps(design.cycle(space), space)
    more = design.steps(design.cycle(space, extra + 1), space) if extra else ()
    return ((Step(repeat=Repeat(cycles, cycle)),) if cycles > 1 else cycle * cycles) + more


def _stay_steps(design: Design, space: Space, cycles: int, extra: int) -> Steps:
    """Return `cycles` times the sweeps of each pose, once more at the first `extra` poses."""
    stays = design.stays(space)
    out: list[Step] = []
    for k, places in enumerate(stays):
        count = cycles + (k < extra)
        sweeps = design.steps(places, space)
        out += [Step(repeat=Repeat(count, sweeps))] if count > 1 else sweeps * count
        out += design.steps((places[0], stays[(k + 1) % len(stays)][0]), space)
    return tuple(out)


def _within(span: tuple[float, float], at: float) -> float:
    """Return a place in a span, `at` from -1 to 1, to a tenth of a degree."""
    middle, half = (span[0] + span[1]) / 2.0, (span[1] - span[0]) / 2.0
    return round(middle + at * half, 1) + 0.0
