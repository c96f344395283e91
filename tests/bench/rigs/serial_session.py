"""A stepper unit carries out a motion program and answers on a serial line.

The host sends one command at a time, every 10 ms at most (the maker's limit), and polls the
position otherwise. A byte has 10 bits. The controller reads its count at an unknown instant
between the query and the reply. It starts a move some milliseconds after the command. Times are
in s since the recording began.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from tests.bench.accuracy.profile import RAD_PER_STEP, FloatArray, Trapezoid
from tests.bench.rigs.prior_sizes import AXES, HiddenCauses

from gyrorig_protocol.program import Home, MotionProgram, Move, Rest, unroll_steps

MAKERS_INTERVAL_S = 0.010  # E-series: 100 commands per second
QUERY_BYTES, ONE_BYTES, BOTH_BYTES, DONE_BYTES = 3, 9, 40, 3
BOTH_AXES = 2  # a poll of both axes by BT
HOST_S = 2e-4  # from a reply to the next command
THOUGHT_S = (0.002, 0.005)  # shortest time of the controller, drawn per rig
EXTRA_THOUGHT_S = 3e-4  # mean of the exponential rest
READ_S = 6e-5  # mean delay until the host reads a byte
START_S, START_SCATTER_S = (0.001, 0.005), 0.004  # from a command to the motion
LOG_SPEED_STD = 3e-4  # timers of steppers: up to 0.1 %
DETENT_STEPS = 0.1  # 5 % of a full step: stepper motors without load
HEAD_REST_S, TAIL_REST_S = 2.0, 1.5
DEFAULT_BASE_DEG_S, DEFAULT_RAMP_DEG_S2 = 3.0, 102.9


@dataclass(frozen=True, slots=True)
class Exchange:
    """One command: its text and reply, and the host's times of both."""

    request_s: float
    first_byte_s: float
    reply_s: float
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class Polls:
    """The position polls; each array has shape (n,)."""

    request_s: FloatArray
    first_byte_s: FloatArray
    reply_s: FloatArray
    instant_s: FloatArray  # when the controller read its count; nobody sees it
    axis: NDArray[np.int64]  # 0 pan, 1 tilt, 2 both


@dataclass(frozen=True, slots=True, eq=False)
class SerialSession:
    """What the unit was told, what it did, and when it answered."""

    exchanges: tuple[Exchange, ...]
    polls: Polls
    moves: tuple[Trapezoid, ...]  # as they happened, without rounded ramps
    off_steps: tuple[FloatArray, FloatArray]  # each rest minus its count: detents
    base_steps_s: int  # as told
    ramp_steps_s2: int
    count_lag: float  # steps that the count is behind the motion
    count_shift: float
    common_s: float  # instants of the counts minus the middle of the shortest window
    end_s: float


def run_program(
    program: MotionProgram,
    causes: HiddenCauses,
    baud: float,
    has_counter: bool,
    rng: np.random.Generator,
) -> SerialSession:
    """Return the session of a program on a unit whose properties are drawn from `rng`."""
    line = _Line(program, causes, baud, has_counter, rng)
    for letter in "PT":
        line.send(f"{letter}B{line.base}")
        line.send(f"{letter}A{line.ramp}")
    line.poll_for(HEAD_REST_S)
    for step in unroll_steps(program.steps, program.name):
        line.carry_out(step)
    line.poll_for(TAIL_REST_S)
    return line.session()


@dataclass
class _Line:
    """The serial line while the program runs."""

    program: MotionProgram
    causes: HiddenCauses
    baud: float
    has_counter: bool
    rng: np.random.Generator
    now_s: float = 0.02
    exchanges: list[Exchange] = field(default_factory=list)
    polls: list[tuple[float, float, float, float, int]] = field(default_factory=list)
    moves: list[Trapezoid] = field(default_factory=list)
    speed_scale: dict[tuple[int, int], float] = field(default_factory=dict)
    next_axis: int = 0

    def __post_init__(self) -> None:
        rng, settings, causes = self.rng, self.program.settings, self.causes
        self.byte_s = 10.0 / self.baud
        self.least_s = float(rng.uniform(*THOUGHT_S))
        self.share = float(rng.uniform())
        self.start_s = float(rng.uniform(*START_S))
        self.count_lag = float(rng.uniform(-0.5, 0.5))
        self.count_shift = float(rng.uniform(-1.0, 1.0)) * (0.5 - abs(self.count_lag))
        self.base = _steps(settings.base_speed_deg_s or DEFAULT_BASE_DEG_S)
        self.ramp = _steps(settings.acceleration_deg_s2 or DEFAULT_RAMP_DEG_S2)
        timer = np.exp(rng.normal(scale=LOG_SPEED_STD, size=2))
        self.true_base = [self.base + causes.get("base_speed_jump", a) / RAD_PER_STEP for a in AXES]
        self.true_ramp = [
            self.ramp * (1.0 + causes.get("acceleration_error", a)) * float(t)
            for a, t in zip(AXES, timer, strict=True)
        ]
        self.rounding_s = [causes.get("s_curve", a) for a in AXES]
        self.where = [0, 0]

    def send(self, text: str) -> float:
        """Send a command; return when its last byte has arrived at the controller."""
        request_s = self.now_s
        arrived_s = request_s + (len(text) + 1) * self.byte_s
        first_s = arrived_s + self._thought() + self.byte_s + self._read()
        last_s = first_s + (DONE_BYTES - 1) * self.byte_s
        self.exchanges.append(Exchange(request_s, first_s, last_s, text))
        self._go_on(last_s)
        return arrived_s

    def poll_for(self, seconds: float) -> None:
        """Poll the positions for some time."""
        end_s = self.now_s + seconds
        while self.now_s < end_s:
            self._poll()

    def carry_out(self, step: Rest | Move | Home) -> None:
        """Carry out one step of the program."""
        if isinstance(step, Rest):
            self.poll_for(step.seconds)
            return
        targets = self._targets(step)
        for axis, _, speed in targets:
            self.send(f"{'PT'[axis]}S{speed}")
        if len(targets) > 1:
            self.send("S")
        orders = [self.send(f"{'PT'[axis]}P{steps}") for axis, steps, _ in targets]
        if len(targets) > 1:
            orders = [self.send("I")] * len(targets)
        ends_s = [self._start(*target, at_s) for target, at_s in zip(targets, orders, strict=True)]
        self.poll_for(max(ends_s, default=0.0) - self.now_s)
        for _ in range(4):  # two replies of each axis at its target end a move
            self._poll()
        if isinstance(step, Move):
            self.poll_for(step.settle_s)

    def session(self) -> SerialSession:
        """Return the whole session."""
        columns = [np.array(column) for column in zip(*self.polls, strict=True)]
        axis = columns[4].astype(np.int64)
        counts = [1 + sum(move.axis == k for move in self.moves) for k in (0, 1)]
        return SerialSession(
            exchanges=tuple(self.exchanges),
            polls=Polls(columns[0], columns[1], columns[2], columns[3], axis),
            moves=tuple(self.moves),
            off_steps=(
                self.rng.normal(scale=DETENT_STEPS, size=counts[0]),
                self.rng.normal(scale=DETENT_STEPS, size=counts[1]),
            ),
            base_steps_s=self.base,
            ramp_steps_s2=self.ramp,
            count_lag=self.count_lag,
            count_shift=self.count_shift,
            common_s=(self.share - 0.5) * self.least_s,
            end_s=self.now_s,
        )

    def _start(self, axis: int, target: int, speed: int, told_s: float) -> float:
        """Start a move; return when the axis is at rest."""
        if target == self.where[axis]:
            return told_s
        scale = self.speed_scale.setdefault(
            (axis, speed), float(np.exp(self.rng.normal(scale=LOG_SPEED_STD)))
        )
        move = Trapezoid(
            axis,
            told_s + self.start_s + float(self.rng.uniform(0.0, START_SCATTER_S)),
            self.where[axis],
            target,
            speed * scale,
            self.true_ramp[axis],
            self.true_base[axis],
        )
        self.moves.append(move)
        self.where[axis] = target
        return move.end_s + self.rounding_s[axis]

    def _targets(self, step: Move | Home) -> list[tuple[int, int, int]]:
        """Return axis, target and speed in steps of each axis that a command moves."""
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

    def _poll(self) -> None:
        request_s = self.now_s
        arrived_s = request_s + QUERY_BYTES * self.byte_s
        thought_s = self._thought()
        late_s = float(self.rng.uniform()) * (thought_s - self.least_s)
        instant_s = arrived_s + self.share * self.least_s + late_s
        first_s = arrived_s + thought_s + self.byte_s + self._read()
        size = BOTH_BYTES if self.has_counter else ONE_BYTES
        last_s = first_s + (size - 1) * self.byte_s
        axis = BOTH_AXES if self.has_counter else self.next_axis
        self.next_axis = 1 - self.next_axis
        self.polls.append((request_s, first_s, last_s, instant_s, axis))
        self._go_on(last_s)

    def _thought(self) -> float:
        return self.least_s + float(self.rng.exponential(EXTRA_THOUGHT_S))

    def _read(self) -> float:
        return float(self.rng.exponential(READ_S))

    def _go_on(self, replied_s: float) -> None:
        pause_s = HOST_S + float(self.rng.exponential(HOST_S))
        self.now_s = max(self.now_s + MAKERS_INTERVAL_S, replied_s) + pause_s


def _steps(angle_deg: float) -> int:
    return round(float(np.radians(angle_deg)) / RAD_PER_STEP)
