"""Effects of the sensor outside the catalogue; `strange` describes each of them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.physics.effects.axis_effects import Motor
from gyrorig_daemon.emulator.physics.effects.board_effects import MotionSamples
from gyrorig_daemon.emulator.physics.temperature import BoardTemperature

FloatArray = NDArray[np.float64]

_LONG_S = 10.0  # a move has no effect after this time


@dataclass(frozen=True, slots=True)
class Settling:
    """The gain is wrong for a short time after a move begins: u c exp(-t / T)."""

    share: float
    time_constant_s: float

    def added_rad_s(self, moments: MotionSamples) -> FloatArray:
        """See `board_effects.RateEffect`."""
        since = np.full(len(moments.time_s), np.inf)
        for motor in (moments.pan, moments.tilt):
            for begin_s in _find_begins_s(motor, moments.time_s):
                after = moments.time_s - begin_s
                since = np.where((after >= 0.0) & (after < since), after, since)
        fade = self.share * np.exp(-since / self.time_constant_s)
        return np.asarray(fade[:, None] * moments.sensor_rad_s)


def _find_begins_s(motor: Motor, time_s: FloatArray) -> list[float]:
    """Return the times at which the motor began to turn, shortly before or during given times."""
    planned = motor.planned(float(time_s[0]) - _LONG_S, float(time_s[-1]))
    return [
        piece.start_s
        for piece, before in planned
        if before == 0.0 and (piece.speed_steps_s != 0.0 or piece.acceleration_steps_s2 != 0.0)
    ]


@dataclass(frozen=True, slots=True, eq=False)
class Magnet:
    """A constant magnetic field in the room: b cos(pan + p)."""

    bias_rad_s: FloatArray  # (3,)
    phase_rad: float

    def added_rad_s(self, moments: MotionSamples) -> FloatArray:
        """See `board_effects.RateEffect`."""
        return np.outer(np.cos(moments.pan_rad + self.phase_rad), self.bias_rad_s)


@dataclass(frozen=True, slots=True, eq=False)
class TwistedCable:
    """A cable that pulls if the stage is turned and tilted: b sin(pan) sin(tilt)."""

    bias_rad_s: FloatArray  # (3,)

    def added_rad_s(self, moments: MotionSamples) -> FloatArray:
        """See `board_effects.RateEffect`."""
        return np.outer(np.sin(moments.pan_rad) * np.sin(moments.tilt_rad), self.bias_rad_s)


@dataclass(frozen=True, slots=True)
class GainDip:
    """The gain drops near one tilt: -d u exp(-((tilt - t) / w)^2 / 2)."""

    depth: float
    at_rad: float
    width_rad: float

    def added_rad_s(self, moments: MotionSamples) -> FloatArray:
        """See `board_effects.RateEffect`."""
        near = np.exp(-0.5 * ((moments.tilt_rad - self.at_rad) / self.width_rad) ** 2)
        return np.asarray(-self.depth * near[:, None] * moments.sensor_rad_s)


@dataclass(frozen=True, slots=True)
class RateDelay:
    """The delay of the sensor grows with the rate: -q |w| du/dt."""

    delay_s2: float  # seconds of delay per rad/s

    def added_rad_s(self, moments: MotionSamples) -> FloatArray:
        """See `board_effects.RateEffect`."""
        slope = np.gradient(moments.sensor_rad_s, moments.time_s, axis=0)
        speed = np.linalg.norm(moments.sensor_rad_s, axis=1)
        return np.asarray(-self.delay_s2 * speed[:, None] * slope)


@dataclass(frozen=True, slots=True, eq=False)
class CrossProduct:
    """Each axis measures a part of the product of the two others: c u_j u_k."""

    coefficient_s: FloatArray  # (3,)

    def added_rad_s(self, moments: MotionSamples) -> FloatArray:
        """See `board_effects.RateEffect`."""
        u = moments.sensor_rad_s
        return np.asarray(self.coefficient_s * u[:, [1, 2, 0]] * u[:, [2, 0, 1]])


@dataclass(frozen=True, slots=True, eq=False)
class Telegraph:
    """The bias jumps between two values at random times."""

    bias_rad_s: FloatArray  # half the jump, (3,)
    switches_s: FloatArray  # ascending

    def added_rad_s(self, time_s: FloatArray, _temperature: BoardTemperature) -> FloatArray:
        """See `board_effects.BiasEffect`."""
        sign = 1.0 - 2.0 * (np.searchsorted(self.switches_s, time_s) % 2)
        return np.outer(sign, self.bias_rad_s)


@dataclass(frozen=True, slots=True, eq=False)
class SlowThermal:
    """The bias follows the temperature of the board through two lags in series."""

    slope_rad_s_k: FloatArray  # (3,)
    first_lag_s: float
    second_lag_s: float

    def added_rad_s(self, time_s: FloatArray, temperature: BoardTemperature) -> FloatArray:
        """See `board_effects.BiasEffect`: in partial fractions, a difference of two single lags."""
        a, b = self.first_lag_s, self.second_lag_s
        rise = (a * temperature.rise_k(time_s, a) - b * temperature.rise_k(time_s, b)) / (a - b)
        return np.outer(rise, self.slope_rad_s_k)


@dataclass(frozen=True, slots=True, eq=False)
class SoftDeadZone:
    """The sensor measures small rates too small: -u exp(-(u / w)^2)."""

    width_rad_s: float

    def added_rad_s(self, moments: MotionSamples) -> FloatArray:
        """See `board_effects.RateEffect`."""
        u = moments.sensor_rad_s
        return np.asarray(-u * np.exp(-((u / self.width_rad_s) ** 2)))


@dataclass(frozen=True, slots=True, eq=False)
class SmoothAsymmetry:
    """The scale differs between the directions, but not near rest: a u tanh(u / w)."""

    share: FloatArray  # (3,)
    width_rad_s: float

    def added_rad_s(self, moments: MotionSamples) -> FloatArray:
        """See `board_effects.RateEffect`."""
        u = moments.sensor_rad_s
        return np.asarray(self.share * u * np.tanh(u / self.width_rad_s))
