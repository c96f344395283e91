"""Effects of the axes outside the catalogue: creep, stick-slip, a worn bearing, soft play."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.physics.effects.axis_effects import Motor, StateHistory, StepEffect
from gyrorig_daemon.emulator.physics.motion_law import Segment

FloatArray = NDArray[np.float64]


def compute_speeds_steps_s(motor: Motor, start_s: float, offsets_s: FloatArray) -> FloatArray:
    """Return the planned speed at times relative to a start, (n,)."""
    pieces = [piece for piece, _ in motor.planned(start_s, start_s + float(offsets_s[-1]))]
    begins = np.array([piece.start_s for piece in pieces])
    times = start_s + offsets_s
    at = np.maximum(np.searchsorted(begins, times, side="right") - 1, 0)
    speed = np.array([piece.speed_steps_s for piece in pieces])[at]
    rise = np.array([piece.acceleration_steps_s2 for piece in pieces])[at]
    return np.asarray(speed + rise * (times - begins[at]))


class Creep:
    """The stage moves a part of each distance late: it lags by c u, with u' + u / T = x'.

    For a constant acceleration, u = T v - T^2 a plus a term that decays with T.
    """

    def __init__(self, share: float, time_constant_s: float) -> None:
        """Store the share of the distance that is late, and its time constant."""
        self._share, self._lag_s = share, time_constant_s
        self._memory: StateHistory[float] = StateHistory(0.0)

    def added_rad(
        self, motor: Motor, start_s: float, offsets_s: FloatArray, _angle_rad: FloatArray
    ) -> FloatArray:
        """See `axis_effects.AngleEffect`."""
        pieces = [piece for piece, _ in motor.planned(start_s, start_s + float(offsets_s[-1]))]
        state = self._find_state(motor, pieces[0])
        cuts = [0, *np.searchsorted(offsets_s, [p.start_s - start_s for p in pieces[1:]]).tolist()]
        cuts.append(len(offsets_s))
        late_steps = np.empty_like(offsets_s)
        for k, piece in enumerate(pieces):
            part = slice(cuts[k], cuts[k + 1])
            late_steps[part] = self._compute_late_steps(
                piece, state, offsets_s[part] + (start_s - piece.start_s)
            )
            if k + 1 < len(pieces):
                state = self._compute_end_state(piece, state, pieces[k + 1].start_s)
        return np.asarray(-self._share * motor.step_rad * late_steps)

    def forget(self, time_s: float) -> None:
        """See `axis_effects.AngleEffect`."""
        self._memory.forget(time_s)

    def _find_state(self, motor: Motor, wanted: Segment) -> float:
        known_s, state = self._memory.last_before(wanted.start_s)
        if known_s == wanted.start_s:
            return state
        pieces = [piece for piece, _ in motor.planned(known_s, wanted.start_s)]
        for piece, following in pairwise(pieces):
            state = self._compute_end_state(piece, state, following.start_s)
            self._memory.keep(following.start_s, state)
        return state

    def _compute_end_state(self, piece: Segment, state: float, at_s: float) -> float:
        return float(self._compute_late_steps(piece, state, np.array([at_s - piece.start_s]))[0])

    def _compute_late_steps(
        self, piece: Segment, state: float, elapsed_s: FloatArray
    ) -> FloatArray:
        lag_s, rise = self._lag_s, piece.acceleration_steps_s2
        settled = lag_s * (piece.speed_steps_s + rise * elapsed_s) - lag_s**2 * rise
        first = lag_s * piece.speed_steps_s - lag_s**2 * rise
        return np.asarray(settled + (state - first) * np.exp(-elapsed_s / lag_s))


@dataclass(frozen=True, slots=True)
class StickSlip:
    """The axis sticks and jumps below a speed: a sawtooth over the angle."""

    amplitude_rad: float
    pitch_rad: float
    below_rad_s: float

    def added_rad(
        self, motor: Motor, start_s: float, offsets_s: FloatArray, angle_rad: FloatArray
    ) -> FloatArray:
        """See `axis_effects.AngleEffect`."""
        speed = np.abs(compute_speeds_steps_s(motor, start_s, offsets_s) * motor.step_rad)
        saw = angle_rad / self.pitch_rad - np.floor(angle_rad / self.pitch_rad)
        # An axis at rest stays at its angle.
        return np.where(speed < self.below_rad_s, -self.amplitude_rad * saw, 0.0)

    def forget(self, time_s: float) -> None:
        """See `axis_effects.AngleEffect`: the effect has no memory."""


@dataclass(frozen=True, slots=True)
class WornBearing:
    """A harmonic of the angle with an amplitude that oscillates in time."""

    amplitude_rad: float
    order: float
    phase_rad: float
    modulation: float
    period_s: float

    def added_rad(
        self, _motor: Motor, start_s: float, offsets_s: FloatArray, angle_rad: FloatArray
    ) -> FloatArray:
        """See `axis_effects.AngleEffect`."""
        swing = np.sin(2.0 * np.pi * (start_s + offsets_s) / self.period_s)
        amplitude = self.amplitude_rad * (1.0 + self.modulation * swing)
        return np.asarray(amplitude * np.sin(self.order * angle_rad + self.phase_rad))

    def forget(self, time_s: float) -> None:
        """See `axis_effects.AngleEffect`: the effect has no memory."""


class SoftPlay:
    """A gap that closes gradually: the mean of several plays (Prandtl and Ishlinskii)."""

    def __init__(self, plays: tuple[StepEffect, ...]) -> None:
        """Store plays of different widths."""
        self._plays = plays

    def passed_steps(
        self, motor: Motor, start_s: float, offsets_s: FloatArray, steps: FloatArray
    ) -> FloatArray:
        """See `axis_effects.StepEffect`."""
        passed = [play.passed_steps(motor, start_s, offsets_s, steps) for play in self._plays]
        return np.asarray(np.mean(passed, axis=0))

    def standing_s(self, motor: Motor, after_s: float, until_s: float) -> list[tuple[float, float]]:
        """See `axis_effects.StepEffect`: the first play that closes moves the wheel a little."""
        return min((p.standing_s(motor, after_s, until_s) for p in self._plays), key=_sum_s)

    def forget(self, time_s: float) -> None:
        """See `axis_effects.StepEffect`."""
        for play in self._plays:
            play.forget(time_s)


def _sum_s(intervals_s: list[tuple[float, float]]) -> float:
    return sum(end_s - start_s for start_s, end_s in intervals_s)
