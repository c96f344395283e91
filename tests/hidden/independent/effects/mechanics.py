"""Effects of the mechanics of pan: friction, a cable, a belt, the rotor, and a moving zero."""

from dataclasses import dataclass
from math import copysign

import numpy as np
from scipy.signal import bilinear, lfilter
from tests.bench.accuracy.profile import RAD_PER_STEP, FloatArray
from tests.bench.rigs.stage_motion import StepTracks, play
from tests.hidden.independent.effects.effect import Effect, OutsideEffect, Site

LEAST_STEP_RAD = 1e-9  # a smaller change in a cell is rest
CYCLE_STEPS = 8.0  # half steps of one electrical turn: four full steps
FULL_TURN_RAD = 2.0 * np.pi
CELLS_PER_STEP = 2  # in the integration of friction
SWING_S = 0.5  # duration of the swing of the stage after a move
_EDGES = ("pan_transient", "move_gain", "move_delay")


@dataclass(frozen=True, slots=True, eq=False)
class FrictionWindUp(Effect):
    """Dry friction winds up the drive: the stage sticks, slips, and stops at another angle.

    A mass on a spring of the drive, with dry and viscous friction: J x'' = k (m - x) - friction.
    The effect is the difference between the angles with and without dry friction.
    """

    wind_up_rad: float  # friction torque over stiffness
    mode_hz: float
    damping: float

    def added_angles_rad(self, tracks: StepTracks) -> tuple[FloatArray, FloatArray]:
        """Return the angle of the stage with dry friction minus the angle without it."""
        motor = tracks.turned[0] * RAD_PER_STEP
        coarse, cell_s = (
            motor[::CELLS_PER_STEP],
            CELLS_PER_STEP * float(tracks.edges_s[1] - tracks.edges_s[0]),
        )
        motor_rad = coarse.tolist()
        angle_rad = self._integrate(motor_rad, cell_s, self.wind_up_rad)
        angle_rad = angle_rad - self._integrate(motor_rad, cell_s, 0.0)
        at = np.arange(motor.size) / CELLS_PER_STEP
        return np.interp(at, np.arange(coarse.size), angle_rad), np.zeros(motor.size)

    def _integrate(self, motor_rad: list[float], step_s: float, wind_up_rad: float) -> FloatArray:
        """Return the angle of the stage from a semi-implicit integration."""
        w = FULL_TURN_RAD * self.mode_hz
        stiffness, friction = w * w * step_s, w * w * wind_up_rad * step_s
        damping_factor = 1.0 / (1.0 + 2.0 * self.damping * w * step_s)
        position, speed, moved_at = motor_rad[0], 0.0, -1
        swing_steps = int(SWING_S / step_s)
        out = [position]
        for k in range(1, len(motor_rad)):
            if motor_rad[k] != motor_rad[k - 1]:
                moved_at = k
            if speed == 0.0 and k - moved_at > swing_steps:
                out.append(position)
                continue
            free = (speed + stiffness * (motor_rad[k] - position)) * damping_factor
            # Dry friction stops the stage and does not reverse it.
            speed = copysign(max(abs(free) - friction, 0.0), free)
            position += speed * step_s
            out.append(position)
        return np.array(out)


@dataclass(frozen=True, slots=True, eq=False)
class CableSpring(Effect):
    """A cable applies a torque with the third power of the pan angle, and with hysteresis."""

    most_rad: float  # at 90 deg
    lag_rad: float  # of the cable behind pan, at a reversal

    def added_angles_rad(self, tracks: StepTracks) -> tuple[FloatArray, FloatArray]:
        """Return the angle that the torque causes on the compliance of the drive."""
        pan = tracks.turned[0] * RAD_PER_STEP
        share = play(pan, self.lag_rad) / (0.5 * np.pi)
        return -self.most_rad * share**3, np.zeros(pan.size)


@dataclass(frozen=True, slots=True, eq=False)
class BeltCreep(Effect):
    """A belt under the load of friction stretches with memory, and creeps back after a stop."""

    stretch_rad: float
    slow_share: float
    slow_s: float

    def added_angles_rad(self, tracks: StepTracks) -> tuple[FloatArray, FloatArray]:
        """Return the stretch: its load is the direction of the motion."""
        load = find_direction(tracks)
        cell_s = float(tracks.edges_s[1] - tracks.edges_s[0])
        slow, fast = (_apply_lag(load, time_s, cell_s) for time_s in (self.slow_s, 0.02))
        stretch = (1.0 - self.slow_share) * fast + self.slow_share * slow
        return -self.stretch_rad * stretch, np.zeros(load.size)


@dataclass(frozen=True, slots=True, eq=False)
class StepResonance(Effect):
    """The rotor resonates if the electrical frequency of the steps is that of its mode."""

    ripple_rad: float
    mode_hz: float
    damping: float

    def added_angles_rad(self, tracks: StepTracks) -> tuple[FloatArray, FloatArray]:
        """Return the swing: the torque ripple drives a mode of second order."""
        steps = tracks.turned[0]
        drive = np.sin(FULL_TURN_RAD * steps / CYCLE_STEPS)
        cell_s = float(tracks.edges_s[1] - tracks.edges_s[0])
        w = FULL_TURN_RAD * self.mode_hz
        b, a = bilinear([w * w], [1.0, 2.0 * self.damping * w, w * w], 1.0 / cell_s)
        swing = np.asarray(lfilter(b, a, drive - drive[0]))
        return self.ripple_rad * swing, np.zeros(steps.size)


@dataclass(frozen=True, slots=True, eq=False)
class PanDrift(Effect):
    """The zero of pan drifts: the base turns as it warms up, and its speed decreases."""

    turn_rad: float
    settle_s: float

    def added_angles_rad(self, tracks: StepTracks) -> tuple[FloatArray, FloatArray]:
        """Return the turn of the base."""
        since = np.maximum(tracks.edges_s, 0.0)
        turn = self.turn_rad * -np.expm1(-since / self.settle_s)
        return turn, np.zeros(since.size)


def find_direction(tracks: StepTracks) -> FloatArray:
    """Return the direction of pan at each edge: 1, 0 or -1."""
    change = np.diff(tracks.turned[0], append=tracks.turned[0][-1]) * RAD_PER_STEP
    return np.where(np.abs(change) > LEAST_STEP_RAD, np.sign(change), 0.0)


def _apply_lag(values: FloatArray, time_s: float, cell_s: float) -> FloatArray:
    share = float(-np.expm1(-cell_s / time_s))
    return np.asarray(lfilter([share], [1.0, share - 1.0], values))


def _make_wind_up(site: Site) -> Effect:
    rng = site.rng
    return FrictionWindUp(site.size, float(rng.uniform(40.0, 80.0)), float(rng.uniform(0.5, 0.9)))


def _make_cable(site: Site) -> Effect:
    return CableSpring(site.size, float(np.radians(site.rng.uniform(8.0, 20.0))))


def _make_belt(site: Site) -> Effect:
    rng = site.rng
    return BeltCreep(site.size, float(rng.uniform(0.4, 0.8)), float(rng.uniform(0.3, 1.2)))


def _make_resonance(site: Site) -> Effect:
    rng = site.rng
    return StepResonance(site.size, float(rng.uniform(10.0, 30.0)), float(rng.uniform(0.04, 0.1)))


def _make_drift(site: Site) -> Effect:
    sign = float(site.rng.choice((-1.0, 1.0)))
    return PanDrift(sign * site.size, float(site.rng.uniform(3.0, 10.0)))


MECHANICS = (
    OutsideEffect(
        "friction_wind_up", "dry friction winds up the drive of pan", "rad", 2e-4, 5e-3,
        (*_EDGES, "pan_angle", "speed"), _make_wind_up, near="backlash",
    ),
    OutsideEffect(
        "cable_spring", "a cable pulls pan by a spring with hysteresis", "rad", 1e-3, 0.05,
        ("pan_angle", "move_gain", "pan_transient"), _make_cable,
    ),
    OutsideEffect(
        "belt_creep", "a belt stretches with memory and creeps back", "rad", 2e-4, 1e-2,
        (*_EDGES, "bias_time"), _make_belt,
    ),
    OutsideEffect(
        "step_resonance", "the rotor of pan resonates in a band of speed", "rad", 1e-4, 1e-2,
        (*_EDGES, "pan_angle", "speed"), _make_resonance,
    ),
    OutsideEffect(
        "pan_drift", "the zero of pan moves with time", "rad", 1e-3, 0.03,
        ("bias_time", "bias_tilt", "bias_pan", "time"), _make_drift, near="warm_up",
    ),
)  # fmt: skip
