"""A quick judgement of a design: white noise, and a motion known but for its rests.

A cycle, or one set of sweeps at each pose, stands for all of them. What to use when: `Quick`
to rank hundreds of designs in seconds; `predict` decides between the best.
"""

from collections.abc import Sequence

import numpy as np

from gyrorig_protocol.program import MotionProgram, Rest, Step
from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.estimate.information import NAMES, white_information
from gyrorig_solver.estimate.observability import decide
from gyrorig_solver.plan.criterion import Criterion, cost, drawback
from gyrorig_solver.plan.family import STATIC_S, Design, Space, Steps
from gyrorig_solver.plan.sensor import SensorModel
from gyrorig_solver.plan.timeline import HALT_S, Timeline, lay_out
from gyrorig_solver.plan.unit import ARCSEC_PER_DEG, UnitModel
from gyrorig_solver.reference.kinematics import AxisTurn, stage_rate
from gyrorig_solver.reference.rests import DETENT_VARIANCE

KIND = ("once", "poses", "passes", "swings", "along", "weave")
GRID_HZ = 50.0  # motions of a unit change within tenths of a second
MIRRORED = np.array([1.0, -1.0, -1.0])  # of the stage rate, when pan turns the other way
LONGEST_WAY = 40  # moves; a longer one is no cycle any more


class Quick:
    """The quick judgement, each design once."""

    def __init__(
        self,
        unit: UnitModel,
        sensor: SensorModel,
        space: Space,
        seconds: float,
        criterion: Criterion,
    ) -> None:
        """Judge designs for a unit and a sensor, in a space and a time."""
        self._unit, self.space, self.seconds = unit, space, seconds
        self._criterion = criterion
        self._density: FloatArray = sensor.levels[:, 0]
        self._known: dict[Design, float] = {}
        self.least_s: dict[Design, float] = {}

    @property
    def judged(self) -> int:
        """How many designs were looked at."""
        return len(self._known)

    def cost(self, design: Design) -> float:
        """Return a design's cost, infinite where it cannot be."""
        if design not in self._known:
            self._known[design] = self._judge(design)
        return self._known[design]

    def best_kinds(self, count: int) -> list[Design]:
        """Return the best design of each of the best kinds looked at."""
        possible = [d for d, value in self._known.items() if np.isfinite(value)]
        best: dict[tuple[object, ...], Design] = {}
        for design in sorted(possible, key=lambda d: (self._known[d], repr(d))):
            best.setdefault(tuple(getattr(design, name) for name in KIND), design)
        return list(best.values())[:count]

    def _judge(self, design: Design) -> float:
        if not design.sound or len(design.round(self.space)) > LONGEST_WAY:
            return float("inf")
        lead, back = design.lead(self.space)
        rest = Step(rest=Rest(STATIC_S))
        fixed_s = lay_out(_program(design, self.space, (rest, *lead, *back, rest)), self._unit)
        part = self._stay if design.once else self._round
        information = part(design, lead, fixed_s.duration_s)
        if information is None:
            return float("inf")
        still_s = 2.0 * STATIC_S + HALT_S
        resting = white_information(np.zeros((16, 3)), still_s / 16, self._density)
        decision = decide(information + resting, NAMES)
        floor = np.sqrt(self._density / (2.0 * self.seconds))
        return cost(decision, self._criterion) * drawback(decision, floor)

    def _round(self, design: Design, lead: Steps, fixed_s: float) -> FloatArray | None:
        """Return what as many cycles as fit will tell, None where none does."""
        steps = design.steps(design.round(self.space), self.space)
        seen = _Seen(design, self.space, self._unit, (lead, steps))
        way_s = seen.lasts_s(1)
        # The two halves of a cycle may differ by a question for the position or two.
        self.least_s[design] = fixed_s + 2.0 * way_s + 4.0 * self._unit.poll_interval_s
        if self.seconds < self.least_s[design]:
            return None
        cycles = (self.seconds - fixed_s) / (2.0 * way_s)
        return cycles * (seen.tells(1, self._density) + seen.tells(1, self._density, MIRRORED))

    def _stay(self, design: Design, lead: Steps, fixed_s: float) -> FloatArray | None:
        """Return what as many sweeps at each pose as fit will tell, None where none does."""
        stays = design.stays(self.space)
        parts = [lead]
        for k, places in enumerate(stays):
            parts.append(design.steps(places, self.space))
            following = stays[(k + 1) % len(stays)][0]
            parts.append(design.steps((places[0], following), self.space))
        seen = _Seen(design, self.space, self._unit, parts)
        sweeps, ways = range(1, len(parts), 2), range(2, len(parts), 2)
        sweeps_s = sum(seen.lasts_s(k) for k in sweeps)
        fixed_s += sum(seen.lasts_s(k) for k in ways)
        self.least_s[design] = fixed_s + sweeps_s + 4.0 * self._unit.poll_interval_s
        if self.seconds < self.least_s[design]:
            return None
        times = (self.seconds - fixed_s) / sweeps_s
        found = sum(seen.tells(k, self._density) for k in ways)
        repeated = sum(seen.tells(k, self._density) for k in sweeps)
        return np.asarray(found + times * repeated, dtype=np.float64)


class _Seen:
    """The parts of a program, one after the other, and what each tells."""

    def __init__(
        self, design: Design, space: Space, unit: UnitModel, parts: Sequence[Steps]
    ) -> None:
        steps: Steps = ()
        self._ends_s = [0.0]
        for part in parts:
            steps = (*steps, *part)
            self._timeline = lay_out(_program(design, space, steps), unit)
            self._ends_s.append(self._timeline.program_s)
        pan, tilt = (float(np.radians(a.resolution_arcsec / ARCSEC_PER_DEG)) for a in unit.axes)
        self._scale = (pan, tilt)

    def lasts_s(self, part: int) -> float:
        """Return how long a part is."""
        return self._ends_s[part + 1] - self._ends_s[part]

    def tells(
        self, part: int, density: FloatArray, mirrored: FloatArray | None = None
    ) -> FloatArray:
        """Return the information of a part, if asked with pan turning the other way."""
        lasts_s = self.lasts_s(part)
        count = max(16, round(lasts_s * GRID_HZ))
        edges_s = self._ends_s[part] + np.linspace(0.0, lasts_s, count + 1)
        step_s = lasts_s / count
        angle = self._timeline.steps(edges_s) * np.array(self._scale)
        speed = np.diff(angle, axis=0) / step_s
        tilt = (angle[1:, 1] + angle[:-1, 1]) / 2.0
        rate = stage_rate(tilt, speed[:, 0], speed[:, 1])
        turn = AxisTurn(self._scale, tilt, speed[:, 0], np.full(count, step_s))
        loose = _rests(self._timeline, edges_s, turn) * float(np.sqrt(DETENT_VARIANCE))
        if mirrored is not None:
            rate, loose = rate * mirrored, loose * mirrored
        return white_information(rate, step_s, density, loose)


def _program(design: Design, space: Space, steps: Steps) -> MotionProgram:
    return MotionProgram("cycle", steps, settings=design.settings(space))


def _rests(timeline: Timeline, edges_s: FloatArray, turn: AxisTurn) -> FloatArray:
    """Return how the stage rate changes with each rest's place in its step, (k, n, 3)."""
    whole = slice(0, edges_s.size - 1)
    found = []
    for axis, courses in enumerate(timeline.courses):
        shares = [course.share(edges_s) for course in courses]
        gone = [*shares[1:], np.zeros_like(edges_s)]
        found += [turn.rate(axis, a - b, whole) for a, b in zip(shares, gone, strict=True)]
    # Rests of other parts do nothing here.
    found = [column for column in found if column.any()]
    return np.stack(found) if found else np.zeros((0, edges_s.size - 1, 3))
