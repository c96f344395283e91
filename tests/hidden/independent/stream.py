"""Simulate the samples that the host receives, and the true biases for the answer."""

from dataclasses import dataclass

import numpy as np
from tests.bench.accuracy.board import factors
from tests.bench.accuracy.noise import wander
from tests.bench.accuracy.profile import FloatArray
from tests.bench.rigs.gyroscope import CODES
from tests.bench.rigs.prior_sizes import HiddenCauses
from tests.bench.rigs.rig import SimulatedRig
from tests.bench.rigs.samples import (
    ACCEL_NOISE_M_S2,
    ACCEL_QUANTUM_M_S2,
    ACCEL_VALID,
    COUNTER_BITS,
    SATURATED,
    TEMPERATURE_OFFSET_DEGC,
    TEMPERATURE_QUANTUM_K,
    TEMPERATURE_VALID,
    TICK_HZ,
    BoardStream,
    IntArray,
    StreamTruth,
)
from tests.hidden.independent.effects.effect import Effect
from tests.hidden.independent.simulation import NO_EFFECT, GridRates, Scene, interpolate_rows

from gyrorig_protocol.program import MotionProgram

MEAN_BIAS_CAUSES = ("thermal_bias", "warm_up", "bias_ramp", "bias_step")


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedRecording:
    """A session with its samples and its mean bias."""

    rig: SimulatedRig
    mean_bias_rad_s: FloatArray  # (3,), over the recording
    factors: FloatArray  # (9,), of the gain


def simulate_recording(
    scene: Scene,
    program: MotionProgram,
    causes: HiddenCauses,
    effect: Effect = NO_EFFECT,
) -> SimulatedRecording:
    """Return a session with noise; its generator depends on the seed of the rig only."""
    parts = scene.parts
    rng = np.random.default_rng([parts.seed, 0x53414D50])
    board = parts.make_gyroscope(causes)
    rates = scene.simulate_rates(causes, effect, rng)
    count = rates.sample_s.size
    slow_noise = np.stack(
        [wander(level, count, board.odr_hz, rng) for level in board.levels], axis=1
    )
    random_walk = rng.normal(size=(count, 3)) / np.sqrt(board.odr_hz)
    slow_noise += np.cumsum(random_walk, axis=0) * causes.of_axes("bias_random_walk")
    floor_noise = rng.normal(size=(count, 3)) * parts.floor_rad_s_rthz * np.sqrt(0.5 * board.odr_hz)
    jitter_s = causes.get("sample_jitter") * rng.normal(size=(count, 1))
    measured = (
        rates.sample_rates() + rates.compute_slope_rad_s2() * jitter_s + slow_noise + floor_noise
    )
    measured = np.clip(measured, -rates.limit_rad_s, rates.limit_rad_s)
    counts = np.clip(np.rint(measured / board.quantum_rad_s), -CODES, CODES).astype(np.int64)
    stream, mean_age = _make_stream(scene, causes, rates, counts, rng)
    means = {name: part.mean(axis=0) for name, part in rates.bias_parts_rad_s.items()}
    mean_bias = board.bias_rad_s + slow_noise.mean(axis=0)
    mean_bias = mean_bias + sum(means[name] for name in MEAN_BIAS_CAUSES if name in means)
    truth = StreamTruth(
        rest_bias_rad_s=mean_bias,
        base_bias_rad_s=board.bias_rad_s + slow_noise.mean(axis=0),
        bias_parts_rad_s=means,
        delay_s=parts.compute_delay_s(causes) + mean_age / board.odr_hz,
        sample_s=rates.sample_s,
        clean_rad_s=rates.sample_rates(),
    )
    rig = SimulatedRig(
        seed=parts.seed, program=program, causes=causes, baud=parts.baud,
        has_counter=parts.has_counter, session=scene.session,
        tracks=scene.simulate_tracks(causes, effect), motion=scene.simulate_motion(causes, effect),
        gyroscope=board, stream=stream, stream_truth=truth,
        counter_start=parts.counter_start, counter_skew=parts.counter_skew,
    )  # fmt: skip
    return SimulatedRecording(rig, mean_bias, factors(board.gain))


def _make_stream(
    scene: Scene,
    causes: HiddenCauses,
    rates: GridRates,
    counts: IntArray,
    rng: np.random.Generator,
) -> tuple[BoardStream, float]:
    """Return the received stream, and the mean age of the samples in sample periods."""
    parts, ready_s, count = scene.parts, rates.sample_s, rates.sample_s.size
    begin_s, end_s = scene.span_s
    status = np.full(count, ACCEL_VALID | TEMPERATURE_VALID, dtype=np.int64)
    status[np.any(np.abs(counts) >= CODES, axis=1)] |= SATURATED
    counts, mean_age = _repeat_samples(counts, causes.get("repeated_samples"), rng)
    counts = _corrupt_samples(counts, causes.get("corrupt_samples"), rng)
    board_s = (ready_s + rng.uniform(0.0, 4000.0)) * (1.0 + parts.crystal_skew)
    arrival_s = parts.link.compute_arrival_s(ready_s, rng)
    # Another computer records the unit, and its clock has another rate.
    host_s = arrival_s + causes.get("clock_skew") * (arrival_s - 0.5 * (begin_s + end_s))
    warming = parts.make_gyroscope(causes).warming
    measured_degc = warming.read_degc(ready_s - begin_s, end_s - begin_s)
    temperature = np.rint((measured_degc - TEMPERATURE_OFFSET_DEGC) / TEMPERATURE_QUANTUM_K)
    is_received = rng.uniform(size=count) >= causes.get("lost_samples")
    is_received[[0, -1]] = True
    stream = BoardStream(
        host_s=np.maximum.accumulate(host_s)[is_received],
        ticks=(np.floor(board_s * TICK_HZ).astype(np.int64) % 2**COUNTER_BITS)[is_received],
        number=np.flatnonzero(is_received),
        status=status[is_received],
        temperature=temperature.astype(np.int64)[is_received],
        gyro=counts[is_received],
        accel=_simulate_accelerometer(scene, causes, ready_s, rng)[is_received],
    )
    return stream, mean_age


def _repeat_samples(
    counts: IntArray, share: float, rng: np.random.Generator
) -> tuple[IntArray, float]:
    number = np.arange(counts.shape[0])
    is_old = rng.uniform(size=number.size) < share
    is_old[0] = False
    source = np.maximum.accumulate(np.where(is_old, 0, number))
    return counts[source], float(np.mean(number - source))


def _corrupt_samples(counts: IntArray, share: float, rng: np.random.Generator) -> IntArray:
    """Return the counts with one bit changed in some of them."""
    rows = np.flatnonzero(rng.uniform(size=counts.shape[0]) < share)
    out = counts.copy()
    out[rows, rng.integers(3, size=rows.size)] ^= 1 << rng.integers(4, 15, size=rows.size)
    return out


def _simulate_accelerometer(
    scene: Scene, causes: HiddenCauses, ready_s: FloatArray, rng: np.random.Generator
) -> IntArray:
    parts, motion = scene.parts, scene.simulate_motion(causes)
    gain = parts.gyroscope.gain @ np.diag(1.0 + rng.normal(scale=0.01, size=3))
    force = interpolate_rows(motion.gravity_m_s2, (ready_s - motion.edges_s[0]) / motion.cell_s)
    measured = force @ gain.T + rng.normal(scale=0.2, size=3)
    measured = measured + rng.normal(scale=ACCEL_NOISE_M_S2, size=measured.shape)
    return np.asarray(np.rint(measured / ACCEL_QUANTUM_M_S2), dtype=np.int64)
