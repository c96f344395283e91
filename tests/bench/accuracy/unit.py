"""A pan-tilt unit on a serial line: commands of a program, moves and position replies.

The host sends one command at a time. Between commands, it asks PP and TP in turn, or BT, whose
reply contains the controller's counter. Commands to an E-series unit are at least 10 ms apart, as
in its manual. A byte has 10 bits; a query has 3 bytes, and a reply has 9 or 44. The controller
replies after some milliseconds. The instants at which it reads its position or starts an axis are
not recorded.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from tests.bench.accuracy.profile import RAD_PER_STEP, FloatArray, Path, Trapezoid

from gyrorig_protocol.program import Home, MotionProgram, Move, Rest, unroll_steps

MAKERS_INTERVAL_S = 0.010
ASK_BYTES, ANSWER_BYTES, BOTH_BYTES, DONE_BYTES = 3, 9, 44, 3
COUNTER_HZ, COUNTER_BITS, COUNTER_SKEW = 90e6, 32, 20e-6  # CNF of an E46; a crystal's skew
HOST_S = 2e-4  # from an answer to the next command, at least
LEAST_THOUGHT_S = (0.002, 0.005)  # drawn for each run
EXTRA_THOUGHT_S = 3e-4  # mean of what comes on top, exponential
START_S = (0.001, 0.005)  # from an order to the motion, drawn for each run, and
START_SCATTER_S = 0.004  # for each order on top, uniform
LOG_SPEED_STD = 3e-4  # a timer cannot make every speed: up to 0.1 % off
DETENT_STEPS = 0.1  # 5 % of a full step
REST_S = 1.5  # of polls at rest before and after the program


@dataclass(frozen=True, slots=True, eq=False)
class Answers:
    """Answered counts: the window of each, and what nobody sees, the instant itself."""

    lo_s: FloatArray
    hi_s: FloatArray
    instant_s: FloatArray
    axis: NDArray[np.int64]  # an answer to BT stands twice
    steps: FloatArray
    ticks: NDArray[np.int64] | None  # the controller's counter, where it tells it


@dataclass(frozen=True, slots=True, eq=False)
class Session:
    """What a recording would hold of the unit, and the truth behind it."""

    path: Path
    orders: tuple[tuple[float, float, str], ...]  # told, answered, command
    settings: dict[str, float]
    answers: Answers
    classes: tuple[int, ...]  # of each move of the path; moves told the same speed share one
    log_speed: dict[int, float]  # by class, true over told
    log_ramp: tuple[float, float]
    least_s: float  # the shortest window
    common_s: float  # how much later than its middle the count is taken
    end_s: float


def carry_out(
    program: MotionProgram, baud: float, rng: np.random.Generator, counter: bool = False
) -> Session:
    """Return one session of a program, all that chance decides drawn from `rng`.

    Args:
        program: what the unit is told.
        baud: of its line.
        rng: chance.
        counter: BT is asked, not PP and TP.
    """
    line = _Line(program, baud, rng, counter)
    line.rest(REST_S)
    for step in unroll_steps(program.steps, program.name):
        line.step(step)
    return line.session()


@dataclass
class _Line:
    """The line while the program runs; times in s since the recording began."""

    program: MotionProgram
    baud: float
    rng: np.random.Generator
    counter: bool
    now_s: float = 0.0
    orders: list[tuple[float, float, str]] = field(default_factory=list)
    asked: list[tuple[float, float, int]] = field(default_factory=list)  # lo, thought, axis
    moves: list[Trapezoid] = field(default_factory=list)
    classes: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        rng, settings = self.rng, self.program.settings
        self.byte_s = 10.0 / self.baud
        self.least_s = float(rng.uniform(*LEAST_THOUGHT_S))
        self.share = float(rng.uniform())
        self.start_s = float(rng.uniform(*START_S))
        # A step may count when it is begun, half done or done, a count may be cut or rounded:
        # anything that leaves a rest on its own count.
        lag = float(rng.uniform(-0.5, 0.5))
        self.counting = (lag, float(rng.uniform(-1.0, 1.0)) * (0.5 - abs(lag)))
        self.where = [0, 0]
        self.base = _steps(settings.base_speed_deg_s or 51.4)
        self.ramp = _steps(settings.acceleration_deg_s2 or 102.9)
        self.true_ramp = self.ramp * np.exp(rng.normal(scale=LOG_SPEED_STD, size=2))
        self.speeds: dict[tuple[int, int], tuple[int, float]] = {}
        self.next_axis = 0

    def rest(self, seconds: float) -> None:
        """Ask where the axes are for a while."""
        end_s = self.now_s + seconds
        while self.now_s < end_s:
            self._poll()

    def step(self, step: Rest | Move | Home) -> None:
        """Carry out one step of the program."""
        if isinstance(step, Rest):
            self.rest(step.seconds)
            return
        self._move(self._targets(step))
        if isinstance(step, Move):
            self.rest(step.settle_s)

    def session(self) -> Session:
        """Return what came of it."""
        self.rest(REST_S)
        rng = self.rng
        moves = tuple(self.moves)
        counts = [1 + sum(m.axis == axis for m in moves) for axis in (0, 1)]
        off = (
            rng.normal(scale=DETENT_STEPS, size=counts[0]),
            rng.normal(scale=DETENT_STEPS, size=counts[1]),
        )
        path = Path(moves, off)
        answers = self._answers(path)
        log_ramp = np.log(self.true_ramp / self.ramp)
        settings = {f"{a}_base_speed": float(self.base) for a in ("pan", "tilt")}
        settings |= {f"{a}_acceleration": float(self.ramp) for a in ("pan", "tilt")}
        return Session(
            path,
            tuple(self.orders),
            settings,
            answers,
            tuple(self.classes),
            {number: float(np.log(scale)) for number, scale in self.speeds.values()},
            (float(log_ramp[0]), float(log_ramp[1])),
            self.least_s,
            (self.share - 0.5) * self.least_s,
            self.now_s,
        )

    def _answers(self, path: Path) -> Answers:
        rng = self.rng
        lo, thought, asked = (np.array(column) for column in zip(*self.asked, strict=True))
        late = rng.uniform(size=lo.size) * (thought - self.least_s)
        instant = lo + self.share * self.least_s + late
        ticks, axis = None, asked.astype(np.int64)
        if self.counter:
            rate = COUNTER_HZ * (1.0 + float(rng.uniform(-COUNTER_SKEW, COUNTER_SKEW)))
            begun = int(rng.integers(2**COUNTER_BITS))
            ticks = np.repeat((begun + np.floor(instant * rate).astype(np.int64)), 2)
            ticks %= 2**COUNTER_BITS
            lo, thought, instant = (np.repeat(x, 2) for x in (lo, thought, instant))
            axis = np.tile([0, 1], asked.size)
        steps = np.zeros(lo.size)
        for k in (0, 1):
            steps[axis == k] = _counts(path, k, instant[axis == k], self.counting)
        return Answers(lo, lo + thought, instant, axis, steps, ticks)

    def _targets(self, step: Move | Home) -> list[tuple[int, int, int]]:
        """Return axis, target and speed in steps of each axis that moves."""
        usual = self.program.settings.default_speed_deg_s
        if isinstance(step, Home):
            step = Move(pan_deg=0.0, tilt_deg=0.0, speed_deg_s=step.speed_deg_s)
        both = step.speed_deg_s or usual
        angles = (step.pan_deg, step.tilt_deg)
        speeds = (step.pan_speed_deg_s or both, step.tilt_speed_deg_s or both)
        return [
            (axis, _steps(angle), _steps(speed))
            for axis, (angle, speed) in enumerate(zip(angles, speeds, strict=True))
            if angle is not None
        ]

    def _move(self, targets: list[tuple[int, int, int]]) -> None:
        for axis, _, speed in targets:
            self._order(f"{'PT'[axis]}S{speed}")
        if len(targets) > 1:
            self._order("S")
        orders = [self._order(f"{'PT'[axis]}P{target}") for axis, target, _ in targets]
        if len(targets) > 1:
            orders = [self._order("I")] * len(targets)
        end_s = self.now_s
        for (axis, target, speed), at_s in zip(targets, orders, strict=True):
            if target == self.where[axis]:
                continue
            scale = float(np.exp(self.rng.normal(scale=LOG_SPEED_STD)))
            known = self.speeds.setdefault((axis, speed), (len(self.speeds), scale))
            move = Trapezoid(
                axis,
                at_s + self.start_s + float(self.rng.uniform(0.0, START_SCATTER_S)),
                self.where[axis],
                target,
                speed * known[1],
                float(self.true_ramp[axis]),
                float(self.base),
            )
            self.moves.append(move)
            self.classes.append(known[0])
            self.where[axis] = target
            end_s = max(end_s, move.end_s)
        # Two answers of each axis at its target end a move.
        self.rest(end_s - self.now_s)
        for _ in range(4):
            self._poll()

    def _order(self, text: str) -> float:
        """Say a command; return when its last byte was on the line."""
        told_s = self.now_s + (len(text) + 1) * self.byte_s
        answered_s = told_s + self._thought() + DONE_BYTES * self.byte_s
        self.orders.append((told_s, answered_s, text))
        self._next(answered_s)
        return told_s

    def _poll(self) -> None:
        lo_s = self.now_s + ASK_BYTES * self.byte_s
        thought_s = self._thought()
        self.asked.append((lo_s, thought_s, self.next_axis))
        self.next_axis = 1 - self.next_axis
        self._next(lo_s + thought_s + (BOTH_BYTES if self.counter else ANSWER_BYTES) * self.byte_s)

    def _thought(self) -> float:
        return self.least_s + float(self.rng.exponential(EXTRA_THOUGHT_S))

    def _next(self, answered_s: float) -> None:
        pause_s = HOST_S + float(self.rng.exponential(HOST_S))
        self.now_s = max(self.now_s + MAKERS_INTERVAL_S, answered_s) + pause_s


def _steps(angle_deg: float) -> int:
    return round(float(np.radians(angle_deg)) / RAD_PER_STEP)


def _counts(path: Path, axis: int, time_s: FloatArray, counting: tuple[float, float]) -> FloatArray:
    """Return what the controller's counter shows, whole steps: behind the motion, and beside it."""
    where = path.counted_steps(axis, time_s)
    for move in path.of_axis(axis):
        inside = (time_s > move.start_s) & (time_s < move.end_s)
        where = where + np.where(inside, counting[1] - move.sign * counting[0], 0.0)
    return np.asarray(np.rint(where), dtype=np.float64)
