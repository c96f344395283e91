"""Effects of the motors on the sensor: heat, a bias in one direction, noise and a tone."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter
from tests.bench.accuracy.profile import FloatArray
from tests.bench.rigs.gyroscope import LEAST_SPEED_RAD_S
from tests.bench.rigs.stage_motion import StageMotion
from tests.hidden.independent.effects.effect import Effect, OutsideEffect, Site

Span = tuple[float, float]
FAST_RAD_S = 0.5  # a usual speed of the stage


def find_running(motion: StageMotion) -> FloatArray:
    """Return 1 while a motor runs, else 0, (n,)."""
    moves = np.any(np.abs(motion.motor_speed_rad_s) > LEAST_SPEED_RAD_S, axis=1)
    return np.asarray(moves, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class MotorHeat(Effect):
    """The motors heat the sensor while they run; the thermometer does not measure this heat."""

    bias_rad_s: FloatArray  # (3,), at full heat
    heat_s: float

    def added_rates_rad_s(self, motion: StageMotion, span_s: Span) -> FloatArray:
        """Return the bias: the duty of the motors behind a lag of first order."""
        share = float(-np.expm1(-motion.cell_s / self.heat_s))
        heat = np.asarray(lfilter([share], [1.0, share - 1.0], find_running(motion)))
        return np.outer(heat, self.bias_rad_s)


@dataclass(frozen=True, slots=True, eq=False)
class OneWaySpeed(Effect):
    """A bias grows with the square of pan's speed, but only in one direction."""

    bias_rad_s: FloatArray  # (3,), at a usual speed
    direction: float

    def added_rates_rad_s(self, motion: StageMotion, span_s: Span) -> FloatArray:
        """Return the bias."""
        share = np.maximum(self.direction * motion.motor_speed_rad_s[:, 0], 0.0) / FAST_RAD_S
        return np.outer(share**2, self.bias_rad_s)


@dataclass(frozen=True, slots=True, eq=False)
class DriverTone(Effect):
    """The chopper of the motor driver aliases to a slow tone, which is strong in motion."""

    amplitude_rad_s: FloatArray  # (3,)
    tone_hz: float
    drift_hz_s: float  # the sample rate drifts, and so does the alias
    phase_rad: float
    at_rest: float  # share of the amplitude

    def added_rates_rad_s(self, motion: StageMotion, span_s: Span) -> FloatArray:
        """Return the tone."""
        time_s = motion.middle_s - span_s[0]
        turns = self.tone_hz * time_s + 0.5 * self.drift_hz_s * time_s**2
        tone = np.sin(2.0 * np.pi * turns + self.phase_rad)
        amplitude = self.at_rest + (1.0 - self.at_rest) * find_running(motion)
        return np.outer(tone * amplitude, self.amplitude_rad_s)


@dataclass(frozen=True, slots=True, eq=False)
class RateNoise(Effect):
    """The white noise of the sensor grows with its rate."""

    ratio: float  # of the added noise at a usual speed

    def noise_amplitude(self, motion: StageMotion, span_s: Span) -> FloatArray:
        """Return the square root of the sum of both powers."""
        share = np.linalg.norm(motion.rate_rad_s, axis=1) / FAST_RAD_S
        return np.asarray(np.sqrt(1.0 + (self.ratio * share) ** 2))


def _make_heat(site: Site) -> Effect:
    return MotorHeat(site.size * site.draw_direction(), float(site.rng.uniform(3.0, 8.0)))


def _make_one_way(site: Site) -> Effect:
    return OneWaySpeed(site.size * site.draw_direction(), float(site.rng.choice((-1.0, 1.0))))


def _make_tone(site: Site) -> Effect:
    rng = site.rng
    return DriverTone(
        amplitude_rad_s=site.size * site.draw_direction(),
        tone_hz=float(rng.uniform(0.3, 4.0)),
        drift_hz_s=float(rng.uniform(-0.01, 0.01)),
        phase_rad=float(rng.uniform(-np.pi, np.pi)),
        at_rest=float(rng.uniform(0.1, 0.4)),
    )


def _make_rate_noise(site: Site) -> Effect:
    return RateNoise(site.size)


MOTOR = (
    OutsideEffect(
        "motor_heat", "the motors heat the sensor while they run", "rad/s", 1e-3, 0.05,
        ("bias_time", "pan_transient", "tilt_transient", "move_gain"), _make_heat,
    ),
    OutsideEffect(
        "one_way_speed", "a bias with pan's speed squared in one direction", "rad/s", 1e-3, 0.05,
        ("own_rate", "speed", "pan_transient", "bias_pan", "move_gain"), _make_one_way,
    ),
    OutsideEffect(
        "driver_tone", "the motor driver's chopper aliases to a slow tone", "rad/s", 1e-3, 0.05,
        ("line", "bias_time", "moving"), _make_tone,
    ),
    OutsideEffect(
        "rate_noise", "the white noise grows with the rate", "1", 0.5, 10.0,
        ("moving", "acceleration_scatter", "speed"), _make_rate_noise, in_variance=True,
    ),
)  # fmt: skip
