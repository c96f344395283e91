"""A small rig of this folder's own: angles over time, and the sensor's chain in fine steps.

Nothing here comes from the solver but the interface that is tested: the chain below is a
second formulation (a continuous-time filter integrated exactly, direct averages).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import cont2discrete, lfilter, lfilter_zi

from gyrorig_solver.model import BoardTemperature, RecordingContext, SignalState, Site

Array = NDArray[np.float64]

GAIN = np.array([[1.01, 0.02, -0.015], [-0.012, 0.985, 0.03], [0.008, -0.021, 1.006]])
RATE_HZ = 200.0
BLOCK = 2
FINE = 5
BANDWIDTH_HZ = 50.0
SECONDS = 30.0


def trapezoids(
    time_s: Array, moves: list[tuple[float, float]], speed: float, ramp_s: float
) -> Array:
    """Angle over time: each move (begin, angle) at a speed, ramps of `ramp_s`, analytic."""
    angle = np.zeros_like(time_s)
    for begin, way in moves:
        sign, size = np.sign(way), abs(way)
        cruise = size / speed - ramp_s
        u = np.clip(time_s - begin, 0.0, ramp_s)
        v = np.clip(time_s - begin - ramp_s, 0.0, cruise)
        w = np.clip(time_s - begin - ramp_s - cruise, 0.0, ramp_s)
        angle += sign * speed * (u**2 / (2 * ramp_s) + v + w - w**2 / (2 * ramp_s))
    return angle


def pan_of(time_s: Array) -> Array:
    """Sweeps to and fro, at two speeds, with a stop on the way."""
    moves = [(1.0, 1.2), (3.5, -1.9), (6.5, 0.5), (8.0, 0.9), (11.0, -1.4), (14.5, 1.5)]
    slow = [(18.0, -1.0), (22.5, 0.6), (26.5, -0.5)]
    return trapezoids(time_s, moves, 1.0, 0.4) + trapezoids(time_s, slow, 0.4, 0.2)


def tilt_of(time_s: Array) -> Array:
    """Four poses, with a reversal."""
    moves = [(5.6, 0.5), (10.1, -0.9), (17.0, 0.7), (25.2, -0.4)]
    return trapezoids(time_s, moves, 0.8, 0.2)


def temperature_of(time_s: Array) -> Array:
    """Up and down again, smooth: as fast as a board can."""
    return np.asarray(25.0 + 6.0 * np.sin(2 * np.pi * time_s / 80.0))


@dataclass(frozen=True)
class Rig:
    """The scene of a whole run, and how the same run goes in fine steps."""

    scene: SignalState
    pan: Callable[[Array], Array]
    tilt: Callable[[Array], Array]
    temperature: Callable[[Array], Array]
    build: Callable[..., SignalState]
    gain: Array

    @cached_property
    def measured_base(self) -> Array:
        """What is measured without any effect."""
        return self.measured(self.base())

    def difference(self, sensor_rate: Callable[[Array], Array]) -> Array:
        """What an effect, given by the whole rate with it, changes in the block means."""
        return self.measured(sensor_rate) - self.measured_base

    def measured(
        self,
        sensor_rate: Callable[[Array], Array],
        bandwidth_hz: float = BANDWIDTH_HZ,
        output: Callable[[Array], Array] = lambda rate: rate,
        taken_s: Callable[[Array], Array] = lambda time_s: time_s,
    ) -> Array:
        """Block means of a rate at the sensor given as a function of time, (blocks, 3).

        `output` changes what leaves the filter, `taken_s` when the samples are taken.
        """
        per = 8  # steps to a fine interval of the scene
        step_s = 1.0 / RATE_HZ / FINE / per
        n = (self.scene.interval_count) * per
        time_s = self.scene.edges_s[0] + step_s * (np.arange(n) + 0.5)
        # Second-order Butterworth, w^2/(s^2 + sqrt(2) w s + w^2), held over each step.
        w = 2 * np.pi * bandwidth_hz
        num, den, _ = cont2discrete(
            (np.array([w * w]), np.array([1.0, np.sqrt(2.0) * w, w * w])), step_s
        )
        rate = sensor_rate(time_s)
        steady = lfilter_zi(num[0], den)[:, None] * rate[0]
        out, _ = lfilter(num[0], den, rate, axis=0, zi=steady)
        at = taken_s(self.sample_times_s)
        seen = np.stack([np.interp(at, time_s - step_s / 2, o) for o in output(out).T], axis=1)
        return np.asarray(seen.reshape(-1, BLOCK, 3).mean(axis=1))

    @property
    def sample_times_s(self) -> Array:
        """When samples are taken."""
        return np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ

    def sensor(
        self, pan: Callable[[Array], Array], tilt: Callable[[Array], Array]
    ) -> Callable[[Array], Array]:
        """Rate at the sensor of a run given by its angles, differentiated finely."""

        def rate(time_s: Array) -> Array:
            h = 0.5 * (time_s[1] - time_s[0])
            pan_rate = (pan(time_s + h) - pan(time_s - h)) / (2 * h)
            tilt_rate = (tilt(time_s + h) - tilt(time_s - h)) / (2 * h)
            t = (tilt(time_s + h) + tilt(time_s - h)) / 2
            stage = np.column_stack([tilt_rate, pan_rate * np.sin(t), pan_rate * np.cos(t)])
            return np.asarray(stage @ GAIN.T)

        return rate

    def table(
        self, made_of: Callable[[Array, Array], Array], axis: str
    ) -> Callable[[Array], Array]:
        """An angle over time made step by step from the told one, on a fine grid."""
        time_s = np.arange(-0.05, SECONDS + 0.05, 1.0 / 16000.0)
        angle_rad = (self.pan if axis == "pan" else self.tilt)(time_s)
        made = made_of(time_s, angle_rad)
        return lambda at: np.interp(at, time_s, made)

    def base(self) -> Callable[[Array], Array]:
        """Rate at the sensor without any effect."""
        return self.sensor(pan_of, tilt_of)


def build(
    seconds: float = SECONDS,
    site: Site | None = None,
    with_temperature: bool = True,
    fine: int = FINE,
) -> SignalState:
    """The scene of a run; pulses want a finer grid than the solver's before they agree."""
    n = round(seconds * RATE_HZ)
    edges = (np.arange(n * fine + 1) - fine / 2) / fine / RATE_HZ
    grid = np.arange(-1.0, seconds + 2.0)
    temperature = BoardTemperature(grid, temperature_of(grid), 26.0)
    step = 0.0514 * np.pi / 180
    setting = RecordingContext(
        site=site or Site(52.0, 30.0),
        temperature=temperature if with_temperature else None,
        rad_per_step=(step, step),
        begin_s=0.0,
        end_s=seconds,
        full_scale_rad_s=4.36,
        quantum_rad_s=1.5e-4,
        sample_period_s=1.0 / RATE_HZ,
    )
    return SignalState.build(
        edges,
        np.stack([pan_of(edges), tilt_of(edges)]),
        np.ones(n, dtype=np.bool_),
        instants_per_block=BLOCK,
        intervals_per_instant=fine,
        bandwidth_hz=BANDWIDTH_HZ,
        gain=GAIN,
        bias_rad_s=np.array([0.01, -0.02, 0.005]),
        context=setting,
    )


@pytest.fixture(scope="session")
def rig() -> Rig:
    return Rig(build(), pan_of, tilt_of, temperature_of, build, GAIN)
