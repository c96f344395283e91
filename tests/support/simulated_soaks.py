"""Simulated rests of a gyroscope in a chamber, for the bias against the temperature.

The simulation shares no code with the solver: the thermometer is a first-order lag behind the die,
flicker noise is a sum of relaxation processes, and the hysteresis is a play (backlash) operator.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]
GRID_S = 1.0
OCTAVES = 14  # of the flicker noise
CUBIC_DPS = np.array([[0.6, -0.3, 0.2], [0.2, 0.1, -0.1], [-0.15, 0.05, 0.1]])
MIDDLE_DEGC, HALF_RANGE_K = 30.0, 30.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Soak:
    """How a rest in a chamber is simulated; rates in deg/s."""

    profile: str = "up_and_down"
    duration_s: float = 3600.0
    coefficients_dps: Array = field(default_factory=lambda: CUBIC_DPS)  # of x, x^2, x^3; x = -1..1
    thermometer_lag_s: float = 20.0
    loop_dps: float = 0.0  # bias while heating minus bias while cooling
    white_dps: float = 0.0112  # of means over 1 s: 0.05 deg/s at 20 Hz
    flicker_dps: float = 0.003  # B of S(f) = B^2 / (pi f)
    walk_dps: float = 0.0  # after one second
    start_degc: float = 0.0  # and end, of the profile `constant`


@dataclass(frozen=True, slots=True, eq=False)
class SoakData:
    """One simulated rest on a grid of one second."""

    time_s: Array  # (n,)
    thermometer_degc: Array  # (n,)
    rate_dps: Array  # (n, 3)
    offset_dps: Array  # (3,), bias at the middle temperature: mean over the rest

    def curve_dps(self, degc: Array, coefficients: Array = CUBIC_DPS) -> Array:
        """Return the true bias at temperatures (n,), shape (n, 3)."""
        return self.offset_dps + polynomial_dps(degc, coefficients)


def polynomial_dps(degc: Array, coefficients: Array) -> Array:
    """Return the bias relative to the middle temperature, (n, 3)."""
    x = (degc - MIDDLE_DEGC) / HALF_RANGE_K
    powers = x[:, None] ** np.arange(1, len(coefficients) + 1)
    return np.asarray(powers @ coefficients, dtype=np.float64)


def die_degc(soak: Soak, time_s: Array) -> Array:
    """Return the temperature of the die, (n,)."""
    share = time_s / soak.duration_s
    if soak.profile == "up_and_down":
        ends = ([0.0, 0.05, 0.5, 0.55, 0.95, 1.0], [0.0, 0.0, 60.0, 60.0, 0.0, 0.0])
        return np.asarray(np.interp(share, *ends), dtype=np.float64)
    if soak.profile == "up":
        ends = ([0.0, 0.1, 0.9, 1.0], [0.0, 0.0, 60.0, 60.0])
        return np.asarray(np.interp(share, *ends), dtype=np.float64)
    if soak.profile == "warm_up":
        return np.asarray(22.0 + 30.0 * (1.0 - np.exp(-5.0 * share)), dtype=np.float64)
    return np.full(time_s.size, soak.start_degc) + 0.5 * np.sin(6.0 * share)


def simulate_soak(soak: Soak, seed: int) -> SoakData:
    """Simulate one rest."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(0.0, soak.duration_s, GRID_S)
    die = die_degc(soak, time_s)
    decay = np.exp(-GRID_S / soak.thermometer_lag_s) if soak.thermometer_lag_s else 0.0
    read = lfilter([1.0 - decay], [1.0, -decay], die, zi=[decay * die[0]])[0]
    read = np.round((read + rng.normal(0.0, 0.03, die.size)) * 16.0) / 16.0
    slow = _flicker(rng, die.size) * soak.flicker_dps
    slow += np.cumsum(rng.normal(size=(die.size, 3)), axis=0) * soak.walk_dps * np.sqrt(GRID_S)
    bias = polynomial_dps(die, soak.coefficients_dps) + 0.5 * soak.loop_dps * _play(die)[:, None]
    offset = rng.normal(0.0, 0.3, 3)
    white = rng.normal(0.0, soak.white_dps, (die.size, 3))
    return SoakData(time_s, read, offset + bias + slow + white, offset + slow.mean(axis=0))


def write_soak_csv(path: Path, soak: Soak, seed: int, rate_hz: int = 20) -> SoakData:
    """Write a rest as a table of samples, with more white noise than the grid has."""
    simulated = simulate_soak(soak, seed)
    rng = np.random.default_rng(seed + 1000)
    time_s = np.arange(int(soak.duration_s * rate_hz)) / rate_hz
    rate = np.stack(
        [np.interp(time_s, simulated.time_s, axis) for axis in simulated.rate_dps.T], axis=1
    )
    rate += rng.normal(0.0, 0.05, rate.shape)
    degc = np.interp(time_s, simulated.time_s, simulated.thermometer_degc)
    np.savetxt(
        path,
        np.column_stack([time_s, rate, degc]),
        fmt=["%.3f", "%.6f", "%.6f", "%.6f", "%.4f"],
        delimiter=",",
        header="t,gx,gy,gz,degc",
        comments="",
    )
    return simulated


def _flicker(rng: np.random.Generator, count: int) -> Array:
    """Return noise with S(f) = 1/(pi f) between the slowest and the fastest process, (n, 3).

    A relaxation process of variance s^2 per octave of its time constant gives the sum
    S(f) = s^2 / (f ln 2); one-sided.
    """
    total = np.zeros((count, 3))
    std = np.sqrt(np.log(2.0) / np.pi)
    for octave in range(OCTAVES):
        decay = np.exp(-(2.0**-octave))
        start = rng.normal(0.0, std, 3)
        steps = rng.normal(0.0, std * np.sqrt(1.0 - decay**2), (count, 3))
        total += lfilter([1.0], [1.0, -decay], steps, axis=0, zi=(decay * start)[None])[0]
    return total


def _play(degc: Array, width_k: float = 3.0) -> Array:
    """Return a backlash of the temperature, -1 to 1, (n,)."""
    out = np.zeros(degc.size)
    centre = degc[0]
    for k, value in enumerate(degc):
        centre = min(max(centre, value - width_k), value + width_k)
        out[k] = (value - centre) / width_k
    return out
