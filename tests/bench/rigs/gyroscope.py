"""A gyroscope on the stage: what it shows of the stage's rate, and what else it shows.

The sensing element has gain, non-linearity and a dead band. A low-pass follows, with the white
noise of the element. Slow bias changes are added to it. All signals are on the grid of the motion.
"""

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq
from tests.bench.accuracy.board import QUANTA_RAD_S, rotation
from tests.bench.accuracy.noise import Levels, low_pass
from tests.bench.accuracy.profile import FloatArray
from tests.bench.rigs.prior_sizes import HiddenCauses
from tests.bench.rigs.stage_motion import StageMotion

RATES_AND_BANDWIDTHS_HZ = ((100.0, 25.0), (100.0, 25.0), (100.0, 12.5), (200.0, 50.0))
FULL_SCALE_RAD_S = float(np.radians(250.0))
CODES = 32767
ODR_STD = 0.01  # of the sensor's own oscillator
LEAST_SPEED_RAD_S = 1e-6  # above the rounding errors of a smoothed ramp


@dataclass(frozen=True, slots=True, eq=False)
class Warming:
    """Temperature of the die, degC, and of the thermometer that follows it."""

    begin_degc: float
    self_heating_k: float
    self_heating_s: float
    soak_k: float  # the room warms by so much and cools again
    thermometer_lag_s: float

    def die_degc(self, time_s: FloatArray, end_s: float) -> FloatArray:
        """Return the temperature of the die."""
        since = np.maximum(time_s, 0.0)
        soak = self.soak_k * np.sin(np.pi * np.clip(since / end_s, 0.0, 1.0)) ** 2
        heat = self.self_heating_k * -np.expm1(-since / self.self_heating_s)
        return np.asarray(self.begin_degc + heat + soak)

    def read_degc(self, time_s: FloatArray, end_s: float) -> FloatArray:
        """Return what the thermometer shows: the die through a lag of first order."""
        step_s = 0.05
        grid = np.arange(0.0, end_s + 1.0, step_s)
        die, shown = self.die_degc(grid, end_s), np.empty(grid.size)
        shown[0] = die[0]
        share = -np.expm1(-step_s / max(self.thermometer_lag_s, step_s))
        for k in range(1, grid.size):
            shown[k] = shown[k - 1] + share * (die[k] - shown[k - 1])
        return np.asarray(np.interp(time_s, grid, shown))


@dataclass(frozen=True, slots=True, eq=False)
class Gyroscope:
    """The true properties of one board."""

    gain: FloatArray  # (3, 3), at the mean temperature and at small rates
    bias_rad_s: FloatArray  # (3,)
    lag_s: float  # from the motion to the sample, without the low-pass
    bandwidth_hz: float  # as configured
    nominal_hz: float
    odr_hz: float  # true
    levels: tuple[Levels, Levels, Levels]
    warming: Warming

    @property
    def quantum_rad_s(self) -> float:
        """One count."""
        return self.levels[0].quantum_rad_s

    def cutoff_hz(self, causes: HiddenCauses) -> float:
        """Return the true cut-off of the low-pass."""
        return self.bandwidth_hz * float(np.exp(causes.get("low_pass_lag")))

    def delay_s(self, causes: HiddenCauses) -> float:
        """Return the lag with the low-pass' delay of slow signals, sqrt(2) / (2 pi f)."""
        return self.lag_s + float(np.sqrt(2.0) / (2.0 * np.pi * self.cutoff_hz(causes)))


def draw_gyroscope(rng: np.random.Generator, causes: HiddenCauses) -> Gyroscope:
    """Return a board; data sheets: I3G4250D, MPU-6050, MPU-6500."""
    scale = np.diag(1.0 + rng.normal(scale=0.03, size=3))
    skew = np.eye(3)
    skew[np.tril_indices(3, -1)] = rng.normal(scale=0.01, size=3)
    nominal_hz, bandwidth_hz = RATES_AND_BANDWIDTHS_HZ[
        int(rng.integers(len(RATES_AND_BANDWIDTHS_HZ)))
    ]
    quantum = float(rng.choice(QUANTA_RAD_S))
    white = float(np.radians(0.005 * 6.0 ** rng.uniform()))  # rad/s/sqrt(Hz), one-sided
    flicker_hz, walk_hz = 0.003 * 10.0 ** rng.uniform(size=2)  # where they meet the white noise
    levels = [_draw_levels(white, flicker_hz, walk_hz, quantum, rng) for _ in range(3)]
    return Gyroscope(
        gain=scale @ skew @ rotation(rng.normal(scale=0.03, size=3)),
        bias_rad_s=rng.uniform(-0.1, 0.1, size=3),
        lag_s=float(rng.uniform(0.001, 0.01)),
        bandwidth_hz=bandwidth_hz,
        nominal_hz=nominal_hz,
        odr_hz=nominal_hz * (1.0 + float(rng.normal(scale=ODR_STD))),
        levels=(levels[0], levels[1], levels[2]),
        warming=Warming(
            begin_degc=float(rng.uniform(18.0, 28.0)),
            self_heating_k=float(rng.uniform(0.5, 4.0)),
            self_heating_s=float(rng.uniform(60.0, 300.0)),
            soak_k=float(rng.uniform(8.0, 15.0)) if rng.uniform() < 0.2 else 0.0,
            thermometer_lag_s=causes.get("thermal_bias", "lag_s"),
        ),
    )


def _draw_levels(
    white: float, flicker_hz: float, walk_hz: float, quantum: float, rng: np.random.Generator
) -> Levels:
    white_axis = white * float(rng.uniform(0.8, 1.25))
    flicker = white_axis * float(np.sqrt(np.pi * flicker_hz) * rng.uniform(0.7, 1.4))
    walk = white_axis * float(2.0 * np.pi * walk_hz / 3.0 / np.sqrt(2.0) * rng.uniform(0.7, 1.4))
    return Levels(white_axis, flicker, walk, quantum)


def element_rad_s(
    gyroscope: Gyroscope, motion: StageMotion, causes: HiddenCauses, span_s: tuple[float, float]
) -> FloatArray:
    """Return the rate that the sensing element shows before the low-pass, shape (n, 3)."""
    shown = motion.rate_rad_s @ gyroscope.gain.T
    thermal = causes.of_axes("thermal_scale")
    if np.any(thermal):
        die = gyroscope.warming.die_degc(motion.middle_s - span_s[0], span_s[1] - span_s[0])
        inside = (motion.middle_s >= span_s[0]) & (motion.middle_s <= span_s[1])
        shown = shown * (1.0 + np.outer(die - die[inside].mean(), thermal))
    shown = (
        shown
        + causes.of_axes("scale_quadratic") * shown**2
        + causes.of_axes("scale_cubic") * shown**3
        + causes.of_axes("scale_asymmetry") * np.abs(shown)
    )
    shown = np.where(np.abs(shown) < causes.of_axes("dead_zone"), 0.0, shown)
    shown = shown + _moving_bias(motion, causes)
    return np.asarray(shown + motion.gravity_m_s2 @ g_matrix(causes).T)


def g_matrix(causes: HiddenCauses) -> FloatArray:
    """Return the g-sensitivity, rad/s per m/s^2, sensor axes by stage axes."""
    return np.array([[causes.get("g_sensitivity", f"{a}{b}") for b in "xyz"] for a in "xyz"])


def _moving_bias(motion: StageMotion, causes: HiddenCauses) -> FloatArray:
    """Return the bias that the running motors cause, shape (n, 3)."""
    speed = motion.motor_speed_rad_s
    vibration = np.sum(speed**2, axis=1)
    running = np.any(np.abs(speed) > LEAST_SPEED_RAD_S, axis=1).astype(np.float64)
    return np.outer(vibration, causes.of_axes("vibration_rectification")) + np.outer(
        running, causes.of_axes("motor_coupling")
    )


def filtered_rad_s(
    gyroscope: Gyroscope,
    motion: StageMotion,
    element: FloatArray,
    causes: HiddenCauses,
    rng: np.random.Generator | None,
) -> FloatArray:
    """Return the element's rate with white noise behind lag and low-pass, at each cell's begin.

    The noise is left out where `rng` is None. The ends of the grid are at rest.
    """
    cell_s = motion.cell_s
    values = element - element[0]
    if rng is not None:
        white = np.array([level.white for level in gyroscope.levels])
        values = values + rng.normal(size=values.shape) * white * np.sqrt(0.5 / cell_s)
    size = next_fast_len(values.shape[0], real=True)
    f = rfftfreq(size, cell_s)
    # A mean belongs to the middle of its cell and is smoothed over it.
    response = low_pass(f, gyroscope.cutoff_hz(causes)) / np.sinc(f * cell_s)
    response = response * np.exp(-2j * np.pi * f * (gyroscope.lag_s + 0.5 * cell_s))
    out = irfft(rfft(values, size, axis=0) * response[:, None], size, axis=0)
    return np.asarray(out[: values.shape[0]] + element[0])
