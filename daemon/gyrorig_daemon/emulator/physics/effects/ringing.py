"""Ringing: a mode of the payload that every change of speed sets off.

A part of the load hangs on a spring. Its deflection q against the driven angle x obeys

    q'' + 2 z w q' + w^2 q = -x'',      angle of the stage = x + share * q

with w the mode's angular frequency, z its damping, and the share of the load that swings.
The planned motion is made of parabolas with jumps of speed between them, so q has a closed
form on each. Where an S-curve smooths the plan, q is smoothed with it: its antiderivative
follows from the equation itself, Q = -(x' + q' + 2 z w q) / w^2. Source: pan-tilt survey,
section 7 (10 to 60 Hz structure, quality 5 to 20); rig discovery survey (5 to 15 Hz).
"""

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.physics.effects.motor import Memory, Motor
from gyrorig_daemon.emulator.physics.motion_law import Segment

FloatArray = NDArray[np.float64]
Swing = tuple[float, float]  # q in steps, its derivative in steps/s

_STILL: Swing = (0.0, 0.0)


class Ringing:
    """One mode of one axis."""

    def __init__(self, share: float, frequency_hz: float, damping: float) -> None:
        """Take the share of the load that swings, its frequency and damping ratio (< 1)."""
        self._share = share
        self._w = 2.0 * math.pi * frequency_hz
        self._decay = damping * self._w
        self._wd = self._w * math.sqrt(1.0 - damping**2)
        self._memory: Memory[Swing] = Memory(_STILL)

    def added_rad(
        self, motor: Motor, start_s: float, offsets_s: FloatArray, _angle_rad: FloatArray
    ) -> FloatArray:
        """See `motor.AngleEffect`."""
        if motor.s_curve_s > 0.0:
            now = self._antiderivative(motor, start_s, offsets_s)
            before = self._antiderivative(motor, start_s - motor.s_curve_s, offsets_s)
            deflection = (now - before) / motor.s_curve_s
        else:
            deflection = self._swings(motor, start_s, offsets_s)[0]
        return np.asarray(self._share * motor.step_rad * deflection)

    def forget(self, time_s: float) -> None:
        """See `motor.AngleEffect`."""
        self._memory.forget(time_s)

    def _antiderivative(self, motor: Motor, start_s: float, offsets_s: FloatArray) -> FloatArray:
        q, rate, speed = self._swings(motor, start_s, offsets_s)
        return np.asarray(-(speed + rate + 2.0 * self._decay * q) / self._w**2)

    def _swings(
        self, motor: Motor, start_s: float, offsets_s: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return q, its derivative and the planned speed, each (n,)."""
        q, rate, planned_speed = (np.empty_like(offsets_s) for _ in range(3))
        pieces = motor.planned(start_s, start_s + float(offsets_s[-1]))
        state = self._state_at_start_of(motor, pieces[0][0])
        begins = [segment.start_s - start_s for segment, _ in pieces[1:]]
        cuts = [0, *np.searchsorted(offsets_s, begins).tolist(), len(offsets_s)]
        for k, (segment, _) in enumerate(pieces):
            piece = slice(cuts[k], cuts[k + 1])
            elapsed = offsets_s[piece] + (start_s - segment.start_s)
            q[piece], rate[piece] = self._free(state, segment.acceleration_steps_s2, elapsed)
            planned_speed[piece] = segment.speed_steps_s + segment.acceleration_steps_s2 * elapsed
            if k + 1 < len(pieces):
                state = self._next(state, segment, *pieces[k + 1])
        return q, rate, planned_speed

    def _state_at_start_of(self, motor: Motor, wanted: Segment) -> Swing:
        """Return the state just after a segment has begun."""
        known_s, state = self._memory.before(wanted.start_s)
        if known_s == wanted.start_s:
            return state
        pieces = motor.planned(known_s, wanted.start_s)
        for (segment, _), (following, before) in pairwise(pieces):
            state = self._next(state, segment, following, before)
            self._memory.keep(following.start_s, state)
        return state

    def _next(self, state: Swing, segment: Segment, following: Segment, before: float) -> Swing:
        """Go through a segment, and over the jump of speed into the next one."""
        elapsed = np.array([following.start_s - segment.start_s])
        q, rate = self._free(state, segment.acceleration_steps_s2, elapsed)
        return float(q[0]), float(rate[0]) - (following.speed_steps_s - before)

    def _free(
        self, state: Swing, acceleration: float, elapsed_s: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return q and its derivative under a constant acceleration, some time after a state."""
        rest = -acceleration / self._w**2
        a = state[0] - rest
        b = (state[1] + self._decay * a) / self._wd
        fade = np.exp(-self._decay * elapsed_s)
        c, s = np.cos(self._wd * elapsed_s), np.sin(self._wd * elapsed_s)
        q = rest + fade * (a * c + b * s)
        rate = fade * ((b * self._wd - self._decay * a) * c - (a * self._wd + self._decay * b) * s)
        return q, rate
