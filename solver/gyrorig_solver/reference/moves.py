"""From what the controller was told to the moves that it made.

Commands and settings are evidence: a move has its distance, speed, acceleration and
base speed from them; only when it started is not said (see `polls`).
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.reference.trapezoid import Trapezoid

AXES = ("pan", "tilt")
_SETTING = re.compile(r"([PT])([SABPO])([-+]?\d+)\s*")
_START = re.compile(r"[AI]\s*")
_SLAVED = re.compile(r"S\s*")
_HALT = re.compile(r"H[PT]?\s*")


@dataclass(frozen=True, slots=True)
class Exchange:
    """One command and its answer, times in s on the capture clock."""

    request_s: float
    reply_s: float
    ok: bool
    command: str


@dataclass(frozen=True, slots=True)
class Move:
    """One move of one axis between two rests."""

    axis: int  # 0 pan, 1 tilt
    told_s: float  # when the command that started it was written
    start_s: float  # when it started, as well as is known
    from_steps: int
    to_steps: int
    profile: Trapezoid
    speed_class: int  # moves told the same speed on the same axis share one

    @property
    def sign(self) -> float:
        """+1 when the count goes up."""
        return 1.0 if self.to_steps > self.from_steps else -1.0

    @property
    def end_s(self) -> float:
        """When the last step is made."""
        return self.start_s + self.profile.duration_s


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """All moves, and the spans in which the motion is not known from the commands."""

    moves: tuple[Move, ...]
    rest_steps: tuple[int, int]  # where pan and tilt stood before the first move
    unknown: tuple[tuple[float, float, str], ...]  # begin, end, why
    classes: int


class _Axis:
    """What one axis has been told so far."""

    def __init__(self, letter: str, settings: Mapping[str, float], steps: int) -> None:
        name = AXES["PT".index(letter)]
        self.speed: float | None = settings.get(f"{name}_speed")
        self.base = settings.get(f"{name}_base_speed", 0.0)
        self.acceleration: float | None = settings.get(f"{name}_acceleration")
        self.steps = steps
        self.busy_until_s = -np.inf
        self.pending: int | None = None


class MotionReader:
    """Turn exchanges into moves, in the order in which they were made."""

    def __init__(self, settings: Mapping[str, float], rest_steps: tuple[int, int]) -> None:
        """Begin with the settings of the recording's metadata and the counts at rest."""
        self._rest = rest_steps
        self._axes = {p: _Axis(p, settings, s) for p, s in zip("PT", rest_steps, strict=True)}
        self._slaved = False
        self._moves: list[Move] = []
        self._unknown: list[tuple[float, float, str]] = []
        self._classes: dict[tuple[str, float], int] = {}

    def read(self, exchanges: Iterable[Exchange]) -> Motion:
        """Return the motion that `exchanges` tell of."""
        for exchange in exchanges:
            if exchange.ok:
                self._take(exchange)
        return Motion(
            tuple(self._moves), self._rest, tuple(self._unknown), max(1, len(self._classes))
        )

    def _take(self, exchange: Exchange) -> None:
        text = exchange.command.strip().upper()
        if match := _SETTING.fullmatch(text):
            self._setting(exchange, match[1], match[2], int(match[3]))
        elif _SLAVED.fullmatch(text):
            self._slaved = True
        elif _START.fullmatch(text):
            self._slaved = self._slaved and text[0] == "A"
            for letter, axis in self._axes.items():
                if axis.pending is not None:
                    self._begin(exchange, letter, axis.pending)
                    axis.pending = None
        elif _HALT.fullmatch(text):
            for letter, axis in self._axes.items():
                if exchange.request_s < axis.busy_until_s and text in ("H", f"H{letter}"):
                    self._lose(exchange.request_s, axis.busy_until_s, "halted on the way")

    def _setting(self, exchange: Exchange, letter: str, kind: str, number: int) -> None:
        axis = self._axes[letter]
        if kind == "S":
            axis.speed = float(abs(number))
        elif kind == "B":
            axis.base = float(number)
        elif kind == "A":
            axis.acceleration = float(number)
        else:
            target = number + (axis.steps if kind == "O" else 0)
            if self._slaved:
                axis.pending = target
            else:
                self._begin(exchange, letter, target)

    def _begin(self, exchange: Exchange, letter: str, target: int) -> None:
        axis = self._axes[letter]
        distance = abs(target - axis.steps)
        if distance == 0:
            return
        if axis.speed is None or axis.acceleration is None or not axis.speed > 0.0:
            self._lose(exchange.request_s, np.inf, f"the {letter} speed was never set")
            return
        profile = Trapezoid(float(distance), axis.speed, axis.acceleration, axis.base)
        if exchange.request_s < axis.busy_until_s:
            self._lose(exchange.request_s - 0.1, axis.busy_until_s + profile.duration_s, "retarget")
        key = (letter, axis.speed)
        move = Move(
            axis="PT".index(letter),
            told_s=exchange.request_s,
            start_s=exchange.request_s,
            from_steps=axis.steps,
            to_steps=target,
            profile=profile,
            speed_class=self._classes.setdefault(key, len(self._classes)),
        )
        self._moves.append(move)
        axis.busy_until_s = move.end_s + 0.02
        axis.steps = target

    def _lose(self, begin_s: float, end_s: float, why: str) -> None:
        self._unknown.append((float(begin_s), float(end_s), why))


def started(moves: Iterable[Move], start_s: FloatArray) -> tuple[Move, ...]:
    """Return the moves with their start times replaced."""
    return tuple(replace(m, start_s=float(s)) for m, s in zip(moves, start_s, strict=True))
