"""Derivatives of a motion profile by its start times, speeds, acceleration and base speed.

Between two commands a move is one profile that starts at the state at the first command. The
derivatives of that profile by the state, a log speed, a log acceleration and the base speed are
differences, exact to about 1e-6 of the speeds. The chain rule propagates them from command to
command; therefore the cost is proportional to the number of commands.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.reference.unit.motion_profile import (
    CommandKind,
    MotionLimits,
    MotionProfile,
    plan_from_state,
)
from gyrorig_solver.reference.unit.unit_moves import Move

_POSITION_STEP = 1e-3
_SPEED_STEP = 1e-2
_LOG_STEP = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class ProfileDerivatives:
    """Derivatives of the position of a move, each of the shape of the times."""

    starts: FloatArray  # (orders, n), steps/s
    speeds: FloatArray  # (classes of the move, n), steps per log speed
    acceleration: FloatArray  # (n,), steps per log acceleration
    base_speed: FloatArray  # (n,), s


@dataclass(frozen=True, slots=True)
class _CommandPiece:
    """The profile of one command from the state at its start."""

    begin_s: float
    end_s: float  # start of the next command
    start_index: int  # index of the start time; that of the predecessor if dated too early
    state: tuple[float, float]  # steps and speed at the beginning
    kind: CommandKind
    target: float
    limits: MotionLimits
    speed_class: int

    def profile(
        self,
        steps: float = 0.0,
        speed_steps_s: float = 0.0,
        log_speed: float = 0.0,
        log_acceleration: float = 0.0,
        base_speed_steps_s: float = 0.0,
    ) -> MotionProfile:
        """Return the profile with changed parameters."""
        limits = MotionLimits(
            self.limits.speed_steps_s * float(np.exp(log_speed)),
            self.limits.acceleration_steps_s2 * float(np.exp(log_acceleration)),
            self.limits.base_speed_steps_s + base_speed_steps_s,
        )
        state = (self.begin_s, self.state[0] + steps, self.state[1] + speed_steps_s)
        return plan_from_state(state, self.kind, self.target, limits)

    def change(self, time_s: FloatArray, **step: float) -> tuple[FloatArray, FloatArray]:
        """Return the derivatives of the positions and of the final state by one parameter."""
        ((name, size),) = step.items()
        backward = size
        if name == "base_speed_steps_s":  # the base speed cannot be negative
            backward = min(size, self.limits.base_speed_steps_s)
        ahead, behind = self.profile(**{name: size}), self.profile(**{name: -backward})
        position = ahead.position_steps(time_s) - behind.position_steps(time_s)
        if not np.isfinite(self.end_s):
            return position / (size + backward), np.zeros(2)
        end = np.subtract(ahead.state_at(self.end_s)[:2], behind.state_at(self.end_s)[:2])
        return position / (size + backward), end / (size + backward)


def differentiate_move(
    move: Move,
    start_times_s: FloatArray,
    log_speed: FloatArray,
    log_acceleration: float,
    time_s: FloatArray,
) -> ProfileDerivatives:
    """Return the derivatives of `move.profile(...)` at times."""
    command_count, classes = len(move.commands), move.speed_classes
    derivatives = np.zeros((command_count + len(classes) + 2, time_s.size))
    # Derivatives of steps and speed at the start of a command, by every unknown.
    state_derivatives = np.zeros((2, derivatives.shape[0]))
    pieces = _command_pieces(move, start_times_s, log_speed, log_acceleration)
    for piece, following in zip(pieces, [*pieces[1:], None], strict=True):
        rows = np.flatnonzero((time_s >= piece.begin_s) & (time_s < piece.end_s))
        inside, row = time_s[rows], command_count + classes.index(piece.speed_class)
        profile = piece.profile()
        steps, by_steps = piece.change(inside, steps=_POSITION_STEP)
        speed, by_speed = piece.change(inside, speed_steps_s=_SPEED_STEP)
        by_log_speed_position, by_log_speed = piece.change(inside, log_speed=_LOG_STEP)
        by_log_acceleration_position, by_log_acceleration = piece.change(
            inside, log_acceleration=_LOG_STEP
        )
        by_base_position, by_base = piece.change(inside, base_speed_steps_s=_SPEED_STEP)
        derivatives[:, rows] = np.outer(state_derivatives[0], steps) + np.outer(
            state_derivatives[1], speed
        )
        derivatives[piece.start_index, rows] -= profile.speed_steps_s(inside)
        derivatives[row, rows] += by_log_speed_position
        derivatives[-2, rows] += by_log_acceleration_position
        derivatives[-1, rows] += by_base_position
        if following is None:
            break
        state_derivatives = np.outer(by_steps, state_derivatives[0]) + np.outer(
            by_speed, state_derivatives[1]
        )
        moving = np.array(profile.state_at(piece.end_s)[1:])
        state_derivatives[:, piece.start_index] -= moving
        state_derivatives[:, row] += by_log_speed
        state_derivatives[:, -2] += by_log_acceleration
        state_derivatives[:, -1] += by_base
        # A later start of the next command changes its initial state.
        state_derivatives[:, following.start_index] += moving
    return ProfileDerivatives(
        derivatives[:command_count],
        derivatives[command_count:-2],
        derivatives[-2],
        derivatives[-1],
    )


def _command_pieces(
    move: Move, start_times_s: FloatArray, log_speed: FloatArray, log_acceleration: float
) -> list[_CommandPiece]:
    """Return the commands of a move, each with the state at its start."""
    begin_times_s = [*np.maximum.accumulate(start_times_s).tolist(), np.inf]
    acceleration = move.acceleration_steps_s2 * float(np.exp(log_acceleration))
    state, target = (float(move.from_steps), 0.0), float(move.from_steps)
    pieces: list[_CommandPiece] = []
    start_index, is_halted = 0, False
    for k, command in enumerate(move.commands):
        begin_s, end_s = begin_times_s[k], begin_times_s[k + 1]
        if k and begin_s > begin_times_s[k - 1]:
            start_index = k
        if command.kind in ("to", "by"):
            target = command.steps if command.kind == "to" else round(state[0] + command.steps)
        # A new speed does not cancel a halt; the axis continues to brake.
        is_halted = command.kind == "stop" or (is_halted and command.kind == "keep")
        speed = command.speed_steps_s * float(np.exp(log_speed[command.speed_class]))
        limits = MotionLimits(speed, acceleration, move.base_speed_steps_s)
        kind: CommandKind = "stop" if is_halted else "to"
        piece = _CommandPiece(
            begin_s, end_s, start_index, state, kind, target, limits, command.speed_class
        )
        if end_s > begin_s:
            pieces.append(piece)
            if np.isfinite(end_s):
                state = piece.profile().state_at(end_s)[:2]
    return pieces
