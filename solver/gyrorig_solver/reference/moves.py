"""From what the controller was told to the moves that it made.

Commands and settings are evidence: a move has its targets, speeds, acceleration and base
speed from them; only when each order took hold is not said (see `polls`). A move goes from
a rest to a rest; targets, speeds and halts given on the way belong to it. Where it came to
rest after a halt is not said either: the counts polled there are asked.
"""

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.reference.course import Course, Instruction, Kind, Limits, lay

AXES = ("pan", "tilt")
_SETTING = re.compile(r"([PT])([SABPOD])([-+]?\d+)\s*")
_BOTH = re.compile(r"B([-+]?\d+),([-+]?\d+),(\d+),(\d+)\s*")
_START = re.compile(r"[AI]\s*")
_SLAVED = re.compile(r"S\s*")
_HALT = re.compile(r"H[PT]?\s*")
_CONTROL = re.compile(r"C[IV]\s*")
_HOME = re.compile(r"R[PT]?\s*")
_STEP_MODE = re.compile(r"W([PT])[FHQEA]\s*")
# An order that comes this soon after the predicted rest may still find the axis moving.
_MARGIN_S = 0.02
_LONGEST_WAIT_S = 0.2  # of the margin for slow controllers; an awaited move answers at its end
_LOOK_S = 0.5

Resting = Callable[[int, float, float], int | None]  # axis, after, before -> count, if polled


@dataclass(frozen=True, slots=True)
class Exchange:
    """One command and its answer, times in s on the capture clock."""

    request_s: float  # when its last byte was on the line
    reply_s: float
    ok: bool
    command: str


@dataclass(frozen=True, slots=True)
class Order:
    """One command that set an axis off or changed its way."""

    told_s: float  # when it was written
    start_s: float  # when it took hold, as well as is known
    kind: Kind
    steps: float
    speed_steps_s: float
    speed_class: int  # orders told the same speed on the same axis share one


@dataclass(frozen=True, slots=True)
class Move:
    """One move of one axis between two rests."""

    axis: int  # 0 pan, 1 tilt
    from_steps: int
    to_steps: int
    orders: tuple[Order, ...]
    acceleration_steps_s2: float
    base_speed_steps_s: float

    @property
    def told_s(self) -> float:
        """When the first order was written."""
        return self.orders[0].told_s

    @property
    def starts_s(self) -> FloatArray:
        """When each order took hold."""
        return np.array([order.start_s for order in self.orders])

    @property
    def classes(self) -> tuple[int, ...]:
        """The speed classes that take part, each once."""
        return tuple(dict.fromkeys(order.speed_class for order in self.orders))

    def course(
        self, starts_s: FloatArray, log_speed: FloatArray, log_acceleration: float
    ) -> Course:
        """Return the way, speeds and acceleration being off by these logarithms.

        Args:
            starts_s: when each order takes hold, shape (orders,).
            log_speed: of every speed class, shape (classes,).
            log_acceleration: of this axis.
        """
        acceleration = self.acceleration_steps_s2 * float(np.exp(log_acceleration))
        factor = np.exp(log_speed)
        told = [
            Instruction(
                float(at),
                order.kind,
                order.steps,
                Limits(
                    order.speed_steps_s * float(factor[order.speed_class]),
                    acceleration,
                    self.base_speed_steps_s,
                ),
            )
            for at, order in zip(starts_s, self.orders, strict=True)
        ]
        return lay(float(self.from_steps), told)


@dataclass(frozen=True, slots=True)
class Rest:
    """One rest of one axis: from the move that came here to the move that left."""

    axis: int
    arrival: int | None  # index of the move, None for the rest before the first
    departure: int | None


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """All moves, and the spans in which the motion is not known from the commands."""

    moves: tuple[Move, ...]
    rest_steps: tuple[int, int]  # where pan and tilt stood before the first move
    unknown: tuple[tuple[float, float, str], ...]  # begin, end, why
    classes: int
    recounts: tuple[tuple[float, int, int], ...] = ()  # time, axis, count after homing

    @property
    def rests(self) -> tuple[Rest, ...]:
        """Every rest of both axes, in the order of axes and time."""
        found = []
        for axis in (0, 1):
            own = [k for k, move in enumerate(self.moves) if move.axis == axis]
            pairs = zip([None, *own], [*own, None], strict=True)
            found += [Rest(axis, arrival, departure) for arrival, departure in pairs]
        return tuple(found)


def started(moves: Iterable[Move], starts_s: FloatArray) -> tuple[Move, ...]:
    """Return the moves with the starts of all their orders replaced, in their order."""
    found, first = [], 0
    for move in moves:
        own = starts_s[first : first + len(move.orders)]
        orders = (
            replace(order, start_s=float(at)) for order, at in zip(move.orders, own, strict=True)
        )
        found.append(replace(move, orders=tuple(orders)))
        first += len(move.orders)
    return tuple(found)


class _Axis:
    """What one axis has been told so far."""

    def __init__(self, letter: str, settings: Mapping[str, float], steps: int) -> None:
        name = AXES["PT".index(letter)]
        self.index = "PT".index(letter)
        self.letter = letter
        self.speed: float | None = settings.get(f"{name}_speed")
        self.base = max(0.0, settings.get(f"{name}_base_speed", 0.0))
        self.acceleration: float | None = settings.get(f"{name}_acceleration")
        self.reach = (
            settings.get(f"{name}_min_steps", -1e6),
            settings.get(f"{name}_max_steps", 1e6),
        )
        self.steps = steps  # where it last stood
        self.pending: tuple[Kind, int] | None = None
        self.orders: list[Order] = []  # of the move under way
        self.busy_until_s = -np.inf
        self._laid: tuple[Move, float] | None = None  # what `move` found last, and its end

    def move(self) -> Move:
        """Return the move under way as it was told."""
        told = self.orders
        if self._laid is not None and self._laid[0].orders == tuple(told):
            found, self.busy_until_s = self._laid
            return found
        course = lay(
            float(self.steps),
            [Instruction(o.told_s, o.kind, o.steps, self.limits(o.speed_steps_s)) for o in told],
        )
        self.busy_until_s = course.end_s
        found = Move(
            self.index,
            self.steps,
            round(float(course.steps[-1])),
            tuple(told),
            self.acceleration or 1.0,
            self.base,
        )
        self._laid = found, course.end_s
        return found

    def limits(self, speed_steps_s: float) -> Limits:
        """Return what an order at a speed is carried out with."""
        return Limits(speed_steps_s, self.acceleration or 1.0, self.base)


class MotionReader:
    """Turn exchanges into moves, in the order in which they were made."""

    def __init__(
        self,
        settings: Mapping[str, float],
        rest_steps: tuple[int, int],
        resting: Resting = lambda axis, after_s, before_s: None,
    ) -> None:
        """Begin with the settings of the recording's metadata and the counts at rest.

        Args:
            settings: by name of axis and setting.
            rest_steps: where pan and tilt stood at first.
            resting: the count that an axis showed at rest between two times.
        """
        self._rest, self._resting = rest_steps, resting
        self._axes = {p: _Axis(p, settings, s) for p, s in zip("PT", rest_steps, strict=True)}
        self._slaved = self._velocity = False
        self._moves: list[Move] = []
        self._unknown: list[tuple[float, float, str]] = []
        self._recounts: list[tuple[float, int, int]] = []
        self._classes: dict[tuple[str, float], int] = {}

    def read(self, exchanges: Iterable[Exchange]) -> Motion:
        """Return the motion that `exchanges` tell of."""
        for exchange in exchanges:
            if exchange.ok:
                self._take(exchange)
        for axis in self._axes.values():
            self._close(axis, np.inf)
        return Motion(
            tuple(sorted(self._moves, key=lambda move: move.told_s)),
            self._rest,
            tuple(self._unknown),
            max(1, len(self._classes)),
            tuple(self._recounts),
        )

    def _take(self, exchange: Exchange) -> None:
        text = exchange.command.strip().upper()
        if match := _SETTING.fullmatch(text):
            self._setting(exchange, self._axes[match[1]], match[2], int(match[3]))
        elif match := _BOTH.fullmatch(text):
            for k, axis in enumerate(self._axes.values()):
                axis.speed = float(match[3 + k])
                self._target(exchange, axis, "to", int(match[1 + k]))
        elif _SLAVED.fullmatch(text):
            self._slaved = True
        elif _START.fullmatch(text):
            self._slaved = self._slaved and text[0] == "A"
            for axis in self._axes.values():
                if axis.pending is not None:
                    self._order(exchange, axis, *axis.pending)
                    axis.pending = None
        else:
            self._take_rare(exchange, text)

    def _take_rare(self, exchange: Exchange, text: str) -> None:
        if _HALT.fullmatch(text):
            for axis in self._named(text[1:2]):
                self._halt(exchange, axis)
        elif _CONTROL.fullmatch(text):
            if self._velocity != (text[1] == "V"):
                for axis in self._axes.values():
                    self._halt(exchange, axis)
            self._velocity = text[1] == "V"
        elif _HOME.fullmatch(text):
            for axis in self._named(text[1:2]):
                self._home(exchange, axis)
        elif _STEP_MODE.fullmatch(text):
            self._lose(exchange.request_s, np.inf, "the step mode was changed")

    def _named(self, letter: str) -> list[_Axis]:
        return [axis for axis in self._axes.values() if letter in ("", axis.letter)]

    def _setting(self, exchange: Exchange, axis: _Axis, kind: str, number: int) -> None:
        if kind == "S":
            self._speed(exchange, axis, number)
        elif kind == "D":
            self._speed_change(exchange, axis, number)
        elif kind in "AB":
            self._moving(exchange, axis)  # a move that is over was made with the old one
            if kind == "A":
                axis.acceleration = float(number)
            else:
                axis.base = max(0.0, float(number))
        else:
            self._target(exchange, axis, "by" if kind == "O" else "to", number)

    def _speed(self, exchange: Exchange, axis: _Axis, number: int) -> None:
        before, axis.speed = axis.speed, float(abs(number))
        if self._velocity:
            if number == 0:
                axis.speed = before
                self._halt(exchange, axis)
            else:
                self._order(exchange, axis, "to", axis.reach[number > 0])
        elif self._moving(exchange, axis) and not self._slaved and axis.speed != before:
            self._order(exchange, axis, "keep", 0)

    def _speed_change(self, exchange: Exchange, axis: _Axis, number: int) -> None:
        """From rest, a change is the speed itself; on the way it adds to an unknown one."""
        if not self._moving(exchange, axis):
            self._speed(exchange, axis, number)
            return
        axis.speed = None
        self._lose(exchange.request_s, np.inf, "a speed was changed by a difference")

    def _target(self, exchange: Exchange, axis: _Axis, kind: Kind, number: int) -> None:
        if self._slaved:
            axis.pending = (kind, number)
        else:
            self._order(exchange, axis, kind, number)

    def _halt(self, exchange: Exchange, axis: _Axis) -> None:
        axis.pending = None
        if self._moving(exchange, axis):
            self._order(exchange, axis, "stop", 0)

    def _home(self, exchange: Exchange, axis: _Axis) -> None:
        self._close(axis, exchange.request_s)
        self._lose(exchange.request_s - _MARGIN_S, exchange.reply_s + 0.1, "homing")
        self._recounts.append((exchange.reply_s, axis.index, 0))
        axis.steps, axis.pending = 0, None

    def _moving(self, exchange: Exchange, axis: _Axis) -> bool:
        """Return whether the axis may still move; a move that is surely over is closed."""
        if axis.orders and exchange.request_s > axis.busy_until_s:
            self._close(axis, exchange.request_s)
        return bool(axis.orders)

    def _order(self, exchange: Exchange, axis: _Axis, kind: Kind, steps: float) -> None:
        moving = self._moving(exchange, axis)
        if not moving:
            self._look(exchange, axis)
            target = steps + (axis.steps if kind == "by" else 0)
            if target == axis.steps:
                return
            kind, steps = "to", target
        for name, value in (("speed", axis.speed), ("acceleration", axis.acceleration)):
            if value is None or not value > 0.0:
                self._lose(exchange.request_s, np.inf, f"the {axis.letter} {name} was never set")
                return
        key = (axis.letter, axis.speed or 0.0)
        speed_class = self._classes.setdefault(key, len(self._classes))
        axis.orders.append(
            Order(
                exchange.request_s,
                exchange.request_s,
                kind,
                float(steps),
                axis.speed or 0.0,
                speed_class,
            )
        )
        axis.move()
        wait_s = min(max(exchange.reply_s - exchange.request_s, 0.0), _LONGEST_WAIT_S)
        axis.busy_until_s += _MARGIN_S + wait_s

    def _look(self, exchange: Exchange, axis: _Axis) -> None:
        """Believe the counts polled at rest where no command brought the axis there."""
        after_s = max(axis.busy_until_s, exchange.request_s - _LOOK_S)
        stood = self._resting(axis.index, after_s, exchange.request_s)
        if stood is not None and abs(stood - axis.steps) > 1:
            axis.steps = stood

    def _close(self, axis: _Axis, until_s: float) -> None:
        """Take the move under way as done; where a halt left it, the counts say."""
        if not axis.orders:
            return
        after_s = axis.busy_until_s
        last = axis.orders[-1]
        if last.kind == "stop" or any(order.kind == "by" for order in axis.orders):
            stood = self._resting(axis.index, after_s, until_s)
            if stood is not None:
                # Halted, an axis goes the way that it would have gone to where it stopped.
                if last.kind == "stop" and len(axis.orders) > 1:
                    last = axis.orders[-2]
                    axis.orders.pop()
                axis.orders[-1] = replace(last, kind="to", steps=float(stood))
            else:
                why = "where a halt or an offset on the way ended was not polled"
                self._lose(axis.orders[0].told_s, until_s, why)
        move = axis.move()
        if move.to_steps != move.from_steps or len(move.orders) > 1:
            self._moves.append(move)
        axis.steps, axis.orders = move.to_steps, []

    def _lose(self, begin_s: float, end_s: float, why: str) -> None:
        self._unknown.append((float(begin_s), float(end_s), why))
