"""How a move's position changes with what is not known of it.

Between two orders a move is one course from the state in which the first order found the
axis. That course's change with the state, a log speed and a log acceleration is found by
central differences, exact to some 1e-6 of the speeds; the chain rule carries it on from order
to order, so the cost grows with the number of orders and not with its square.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.reference.course import Course, Kind, Limits, carry_on
from gyrorig_solver.reference.moves import Move

_STEPS = 1e-3
_STEPS_S = 1e-2
_LOG_STEP = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class Slopes:
    """Derivatives of a move's position at some times, each column of the times' shape."""

    starts: FloatArray  # (orders, n), steps/s
    speeds: FloatArray  # (classes of the move, n), steps per log speed
    acceleration: FloatArray  # (n,), steps per log acceleration


@dataclass(frozen=True, slots=True)
class _Piece:
    """What one order makes of the state in which it finds the axis."""

    begin_s: float
    end_s: float  # when the next order takes hold
    owner: int  # the order whose start it is; one dated before its forerunner acts with it
    state: tuple[float, float]  # steps and speed at its begin
    kind: Kind
    target: float
    limits: Limits
    speed_class: int

    def course(
        self,
        steps: float = 0.0,
        speed_steps_s: float = 0.0,
        log_speed: float = 0.0,
        log_acceleration: float = 0.0,
    ) -> Course:
        """Return the course, something of it being off."""
        limits = Limits(
            self.limits.speed_steps_s * float(np.exp(log_speed)),
            self.limits.acceleration_steps_s2 * float(np.exp(log_acceleration)),
            self.limits.base_speed_steps_s,
        )
        state = (self.begin_s, self.state[0] + steps, self.state[1] + speed_steps_s)
        return carry_on(state, self.kind, self.target, limits)

    def change(self, time_s: FloatArray, **step: float) -> tuple[FloatArray, FloatArray]:
        """Return how position at times, and the state at the end, change with one thing."""
        ((name, size),) = step.items()
        ahead, behind = self.course(**{name: size}), self.course(**{name: -size})
        position = ahead.position_steps(time_s) - behind.position_steps(time_s)
        if not np.isfinite(self.end_s):
            return position / (2.0 * size), np.zeros(2)
        end = np.subtract(ahead.state(self.end_s)[:2], behind.state(self.end_s)[:2])
        return position / (2.0 * size), end / (2.0 * size)


def slopes(
    move: Move,
    starts_s: FloatArray,
    log_speed: FloatArray,
    log_acceleration: float,
    time_s: FloatArray,
) -> Slopes:
    """Return the derivatives of `move.course(...)` at times."""
    orders, classes = len(move.orders), move.classes
    found = np.zeros((orders + len(classes) + 1, time_s.size))
    # How steps and speed change, where an order takes hold, with every unknown.
    carried = np.zeros((2, found.shape[0]))
    pieces = _pieces(move, starts_s, log_speed, log_acceleration)
    for piece, following in zip(pieces, [*pieces[1:], None], strict=True):
        at = np.flatnonzero((time_s >= piece.begin_s) & (time_s < piece.end_s))
        inside, row = time_s[at], orders + classes.index(piece.speed_class)
        here = piece.course()
        steps, by_steps = piece.change(inside, steps=_STEPS)
        speed, by_speed = piece.change(inside, speed_steps_s=_STEPS_S)
        upper, by_upper = piece.change(inside, log_speed=_LOG_STEP)
        ramp, by_ramp = piece.change(inside, log_acceleration=_LOG_STEP)
        found[:, at] = np.outer(carried[0], steps) + np.outer(carried[1], speed)
        found[piece.owner, at] -= here.speed_steps_s(inside)
        found[row, at] += upper
        found[-1, at] += ramp
        if following is None:
            break
        carried = np.outer(by_steps, carried[0]) + np.outer(by_speed, carried[1])
        moving = np.array(here.state(piece.end_s)[1:])
        carried[:, piece.owner] -= moving
        carried[:, row] += by_upper
        carried[:, -1] += by_ramp
        # The next order finds the axis further on by as much as it is later.
        carried[:, following.owner] += moving
    return Slopes(found[:orders], found[orders:-1], found[-1])


def _pieces(
    move: Move, starts_s: FloatArray, log_speed: FloatArray, log_acceleration: float
) -> list[_Piece]:
    """Return a move's orders, each with the state in which it finds the axis."""
    begins_s = [*np.maximum.accumulate(starts_s).tolist(), np.inf]
    acceleration = move.acceleration_steps_s2 * float(np.exp(log_acceleration))
    state, target = (float(move.from_steps), 0.0), float(move.from_steps)
    pieces: list[_Piece] = []
    owner, halted = 0, False
    for k, order in enumerate(move.orders):
        begin_s, end_s = begins_s[k], begins_s[k + 1]
        if k and begin_s > begins_s[k - 1]:
            owner = k
        if order.kind in ("to", "by"):
            target = order.steps if order.kind == "to" else round(state[0] + order.steps)
        # A new speed does not undo a halt: the axis brakes on to where that ends.
        halted = order.kind == "stop" or (halted and order.kind == "keep")
        speed = order.speed_steps_s * float(np.exp(log_speed[order.speed_class]))
        limits = Limits(speed, acceleration, move.base_speed_steps_s)
        kind: Kind = "stop" if halted else "to"
        piece = _Piece(begin_s, end_s, owner, state, kind, target, limits, order.speed_class)
        if end_s > begin_s:
            pieces.append(piece)
            if np.isfinite(end_s):
                state = piece.course().state(end_s)[:2]
    return pieces
