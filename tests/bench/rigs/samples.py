"""Samples of a gyroscope, an accelerometer and a thermometer, with their clocks.

The board's crystal stamps each sample when it is ready. The frame reaches the host after a
shortest latency and a random delay. Two computers may record unit and board, so that the board's
arrival times can have a skew or a step against the unit's.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tests.bench.accuracy.noise import wander
from tests.bench.accuracy.profile import FloatArray
from tests.bench.rigs.gyroscope import (
    CODES,
    FULL_SCALE_RAD_S,
    Gyroscope,
    element_rad_s,
    filtered_rad_s,
    g_matrix,
)
from tests.bench.rigs.prior_sizes import HiddenCauses
from tests.bench.rigs.stage_motion import StageMotion

IntArray = NDArray[np.int64]
TICK_HZ, COUNTER_BITS = 1e6, 32
CRYSTAL_STD = 3e-5
LATENCY_FLOOR_S, LATENCY_MEAN_S = (0.0003, 0.003), 1.5e-4
ACCEL_QUANTUM_M_S2 = 9.80665 / 256.0  # ADXL345 data sheet, full resolution
ACCEL_NOISE_M_S2 = 0.04
TEMPERATURE_QUANTUM_K, TEMPERATURE_OFFSET_DEGC = 0.1, 25.0
SATURATED = 2  # status bit 1
ACCEL_VALID, TEMPERATURE_VALID = 1 << 8, 1 << 10


@dataclass(frozen=True, slots=True, eq=False)
class BoardStream:
    """What the host records of a board; each array has one row per sample that arrived."""

    host_s: FloatArray
    ticks: IntArray
    number: IntArray  # the board's own counter
    status: IntArray
    temperature: IntArray
    gyro: IntArray  # (n, 3)
    accel: IntArray  # (n, 3)


@dataclass(frozen=True, slots=True, eq=False)
class StreamTruth:
    """What is true of the samples, for the comparison."""

    rest_bias_rad_s: FloatArray  # (3,), mean reading at rest over the recording
    base_bias_rad_s: FloatArray  # (3,), the same without g-sensitivity, warm-up and bias step
    bias_parts_rad_s: Mapping[str, FloatArray]  # (3,), part of `rest_bias_rad_s` by each cause
    delay_s: float  # of the time stamps behind the motion
    sample_s: FloatArray  # (n,), true instants
    clean_rad_s: FloatArray  # (n, 3), without noise and counts


def record_board(
    gyroscope: Gyroscope,
    motion: StageMotion,
    causes: HiddenCauses,
    span_s: tuple[float, float],
    rng: np.random.Generator,
    is_noisy: bool = True,
) -> tuple[BoardStream, StreamTruth]:
    """Return the samples between begin and end, and what is true of them."""
    floor_s = float(rng.uniform(*LATENCY_FLOOR_S))
    skew = float(rng.normal(scale=CRYSTAL_STD))
    count = int((span_s[1] - span_s[0]) * gyroscope.odr_hz)
    ready_s = span_s[0] + np.arange(count) / gyroscope.odr_hz
    taken_s = ready_s + causes.get("sample_jitter") * rng.normal(size=count)
    element = element_rad_s(gyroscope, motion, causes, span_s)
    smooth = filtered_rad_s(gyroscope, motion, element, causes, rng if is_noisy else None)
    base, parts = _slow_bias(gyroscope, causes, ready_s, span_s, rng, is_noisy)
    gravity = _at_begins(motion, motion.gravity_m_s2, taken_s)
    clean = _at_begins(motion, smooth, taken_s) + base + sum(parts.values())
    clean = clean + _hum(causes, ready_s)
    limit = FULL_SCALE_RAD_S * max(0.05, 1.0 - causes.get("saturation"))
    if causes.get("saturation"):
        clean = np.clip(clean, -limit, limit)
    gyro = np.clip(np.rint(clean / gyroscope.quantum_rad_s), -CODES, CODES).astype(np.int64)
    status = np.full(count, ACCEL_VALID | TEMPERATURE_VALID, dtype=np.int64)
    status[np.any(np.abs(gyro) >= CODES, axis=1)] |= SATURATED
    gyro, age = _repeat(gyro, causes, rng)
    gyro = _corrupt(gyro, causes, rng)
    ticks = np.floor((ready_s + rng.uniform(0.0, 4000.0)) * TICK_HZ * (1.0 + skew)).astype(np.int64)
    arrival_s = ready_s + floor_s + rng.exponential(LATENCY_MEAN_S, size=count)
    host_s = np.maximum.accumulate(_other_clock(arrival_s, causes, span_s))
    temperature = gyroscope.warming.read_degc(ready_s - span_s[0], span_s[1] - span_s[0])
    stream = BoardStream(
        host_s=host_s,
        ticks=ticks % 2**COUNTER_BITS,
        number=np.arange(count, dtype=np.int64),
        status=status,
        temperature=np.rint((temperature - TEMPERATURE_OFFSET_DEGC) / TEMPERATURE_QUANTUM_K).astype(
            np.int64
        ),
        gyro=gyro,
        accel=_accelerometer(gyroscope, gravity, rng),
    )
    means = {cause: part.mean(axis=0) for cause, part in parts.items()}
    means["g_sensitivity"] = (gravity @ g_matrix(causes).T).mean(axis=0)
    rest_bias = base.mean(axis=0) + sum(means.values())
    die_degc = gyroscope.warming.die_degc(ready_s - span_s[0], span_s[1] - span_s[0])
    late_k = float(np.mean(die_degc - temperature))
    truth = StreamTruth(
        rest_bias_rad_s=rest_bias,
        base_bias_rad_s=base.mean(axis=0) + means["thermal_bias"],
        bias_parts_rad_s={
            **{cause: means[cause] for cause in ("g_sensitivity", "warm_up", "bias_step")},
            "thermal_bias": late_k * causes.of_axes("thermal_bias"),
        },
        delay_s=gyroscope.delay_s(causes) + floor_s + age / gyroscope.odr_hz,
        sample_s=ready_s,
        clean_rad_s=clean,
    )
    return _without_lost(stream, causes, rng), truth


def _slow_bias(
    gyroscope: Gyroscope,
    causes: HiddenCauses,
    time_s: FloatArray,
    span_s: tuple[float, float],
    rng: np.random.Generator,
    is_noisy: bool,
) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Return the bias at rest without causes, and what each cause adds.

    Each has shape (n, 3). The random walk of a cause belongs to the bias.
    """
    since, long_s = time_s - span_s[0], span_s[1] - span_s[0]
    base = np.tile(gyroscope.bias_rad_s, (time_s.size, 1))
    if is_noisy:
        columns = [wander(v, time_s.size, gyroscope.odr_hz, rng) for v in gyroscope.levels]
        base = base + np.stack(columns, axis=1)
    die = gyroscope.warming.die_degc(since, long_s)
    warm_s = causes.get("warm_up", "time_s") or 1.0
    walk = rng.normal(size=(time_s.size, 3)) / np.sqrt(gyroscope.odr_hz)
    base = base + np.cumsum(walk, axis=0) * causes.of_axes("bias_random_walk")
    is_after = since >= causes.get("bias_step", "at") * long_s
    return base, {
        "thermal_bias": np.outer(die - TEMPERATURE_OFFSET_DEGC, causes.of_axes("thermal_bias")),
        "warm_up": np.outer(np.exp(-since / warm_s), causes.of_axes("warm_up")),
        "bias_ramp": np.outer(since - long_s / 2.0, causes.of_axes("bias_ramp")),
        "bias_step": np.outer(is_after, causes.of_axes("bias_step")),
    }


def _hum(causes: HiddenCauses, time_s: FloatArray) -> FloatArray:
    phase = 2.0 * np.pi * causes.get("supply_hum", "line_hz") * time_s
    wave = np.sin(phase + causes.get("supply_hum", "phase"))
    return np.outer(wave, causes.of_axes("supply_hum"))


def _at_begins(motion: StageMotion, values: FloatArray, time_s: FloatArray) -> FloatArray:
    """Interpolate values at cell begins with cubics through four of them, shape (n, 3)."""
    where = (time_s - motion.edges_s[0]) / motion.cell_s
    k = np.clip(np.floor(where).astype(np.int64), 1, values.shape[0] - 3)
    u = (where - k)[:, None]
    a, b, c, d = (values[k + j] for j in (-1, 0, 1, 2))
    return np.asarray(
        -a * u * (u - 1) * (u - 2) / 6
        + b * (u + 1) * (u - 1) * (u - 2) / 2
        - c * (u + 1) * u * (u - 2) / 2
        + d * (u + 1) * u * (u - 1) / 6
    )


def _other_clock(
    time_s: FloatArray, causes: HiddenCauses, span_s: tuple[float, float]
) -> FloatArray:
    middle_s = (span_s[0] + span_s[1]) / 2.0
    event_s = span_s[0] + causes.get("clock_step", "at") * (span_s[1] - span_s[0])
    return np.asarray(
        time_s
        + causes.get("clock_skew") * (time_s - middle_s)
        + causes.get("clock_step") * (time_s >= event_s)
    )


def _repeat(
    gyro: IntArray, causes: HiddenCauses, rng: np.random.Generator
) -> tuple[IntArray, float]:
    """Return the counts, some the same as before, and the mean age in samples."""
    repeated = np.asarray(rng.uniform(size=gyro.shape[0]) < causes.get("repeated_samples"))
    repeated[0] = False
    source = np.maximum.accumulate(np.where(repeated, 0, np.arange(gyro.shape[0])))
    return gyro[source], float(np.mean(np.arange(gyro.shape[0]) - source))


def _corrupt(gyro: IntArray, causes: HiddenCauses, rng: np.random.Generator) -> IntArray:
    """Return the counts with single bits flipped in 16-bit words."""
    rows = np.flatnonzero(rng.uniform(size=gyro.shape[0]) < causes.get("corrupt_samples"))
    axis, bit = rng.integers(3, size=rows.size), rng.integers(4, 15, size=rows.size)
    out = gyro.copy()
    out[rows, axis] ^= 1 << bit
    return out


def _accelerometer(gyroscope: Gyroscope, gravity: FloatArray, rng: np.random.Generator) -> IntArray:
    gain = gyroscope.gain @ np.diag(1.0 + rng.normal(scale=0.01, size=3))
    shown = gravity @ gain.T + rng.normal(scale=0.2, size=3)
    shown = shown + rng.normal(scale=ACCEL_NOISE_M_S2, size=shown.shape)
    return np.rint(shown / ACCEL_QUANTUM_M_S2).astype(np.int64)


def _without_lost(
    stream: BoardStream, causes: HiddenCauses, rng: np.random.Generator
) -> BoardStream:
    share = causes.get("lost_samples")
    if not share:
        return stream
    is_received = rng.uniform(size=stream.number.size) >= share
    is_received[[0, -1]] = True
    rows = np.flatnonzero(is_received)
    columns = (getattr(stream, name)[rows] for name in BoardStream.__slots__)
    return BoardStream(*columns)
