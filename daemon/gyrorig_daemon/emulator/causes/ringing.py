"""Ringing: a structural resonance of the payload that every change of speed excites.

Part of the load is on a spring. Its deflection q relative to the driven angle x obeys

    q'' + 2 z w q' + w^2 q = -x'',      angle of the stage = x + share * q

with the angular frequency w of the mode, its damping ratio z, and the share of the load that
oscillates. The planned motion behind the gear consists of parabolas with jumps of the speed
between them, so that q has a closed form on each. If an S-curve averages the plan, q is averaged
with it. Its antiderivative follows from the equation itself, Q = -(x' + q' + 2 z w q) / w^2. With
an S-curve and a gap this is an approximation: the gap is crossed once the averaged motion did.
"""

import math
from itertools import pairwise

import numpy as np

from gyrorig_daemon.emulator.causes.cause import (
    CarriedCause,
    FloatArray,
    InjectedCause,
    ParameterSampling,
    Quantity,
    StatedCause,
    UnitCause,
)
from gyrorig_daemon.emulator.physics.effects.axis_effects import Motor, StateHistory
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks
from gyrorig_daemon.emulator.physics.motion_law import Segment

ModeState = tuple[float, float]  # q in steps, its derivative in steps/s

_AT_REST: ModeState = (0.0, 0.0)


class Ringing(UnitCause):
    """One mode of one axis."""

    name = "ringing"
    size_meaning = "share of the load that oscillates"
    unit = "1"
    typical = 0.05
    sampled_min, sampled_max = 0.02, 0.12
    max_size = 0.5
    is_signed = False

    def __init__(self, share: float, frequency_hz: float, damping: float) -> None:
        """Take the share of the load, the frequency and the damping ratio (below 1)."""
        self._share = share
        self._w = 2.0 * math.pi * frequency_hz
        self._decay = damping * self._w
        self._wd = self._w * math.sqrt(1.0 - damping**2)
        self._history: StateHistory[ModeState] = StateHistory(_AT_REST)

    @classmethod
    def sample_parameters(cls, sampling: ParameterSampling) -> dict[str, Quantity]:
        """See `Cause`."""
        return {
            "share": Quantity(sampling.size, "1"),
            "frequency": Quantity(float(sampling.rng.uniform(5.0, 15.0)), "Hz"),
            "damping": Quantity(float(sampling.rng.uniform(0.025, 0.1)), "1"),
        }

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`."""
        mode = {
            "frequency": Quantity(stated.number("frequency"), "Hz"),
            "damping": Quantity(stated.number("damping"), "1"),
        }
        return tuple(
            CarriedCause({"share": Quantity(share, "1"), **mode}, axis)
            for axis, share in stated.by_unit_axis("share")
        )

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        for axis in injected.axis_hooks(hooks):
            mode = (injected.number(name) for name in ("share", "frequency", "damping"))
            axis.angle_effects.append(cls(*mode))

    def added_rad(
        self, motor: Motor, start_s: float, offsets_s: FloatArray, angle_rad: FloatArray
    ) -> FloatArray:
        """See `axis_effects.AngleEffect`."""
        if motor.s_curve_s > 0.0:
            now = self._antiderivative(motor, start_s, offsets_s)
            window_start = self._antiderivative(motor, start_s - motor.s_curve_s, offsets_s)
            deflection = (now - window_start) / motor.s_curve_s
        else:
            deflection = self._motion(motor, start_s, offsets_s)[0]
        return np.asarray(self._share * motor.step_rad * deflection)

    def forget(self, time_s: float) -> None:
        """See `axis_effects.AngleEffect`."""
        self._history.forget(time_s)

    def _antiderivative(self, motor: Motor, start_s: float, offsets_s: FloatArray) -> FloatArray:
        q, rate, speed = self._motion(motor, start_s, offsets_s)
        return np.asarray(-(speed + rate + 2.0 * self._decay * q) / self._w**2)

    def _motion(
        self, motor: Motor, start_s: float, offsets_s: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return q, its derivative and the planned speed, each (n,)."""
        q, rate, planned_speed = (np.empty_like(offsets_s) for _ in range(3))
        segments = motor.wheel_planned(start_s, start_s + float(offsets_s[-1]))
        state = self._state_at_start_of(motor, segments[0][0])
        starts = [segment.start_s - start_s for segment, _ in segments[1:]]
        edges = [0, *np.searchsorted(offsets_s, starts).tolist(), len(offsets_s)]
        for k, (segment, _) in enumerate(segments):
            interval = slice(edges[k], edges[k + 1])
            elapsed = offsets_s[interval] + (start_s - segment.start_s)
            acceleration = segment.acceleration_steps_s2
            q[interval], rate[interval] = self._free(state, acceleration, elapsed)
            planned_speed[interval] = segment.speed_steps_s + acceleration * elapsed
            if k + 1 < len(segments):
                state = self._next(state, segment, *segments[k + 1])
        return q, rate, planned_speed

    def _state_at_start_of(self, motor: Motor, target: Segment) -> ModeState:
        """Return the state just after a segment has begun."""
        known_s, state = self._history.last_before(target.start_s)
        if known_s == target.start_s:
            return state
        segments = motor.wheel_planned(known_s, target.start_s)
        for (segment, _), (following, speed_before) in pairwise(segments):
            state = self._next(state, segment, following, speed_before)
            self._history.keep(following.start_s, state)
        return state

    def _next(
        self, state: ModeState, segment: Segment, following: Segment, speed_before: float
    ) -> ModeState:
        """Propagate through a segment and over the jump of the speed into the next one."""
        elapsed = np.array([following.start_s - segment.start_s])
        q, rate = self._free(state, segment.acceleration_steps_s2, elapsed)
        return float(q[0]), float(rate[0]) - (following.speed_steps_s - speed_before)

    def _free(
        self, state: ModeState, acceleration: float, elapsed_s: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return q and its derivative under a constant acceleration, some time after a state."""
        equilibrium = -acceleration / self._w**2
        a = state[0] - equilibrium
        b = (state[1] + self._decay * a) / self._wd
        fade = np.exp(-self._decay * elapsed_s)
        c, s = np.cos(self._wd * elapsed_s), np.sin(self._wd * elapsed_s)
        q = equilibrium + fade * (a * c + b * s)
        rate = fade * ((b * self._wd - self._decay * a) * c - (a * self._wd + self._decay * b) * s)
        return q, rate
