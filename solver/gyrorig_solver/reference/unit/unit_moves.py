"""The moves of a pan-tilt unit, reconstructed from its orders and settings.

Targets, speeds, acceleration and base speed of a move are known from commands and settings. The
times at which the commands act are not known; `move_fit` estimates them. A move goes from rest to
rest; targets, speeds and halts commanded in motion belong to it. The position after a halt is
taken from the polled counts.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_protocol.motion_orders import AxisOrder, OrderAxis, OrderKind
from gyrorig_solver.data import FloatArray
from gyrorig_solver.reference.unit.motion_law import MotionLaw
from gyrorig_solver.reference.unit.motion_profile import (
    CommandKind,
    MotionLimits,
    MotionProfile,
    ProfileCommand,
    plan_motion,
)

AXES = ("pan", "tilt")
# A command within this time after the predicted rest can arrive while the axis still moves.
_REST_MARGIN_S = 0.02
# of the margin for slow controllers; the reply to an awaited move comes at its end
_MAX_REPLY_WAIT_S = 0.2
_REST_LOOKBACK_S = 0.5

RestCountLookup = Callable[
    [int, float, float], int | None
]  # axis, after, before -> polled count or None


@dataclass(frozen=True, slots=True)
class UnitOrder:
    """One order and its reply, times in s on the capture clock."""

    request_s: float  # transmission of its last byte
    reply_s: float
    accepted: bool
    order: AxisOrder


@dataclass(frozen=True, slots=True)
class MotionCommand:
    """One command that starts or changes a move."""

    command_time_s: float  # time of the command
    start_time_s: float  # time at which it acts, as far as known
    kind: CommandKind
    steps: float
    speed_steps_s: float
    speed_class: int  # commands with the same speed on the same axis share a class


@dataclass(frozen=True, slots=True)
class Move:
    """One move of one axis between two rests."""

    axis: int  # 0 pan, 1 tilt
    from_steps: int
    to_steps: int
    commands: tuple[MotionCommand, ...]
    acceleration_steps_s2: float
    base_speed_steps_s: float

    @property
    def command_time_s(self) -> float:
        """Time of the first command."""
        return self.commands[0].command_time_s

    @property
    def start_times_s(self) -> FloatArray:
        """Times at which the commands act."""
        return np.array([command.start_time_s for command in self.commands])

    @property
    def speed_classes(self) -> tuple[int, ...]:
        """The speed classes of the commands, each once."""
        return tuple(dict.fromkeys(command.speed_class for command in self.commands))

    def with_law(self, law: MotionLaw) -> "Move":
        """Return the move with the limits of a motion law."""
        base_steps_s = self.base_speed_steps_s + law.base_speed_steps_s[self.axis]
        return replace(
            self,
            acceleration_steps_s2=self.acceleration_steps_s2
            * (1.0 + law.acceleration_share[self.axis]),
            base_speed_steps_s=max(0.0, base_steps_s),
        )

    def profile(
        self, start_times_s: FloatArray, log_speed: FloatArray, log_acceleration: float
    ) -> MotionProfile:
        """Return the profile, with speeds and acceleration changed by these logarithms.

        Args:
            start_times_s: times at which the commands act, shape (commands,).
            log_speed: of every speed class, shape (classes,).
            log_acceleration: of this axis.
        """
        acceleration = self.acceleration_steps_s2 * float(np.exp(log_acceleration))
        factor = np.exp(log_speed)
        commands = [
            ProfileCommand(
                float(at),
                command.kind,
                command.steps,
                MotionLimits(
                    command.speed_steps_s * float(factor[command.speed_class]),
                    acceleration,
                    self.base_speed_steps_s,
                ),
            )
            for at, command in zip(start_times_s, self.commands, strict=True)
        ]
        return plan_motion(float(self.from_steps), commands)


@dataclass(frozen=True, slots=True, eq=False)
class UnitMotion:
    """All moves, and the spans of unknown motion."""

    moves: tuple[Move, ...]
    initial_steps: tuple[int, int]  # pan and tilt before the first move
    unknown_spans: tuple[tuple[float, float, str], ...]  # begin, end, reason
    speed_class_count: int
    count_resets: tuple[tuple[float, int, int], ...] = ()  # time, axis, count after homing


def with_start_times(moves: Iterable[Move], start_times_s: FloatArray) -> tuple[Move, ...]:
    """Return the moves with new start times of all their commands."""
    result, first = [], 0
    for move in moves:
        times = start_times_s[first : first + len(move.commands)]
        commands = (
            replace(command, start_time_s=float(at))
            for command, at in zip(move.commands, times, strict=True)
        )
        result.append(replace(move, commands=tuple(commands)))
        first += len(move.commands)
    return tuple(result)


class _AxisState:
    """Settings and current move of one axis."""

    def __init__(self, index: int, settings: Mapping[str, float], steps: int) -> None:
        name = AXES[index]
        self.index = index
        self.name = name
        self.speed: float | None = settings.get(f"{name}_speed")
        self.base_speed = max(0.0, settings.get(f"{name}_base_speed", 0.0))
        self.acceleration: float | None = settings.get(f"{name}_acceleration")
        self.range_steps = (
            settings.get(f"{name}_min_steps", -1e6),
            settings.get(f"{name}_max_steps", 1e6),
        )
        self.steps = steps  # the last rest position
        self.pending: tuple[CommandKind, float] | None = None
        self.commands: list[MotionCommand] = []  # of the current move
        self.end_s = -np.inf
        # the last result of `move`, and its end
        self._planned_move: tuple[Move, float] | None = None

    def move(self) -> Move:
        """Return the current move as commanded."""
        commands = tuple(self.commands)
        if self._planned_move is None or self._planned_move[0].commands != commands:
            acceleration = self.acceleration or 1.0
            move = Move(self.index, self.steps, self.steps, commands, acceleration, self.base_speed)
            no_change = np.zeros(1 + max(move.speed_classes))
            profile = move.profile(move.start_times_s, no_change, 0.0)
            to_steps = round(float(profile.start_steps[-1]))
            self._planned_move = replace(move, to_steps=to_steps), profile.end_s
        move, self.end_s = self._planned_move
        return move


class MotionReader:
    """Converts orders to moves, in the order of time."""

    def __init__(
        self,
        settings: Mapping[str, float],
        initial_steps: tuple[int, int],
        rest_count: RestCountLookup = lambda axis, after_s, before_s: None,
    ) -> None:
        """Start with the settings in the recording's metadata and the counts at rest."""
        self._initial_steps, self._rest_count = initial_steps, rest_count
        self._axes = [_AxisState(k, settings, steps) for k, steps in enumerate(initial_steps)]
        self._is_collecting = False
        self._moves: list[Move] = []
        self._unknown_spans: list[tuple[float, float, str]] = []
        self._count_resets: list[tuple[float, int, int]] = []
        self._speed_classes: dict[tuple[int, float], int] = {}

    def read(self, orders: Iterable[UnitOrder]) -> UnitMotion:
        """Return the motion that the orders command."""
        for order in orders:
            if order.accepted:
                self._apply(order)
        for axis in self._axes:
            self._finish_move(axis, np.inf)
        return UnitMotion(
            tuple(sorted(self._moves, key=lambda move: move.command_time_s)),
            self._initial_steps,
            tuple(self._unknown_spans),
            max(1, len(self._speed_classes)),
            tuple(self._count_resets),
        )

    def _apply(self, order: UnitOrder) -> None:
        kind = order.order.kind
        if kind is OrderKind.COLLECT:
            self._is_collecting = True
        elif kind in (OrderKind.START, OrderKind.IMMEDIATE):
            self._is_collecting = self._is_collecting and kind is OrderKind.START
            for axis in self._axes:
                if axis.pending is not None:
                    self._add_command(order, axis, *axis.pending)
                    axis.pending = None
        elif kind is OrderKind.RESOLUTION:
            self._mark_unknown(order.request_s, np.inf, "the step mode was changed")
        else:
            for axis in self._axes:
                if order.order.axis in (OrderAxis.BOTH, axis.index):
                    self._apply_to_axis(order, axis)

    def _apply_to_axis(self, order: UnitOrder, axis: _AxisState) -> None:
        kind, value = order.order.kind, order.order.value
        if kind in (OrderKind.TARGET, OrderKind.OFFSET):
            if not np.isnan(order.order.speed_steps_s):
                axis.speed = order.order.speed_steps_s
            self._set_target(order, axis, "by" if kind is OrderKind.OFFSET else "to", value)
        elif kind is OrderKind.SPEED:
            self._set_speed(order, axis, value)
        elif kind is OrderKind.RATE:
            self._set_rate(order, axis, value)
        elif kind in (OrderKind.SPEED_CHANGE, OrderKind.RATE_CHANGE):
            self._change_speed(order, axis, value, kind is OrderKind.RATE_CHANGE)
        elif kind in (OrderKind.ACCELERATION, OrderKind.BASE_SPEED):
            self._may_be_moving(order, axis)  # a finished move used the old setting
            if kind is OrderKind.ACCELERATION:
                axis.acceleration = value
            else:
                axis.base_speed = max(0.0, value)
        elif kind is OrderKind.HALT:
            self._halt_axis(order, axis)
        elif kind is OrderKind.HOME:
            self._home_axis(order, axis)

    def _set_speed(self, order: UnitOrder, axis: _AxisState, value: float) -> None:
        previous, axis.speed = axis.speed, abs(value)
        is_moving = self._may_be_moving(order, axis)
        if is_moving and not self._is_collecting and axis.speed != previous:
            self._add_command(order, axis, "keep", 0)

    def _set_rate(self, order: UnitOrder, axis: _AxisState, value: float) -> None:
        """Turn until the end of travel; a rate of 0 stops and keeps the speed of moves."""
        if value == 0:
            self._halt_axis(order, axis)
        else:
            axis.speed = abs(value)
            self._add_command(order, axis, "to", axis.range_steps[value > 0])

    def _change_speed(
        self, order: UnitOrder, axis: _AxisState, value: float, is_rate: bool
    ) -> None:
        """Set a speed by an offset, which is valid at rest only; in motion it is unknown."""
        if not self._may_be_moving(order, axis):
            (self._set_rate if is_rate else self._set_speed)(order, axis, value)
            return
        axis.speed = None
        self._mark_unknown(order.request_s, np.inf, "an offset command changed a speed")

    def _set_target(
        self, order: UnitOrder, axis: _AxisState, kind: CommandKind, value: float
    ) -> None:
        if self._is_collecting:
            axis.pending = (kind, value)
        else:
            self._add_command(order, axis, kind, value)

    def _halt_axis(self, order: UnitOrder, axis: _AxisState) -> None:
        axis.pending = None
        if self._may_be_moving(order, axis):
            self._add_command(order, axis, "stop", 0)

    def _home_axis(self, order: UnitOrder, axis: _AxisState) -> None:
        self._finish_move(axis, order.request_s)
        self._mark_unknown(
            order.request_s - _REST_MARGIN_S, order.reply_s + 0.1, "the unit was homed"
        )
        self._count_resets.append((order.reply_s, axis.index, 0))
        axis.steps, axis.pending = 0, None

    def _may_be_moving(self, order: UnitOrder, axis: _AxisState) -> bool:
        """Return whether the axis can still move; finish a move that has ended."""
        if axis.commands and order.request_s > axis.end_s:
            self._finish_move(axis, order.request_s)
        return bool(axis.commands)

    def _add_command(
        self, order: UnitOrder, axis: _AxisState, kind: CommandKind, steps: float
    ) -> None:
        is_moving = self._may_be_moving(order, axis)
        if not is_moving:
            self._adopt_polled_rest(order, axis)
            target = steps + (axis.steps if kind == "by" else 0)
            if target == axis.steps:
                return
            kind, steps = "to", target
        for name, value in (("speed", axis.speed), ("acceleration", axis.acceleration)):
            if value is None or not value > 0.0:
                self._mark_unknown(
                    order.request_s, np.inf, f"the {name} of the {axis.name} axis was never set"
                )
                return
        key = (axis.index, axis.speed or 0.0)
        speed_class = self._speed_classes.setdefault(key, len(self._speed_classes))
        axis.commands.append(
            MotionCommand(
                order.request_s,
                order.request_s,
                kind,
                float(steps),
                axis.speed or 0.0,
                speed_class,
            )
        )
        axis.move()
        wait_s = min(max(order.reply_s - order.request_s, 0.0), _MAX_REPLY_WAIT_S)
        axis.end_s += _REST_MARGIN_S + wait_s

    def _adopt_polled_rest(self, order: UnitOrder, axis: _AxisState) -> None:
        """Use the counts polled at rest if no command explains the position."""
        after_s = max(axis.end_s, order.request_s - _REST_LOOKBACK_S)
        rest_count = self._rest_count(axis.index, after_s, order.request_s)
        if rest_count is not None and abs(rest_count - axis.steps) > 1:
            axis.steps = rest_count

    def _finish_move(self, axis: _AxisState, until_s: float) -> None:
        """Finish the current move; after a halt, its end is taken from the counts."""
        if not axis.commands:
            return
        after_s = axis.end_s
        last_command = axis.commands[-1]
        if last_command.kind == "stop" or any(command.kind == "by" for command in axis.commands):
            rest_count = self._rest_count(axis.index, after_s, until_s)
            if rest_count is not None:
                # A halted axis covers the same distance as in a move to the position of the stop.
                if last_command.kind == "stop" and len(axis.commands) > 1:
                    last_command = axis.commands[-2]
                    axis.commands.pop()
                axis.commands[-1] = replace(last_command, kind="to", steps=float(rest_count))
            else:
                reason = (
                    "the recording has no position after a halt or an offset command during a move"
                )
                self._mark_unknown(axis.commands[0].command_time_s, until_s, reason)
        move = axis.move()
        if move.to_steps != move.from_steps or len(move.commands) > 1:
            self._moves.append(move)
        axis.steps, axis.commands = move.to_steps, []

    def _mark_unknown(self, begin_s: float, end_s: float, reason: str) -> None:
        self._unknown_spans.append((float(begin_s), float(end_s), reason))
