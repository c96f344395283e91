"""Fast screening of designs with white noise; the motion is known except for its rests.

One cycle, or one set of sweeps at each pose, represents all of them.

What to use when: `WhiteNoiseScreen` to rank hundreds of designs in seconds; `predict_program` to
decide between the best.
"""

from collections.abc import Sequence

import numpy as np

from gyrorig_protocol.program import MotionProgram, Rest, Step
from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate import PARAMETER_NAMES, analyse_observability, white_noise_information
from gyrorig_solver.plan.criterion import Criterion, bias_penalty, cost
from gyrorig_solver.plan.program_family import STATIC_S, MotionSpace, ProgramDesign, Steps
from gyrorig_solver.plan.program_timeline import (
    HALT_WATCH_S,
    ProgramTimeline,
    ProgramTooLongError,
    simulate_program,
)
from gyrorig_solver.plan.sensor_model import SensorModel
from gyrorig_solver.plan.unit_model import UnitModel
from gyrorig_solver.reference import DETENT_VARIANCE, StageRateJacobian
from gyrorig_solver.reference.unit.stage_kinematics import stage_rate

KIND_FIELDS = ("once", "poses", "passes", "swings", "along", "weave")
GRID_HZ = 50.0  # motions of a unit change within tenths of a second
MIRROR_SIGNS = np.array([1.0, -1.0, -1.0])  # of the stage rate, when pan turns the other way
MAX_ROUND_MOVES = 40  # a design with a longer round is rejected


class WhiteNoiseScreen:
    """Fast cost of designs for white noise; each design is evaluated once."""

    def __init__(
        self,
        unit: UnitModel,
        sensor: SensorModel,
        space: MotionSpace,
        duration_s: float,
        criterion: Criterion,
    ) -> None:
        """Screen designs for a unit and a sensor, in a motion space and a time."""
        self._unit, self.space, self.duration_s = unit, space, duration_s
        self._criterion = criterion
        self._density: FloatArray = sensor.levels[:, 0]
        self._known: dict[ProgramDesign, float] = {}
        self.min_duration_s: dict[ProgramDesign, float] = {}

    @property
    def design_count(self) -> int:
        """The number of designs evaluated."""
        return len(self._known)

    def cost(self, design: ProgramDesign) -> float:
        """Return a design's cost, infinite if the design is not possible."""
        if design not in self._known:
            try:
                self._known[design] = self._screen(design)
            except ProgramTooLongError:  # on a slow rig
                self._known[design] = float("inf")
        return self._known[design]

    def best_kinds(self, count: int) -> list[ProgramDesign]:
        """Return the best designs of different kinds, at most `count` for each number of tilts.

        White noise favours few tilts; hidden causes need more.
        """
        possible = [d for d, value in self._known.items() if np.isfinite(value)]
        best: dict[tuple[object, ...], ProgramDesign] = {}
        for design in sorted(possible, key=lambda d: (self._known[d], repr(d))):
            best.setdefault(tuple(getattr(design, name) for name in KIND_FIELDS), design)
        by_poses: dict[int, list[ProgramDesign]] = {}
        for design in best.values():
            by_poses.setdefault(design.poses, []).append(design)
        return [design for designs in by_poses.values() for design in designs[:count]]

    def _screen(self, design: ProgramDesign) -> float:
        if not design.is_valid or len(design.round_waypoints(self.space)) > MAX_ROUND_MOVES:
            return float("inf")
        lead, back = design.lead_steps(self.space)
        rest = Step(rest=Rest(STATIC_S))
        fixed_s = simulate_program(
            _program(design, self.space, (rest, *lead, *back, rest)), self._unit
        )
        part = self._stay_information if design.once else self._round_information
        information = part(design, lead, fixed_s.duration_s)
        if information is None:
            return float("inf")
        still_s = 2.0 * STATIC_S + HALT_WATCH_S
        resting = white_noise_information(np.zeros((16, 3)), still_s / 16, self._density)
        decision = analyse_observability(information + resting, PARAMETER_NAMES)
        floor = np.sqrt(self._density / (2.0 * self.duration_s))
        return cost(decision, self._criterion) * bias_penalty(decision, floor)

    def _round_information(
        self, design: ProgramDesign, lead: Steps, fixed_s: float
    ) -> FloatArray | None:
        """Return the information of as many cycles as fit; None if none fits."""
        steps = design.motion_steps(design.round_waypoints(self.space), self.space)
        parts = _ProgramParts(design, self.space, self._unit, (lead, steps))
        round_s = parts.duration_s(1)
        # The durations of the two halves of a cycle may differ by one or two polls.
        self.min_duration_s[design] = fixed_s + 2.0 * round_s + 4.0 * self._unit.poll_interval_s
        if self.duration_s < self.min_duration_s[design]:
            return None
        cycles = (self.duration_s - fixed_s) / (2.0 * round_s)
        return cycles * (
            parts.information(1, self._density) + parts.information(1, self._density, MIRROR_SIGNS)
        )

    def _stay_information(
        self, design: ProgramDesign, lead: Steps, fixed_s: float
    ) -> FloatArray | None:
        """Return the information of as many sweeps at each pose as fit; None if none fits."""
        stays = design.stay_waypoints(self.space)
        parts = [lead]
        for k, waypoints in enumerate(stays):
            parts.append(design.motion_steps(waypoints, self.space))
            following = stays[(k + 1) % len(stays)][0]
            parts.append(design.motion_steps((waypoints[0], following), self.space))
        program_parts = _ProgramParts(design, self.space, self._unit, parts)
        sweeps, transfers = range(1, len(parts), 2), range(2, len(parts), 2)
        sweeps_s = sum(program_parts.duration_s(k) for k in sweeps)
        fixed_s += sum(program_parts.duration_s(k) for k in transfers)
        self.min_duration_s[design] = fixed_s + sweeps_s + 4.0 * self._unit.poll_interval_s
        if self.duration_s < self.min_duration_s[design]:
            return None
        repeats = (self.duration_s - fixed_s) / sweeps_s
        transfer_information = sum(program_parts.information(k, self._density) for k in transfers)
        repeated = sum(program_parts.information(k, self._density) for k in sweeps)
        return np.asarray(transfer_information + repeats * repeated, dtype=np.float64)


class _ProgramParts:
    """The parts of a program in sequence, and the information of each."""

    def __init__(
        self, design: ProgramDesign, space: MotionSpace, unit: UnitModel, parts: Sequence[Steps]
    ) -> None:
        steps: Steps = ()
        self._ends_s = [0.0]
        for part in parts:
            steps = (*steps, *part)
            self._timeline = simulate_program(_program(design, space, steps), unit)
            self._ends_s.append(self._timeline.program_s)
        self._scale = (unit.pan.step_rad, unit.tilt.step_rad)

    def duration_s(self, part: int) -> float:
        """Return the duration of a part."""
        return self._ends_s[part + 1] - self._ends_s[part]

    def information(
        self, part: int, density: FloatArray, mirror_signs: FloatArray | None = None
    ) -> FloatArray:
        """Return the information of a part, optionally with pan mirrored."""
        part_s = self.duration_s(part)
        count = max(16, round(part_s * GRID_HZ))
        edges_s = self._ends_s[part] + np.linspace(0.0, part_s, count + 1)
        step_s = part_s / count
        angle = self._timeline.position_steps(edges_s) * np.array(self._scale)
        speed = np.diff(angle, axis=0) / step_s
        tilt = (angle[1:, 1] + angle[:-1, 1]) / 2.0
        rate = stage_rate(tilt, speed[:, 0], speed[:, 1])
        turn = StageRateJacobian(self._scale, tilt, speed[:, 0], np.full(count, step_s))
        rest_columns = _rest_derivatives(self._timeline, edges_s, turn) * float(
            np.sqrt(DETENT_VARIANCE)
        )
        if mirror_signs is not None:
            rate, rest_columns = rate * mirror_signs, rest_columns * mirror_signs
        return white_noise_information(rate, step_s, density, rest_columns)


def _program(design: ProgramDesign, space: MotionSpace, steps: Steps) -> MotionProgram:
    return MotionProgram("cycle", steps, settings=design.settings(space))


def _rest_derivatives(
    timeline: ProgramTimeline, edges_s: FloatArray, turn: StageRateJacobian
) -> FloatArray:
    """Return the stage rate's derivatives by each rest's position within its step, (k, n, 3)."""
    whole = slice(0, edges_s.size - 1)
    columns = []
    for axis, courses in enumerate(timeline.profiles):
        shares = [course.progress(edges_s) for course in courses]
        next_shares = [*shares[1:], np.zeros_like(edges_s)]
        columns += [turn.rate(axis, a - b, whole) for a, b in zip(shares, next_shares, strict=True)]
    # Rests of other parts have no effect in this part.
    columns = [column for column in columns if column.any()]
    return np.stack(columns) if columns else np.zeros((0, edges_s.size - 1, 3))
