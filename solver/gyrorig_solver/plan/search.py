"""Looking for the program that tells most in a given time.

Many designs are drawn and judged quickly: the noise taken as white, the motion as known but
for the rests, a cycle standing for the whole. The best are walked downhill, one number
at a time. The best of a few kinds, and then those near the best of all, are judged by the full
prediction, which decides. The same seed gives the same program.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.program import MotionProgram, Rest, Step
from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.estimate.information import NAMES, white_information
from gyrorig_solver.estimate.observability import decide
from gyrorig_solver.plan.criterion import Criterion, cost
from gyrorig_solver.plan.family import CHOICES, STATIC_S, Design, Space, drawn, program_of
from gyrorig_solver.plan.predict import Prediction, predict
from gyrorig_solver.plan.sensor import SensorModel
from gyrorig_solver.plan.timeline import HALT_S, Timeline, lay_out
from gyrorig_solver.plan.unit import ARCSEC_PER_DEG, UnitModel
from gyrorig_solver.reference.kinematics import AxisTurn, stage_rate
from gyrorig_solver.reference.rests import DETENT_VARIANCE

DRAWN, WALKED, KINDS = 300, 6, 8
KIND = ("poses", "passes", "swings", "along", "weave")
NEAR = ("pan_span", "tilt_span")
GRID_HZ = 50.0  # motions of a unit change within tenths of a second
MIRRORED = np.array([1.0, -1.0, -1.0])  # of the stage rate, when pan turns the other way
LONGEST_WAY = 40  # moves; a longer one is no cycle any more
# Zero rate and scale of a part of its family leave so much of the range for the motion.
USABLE_RANGE = 0.75

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """The best program that was found, and what it was chosen from."""

    design: Design
    prediction: Prediction
    cost: float
    judged: int  # designs looked at

    @property
    def program(self) -> MotionProgram:
        """The program itself."""
        return self.prediction.program


def find_program(
    unit: UnitModel,
    sensor: SensorModel,
    seconds: float,
    criterion: Criterion = "worst",
    seed: int = 1,
    progress: Progress = lambda text: None,
) -> Found:
    """Return the best program of the family within a time.

    Args:
        unit: what carries it out.
        sensor: what is to be calibrated.
        seconds: how long the recording may last.
        criterion: see `criterion.cost`.
        seed: of the designs drawn.
        progress: is told what is being done.

    Raises:
        UsageError: no program of the family fits into so little time.
    """
    space = Space.of(unit, float(np.degrees(sensor.full_scale_rad_s)) * USABLE_RANGE)
    quick = _Quick(unit, sensor, space, seconds, criterion)
    rng = np.random.default_rng(seed)
    designs = sorted({drawn(rng) for _ in range(DRAWN)}, key=repr)
    progress(f"judging {len(designs)} programs quickly")
    ranked = sorted(designs, key=quick.cost)
    if not np.isfinite(quick.cost(ranked[0])):
        raise _too_short(quick, seconds)
    for number, design in enumerate(ranked[:WALKED], start=1):
        progress(f"improving program {number} of {WALKED}")
        _downhill(design, quick)
    found: dict[Design, Found] = {}

    def judge(designs: Sequence[Design], what: str) -> Design:
        for number, design in enumerate(designs, start=1):
            progress(f"predicting {what} {number} of {len(designs)}")
            if design not in found and np.isfinite(quick.cost(design)):
                with suppress(UsageError):  # its cycle is a little longer than it seemed
                    prediction = predict(program_of(design, space, unit, seconds), unit, sensor)
                    value = cost(prediction.decision, criterion)
                    found[design] = Found(design, prediction, value, quick.judged)
        if not found:
            raise _too_short(quick, seconds)
        return min(found, key=lambda d: found[d].cost)

    best = judge(quick.best_kinds(KINDS), "kind")
    best = judge([d for d in _neighbours(best) if _differs_in(d, best, NEAR)], "neighbour")
    return found[best]


class _Quick:
    """The quick judgement, each design once."""

    def __init__(
        self,
        unit: UnitModel,
        sensor: SensorModel,
        space: Space,
        seconds: float,
        criterion: Criterion,
    ) -> None:
        self._unit, self._space, self._seconds = unit, space, seconds
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
        if not design.sound:
            return float("inf")
        space, way = self._space, design.way(self._space)
        if len(way) > LONGEST_WAY:
            return float("inf")
        lead = design.steps((space.home, way[0]), space)
        back = design.steps((way[0], space.home), space)
        settings = design.settings(space)
        rest = Step(rest=Rest(STATIC_S))

        def lasting(steps: tuple[Step, ...]) -> MotionProgram:
            return MotionProgram("cycle", steps, settings=settings)

        begin_s = lay_out(lasting(lead), self._unit).program_s
        timeline = lay_out(lasting((*lead, *design.steps(way, space))), self._unit)
        way_s = timeline.program_s - begin_s
        fixed_s = lay_out(lasting((rest, *lead, *back[:1], rest)), self._unit).duration_s
        # The two halves of a cycle may differ by a question for the position or two.
        self.least_s[design] = fixed_s + 2.0 * way_s + 4.0 * self._unit.poll_interval_s
        if self._seconds < self.least_s[design]:
            return float("inf")
        count = max(16, round(way_s * GRID_HZ))
        edges_s = begin_s + np.linspace(0.0, way_s, count + 1)
        step_s = way_s / count
        scale = [float(np.radians(a.resolution_arcsec / ARCSEC_PER_DEG)) for a in self._unit.axes]
        angle = timeline.steps(edges_s) * np.array(scale)
        speed = np.diff(angle, axis=0) / step_s
        tilt = (angle[1:, 1] + angle[:-1, 1]) / 2.0
        rate = stage_rate(tilt, speed[:, 0], speed[:, 1])
        turn = AxisTurn((scale[0], scale[1]), tilt, speed[:, 0], np.full(count, step_s))
        loose = _rests(timeline, edges_s, turn) * float(np.sqrt(DETENT_VARIANCE))
        cycles = (self._seconds - fixed_s) / (2.0 * way_s)
        information = cycles * (
            white_information(rate, step_s, self._density, loose)
            + white_information(rate * MIRRORED, step_s, self._density, loose * MIRRORED)
        )
        still_s = 2.0 * STATIC_S + HALT_S
        resting = white_information(np.zeros((16, 3)), still_s / 16, self._density)
        return cost(decide(information + resting, NAMES), self._criterion)


def _rests(timeline: Timeline, edges_s: FloatArray, turn: AxisTurn) -> FloatArray:
    """Return how the stage rate changes with each rest's place in its step, (k, n, 3)."""
    whole = slice(0, edges_s.size - 1)
    found = []
    for axis, courses in enumerate(timeline.courses):
        shares = [course.share(edges_s) for course in courses]
        gone = [*shares[1:], np.zeros_like(edges_s)]
        found += [turn.rate(axis, a - b, whole) for a, b in zip(shares, gone, strict=True)]
    return np.stack(found) if found else np.zeros((0, edges_s.size - 1, 3))


def _downhill(design: Design, quick: _Quick) -> None:
    """Change one number at a time, to any of its choices, as long as that helps."""
    here, value = design, quick.cost(design)
    while True:
        better = min(_neighbours(here), key=quick.cost)
        if not quick.cost(better) < value * (1.0 - 1e-6):
            return
        here, value = better, quick.cost(better)


def _neighbours(design: Design) -> Iterator[Design]:
    for name, choices in CHOICES.items():
        for choice in choices:
            if choice != getattr(design, name):
                yield replace(design, **{name: choice})  # type: ignore[arg-type] # as in drawn


def _differs_in(design: Design, other: Design, names: tuple[str, ...]) -> bool:
    return any(getattr(design, name) != getattr(other, name) for name in names)


def _too_short(quick: _Quick, seconds: float) -> UsageError:
    """Return what to say where nothing fits: the shortest of the programs drawn lasts longer."""
    return UsageError(
        f"{seconds:g} s is too short for a program that shows all parameters",
        f"give --seconds {np.ceil(min(quick.least_s.values())):.0f} or more",
    )
