"""Effects of the axes that are in no catalogue: creep, stick-slip, a worn bearing, soft play."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.physics.effects.axis_effects import Motor, StateHistory, StepEffect
from gyrorig_daemon.emulator.physics.motion_law import Segment

FloatArray = NDArray[np.float64]


def speeds_steps_s(motor: Motor, start_s: float, offsets_s: FloatArray) -> FloatArray:
    """Return the planned speed at times that count from a start, (n,)."""
    pieces = [piece for piece, _ in motor.planned(start_s, start_s + float(offsets_s[-1]))]
    begins = np.array([piece.start_s for piece in pieces])
    times = start_s + offsets_s
    at = np.maximum(np.searchsorted(begins, times, side="right") - 1, 0)
    speed = np.array([piece.speed_steps_s for piece in pieces])[at]
    rise = np.array([piece.acceleration_steps_s2 for piece in pieces])[at]
    return np.asarray(speed + rise * (times - begins[at]))


class Creep:
    """A part of every way is gone late: the stage lags by c u, u' + u / T = x'.

    On a parabola u = T v - T^2 a + (what fades with T).
    """

    def __init__(self, share: float, time_constant_s: float) -> None:
        """Take the share of the way that is late, and how late."""
        self._share, self._late_s = share, time_constant_s
        self._memory: StateHistory[float] = StateHistory(0.0)

    def added_rad(
        self, motor: Motor, start_s: float, offsets_s: FloatArray, _angle_rad: FloatArray
    ) -> FloatArray:
        """See `motor.AngleEffect`."""
        pieces = [piece for piece, _ in motor.planned(start_s, start_s + float(offsets_s[-1]))]
        state = self._state_at(motor, pieces[0])
        cuts = [0, *np.searchsorted(offsets_s, [p.start_s - start_s for p in pieces[1:]]).tolist()]
        cuts.append(len(offsets_s))
        late = np.empty_like(offsets_s)
        for k, piece in enumerate(pieces):
            part = slice(cuts[k], cuts[k + 1])
            late[part] = self._after(piece, state, offsets_s[part] + (start_s - piece.start_s))
            if k + 1 < len(pieces):
                state = self._end(piece, state, pieces[k + 1].start_s)
        return np.asarray(-self._share * motor.step_rad * late)

    def forget(self, time_s: float) -> None:
        """See `motor.AngleEffect`."""
        self._memory.forget(time_s)

    def _state_at(self, motor: Motor, wanted: Segment) -> float:
        known_s, state = self._memory.last_before(wanted.start_s)
        if known_s == wanted.start_s:
            return state
        pieces = [piece for piece, _ in motor.planned(known_s, wanted.start_s)]
        for piece, following in pairwise(pieces):
            state = self._end(piece, state, following.start_s)
            self._memory.keep(following.start_s, state)
        return state

    def _end(self, piece: Segment, state: float, at_s: float) -> float:
        return float(self._after(piece, state, np.array([at_s - piece.start_s]))[0])

    def _after(self, piece: Segment, state: float, elapsed_s: FloatArray) -> FloatArray:
        late_s, rise = self._late_s, piece.acceleration_steps_s2
        settled = late_s * (piece.speed_steps_s + rise * elapsed_s) - late_s**2 * rise
        first = late_s * piece.speed_steps_s - late_s**2 * rise
        return np.asarray(settled + (state - first) * np.exp(-elapsed_s / late_s))


@dataclass(frozen=True, slots=True)
class StickSlip:
    """Below a speed the axis sticks and jumps: a saw over the angle."""

    amplitude_rad: float
    pitch_rad: float
    below_rad_s: float

    def added_rad(
        self, motor: Motor, start_s: float, offsets_s: FloatArray, angle_rad: FloatArray
    ) -> FloatArray:
        """See `motor.AngleEffect`."""
        speed = np.abs(speeds_steps_s(motor, start_s, offsets_s) * motor.step_rad)
        saw = angle_rad / self.pitch_rad - np.floor(angle_rad / self.pitch_rad)
        # One that stands still stays where it stuck.
        return np.where(speed < self.below_rad_s, -self.amplitude_rad * saw, 0.0)

    def forget(self, time_s: float) -> None:
        """See `motor.AngleEffect`: nothing is remembered."""


@dataclass(frozen=True, slots=True)
class WornBearing:
    """A harmonic of the angle whose amplitude comes and goes in time."""

    amplitude_rad: float
    order: float
    phase_rad: float
    modulation: float
    period_s: float

    def added_rad(
        self, _motor: Motor, start_s: float, offsets_s: FloatArray, angle_rad: FloatArray
    ) -> FloatArray:
        """See `motor.AngleEffect`."""
        swing = np.sin(2.0 * np.pi * (start_s + offsets_s) / self.period_s)
        amplitude = self.amplitude_rad * (1.0 + self.modulation * swing)
        return np.asarray(amplitude * np.sin(self.order * angle_rad + self.phase_rad))

    def forget(self, time_s: float) -> None:
        """See `motor.AngleEffect`: nothing is remembered."""


class SoftPlay:
    """A gap that closes by and by: the mean of several plays (Prandtl and Ishlinskii)."""

    def __init__(self, plays: tuple[StepEffect, ...]) -> None:
        """Take plays of different widths."""
        self._plays = plays

    def passed_steps(
        self, motor: Motor, start_s: float, offsets_s: FloatArray, steps: FloatArray
    ) -> FloatArray:
        """See `motor.StepEffect`."""
        passed = [play.passed_steps(motor, start_s, offsets_s, steps) for play in self._plays]
        return np.asarray(np.mean(passed, axis=0))

    def standing_s(self, motor: Motor, after_s: float, until_s: float) -> list[tuple[float, float]]:
        """See `motor.StepEffect`: the first play to close moves the wheel a little."""
        return min((p.standing_s(motor, after_s, until_s) for p in self._plays), key=_total_s)

    def forget(self, time_s: float) -> None:
        """See `motor.StepEffect`."""
        for play in self._plays:
            play.forget(time_s)


def _total_s(intervals_s: list[tuple[float, float]]) -> float:
    return sum(end_s - start_s for start_s, end_s in intervals_s)
