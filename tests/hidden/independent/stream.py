"""The samples of a session as the host receives them, and the true biases for the answer."""

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
from tests.hidden.independent.simulation import NO_EFFECT, GridRates, Scene, interpolated

from gyrorig_protocol.program import MotionProgram

MEAN_BIAS_CAUSES = ("thermal_bias", "warm_up", "bias_ramp", "bias_step")


@dataclass(frozen=True, slots=True, eq=False)
class Recorded:
    """A session with its samples, ready to be written, and its mean bias."""

    rig: SimulatedRig
    mean_bias_rad_s: FloatArray  # (3,), over the recording
    factors: FloatArray  # (9,), of the gain


def recorded(
    scene: Scene,
    program: MotionProgram,
    causes: HiddenCauses,
    effect: Effect = NO_EFFECT,
) -> Recorded:
    """Return a session with noise; its generator depends on the seed of the rig alone."""
    parts = scene.parts
    rng = np.random.default_rng([parts.seed, 0x53414D50])
    board = parts.board(causes)
    rates = scene.rates(causes, effect, rng)
    count = rates.sample_s.size
    slow = np.stack([wander(level, count, board.odr_hz, rng) for level in board.levels], axis=1)
    walk = rng.normal(size=(count, 3)) / np.sqrt(board.odr_hz)
    slow += np.cumsum(walk, axis=0) * causes.of_axes("bias_random_walk")
    floor = rng.normal(size=(count, 3)) * parts.floor_rad_s_rthz * np.sqrt(0.5 * board.odr_hz)
    jitter_s = causes.get("sample_jitter") * rng.normal(size=(count, 1))
    shown = rates.at() + rates.slope_rad_s2() * jitter_s + slow + floor
    shown = np.clip(shown, -rates.limit_rad_s, rates.limit_rad_s)
    counts = np.clip(np.rint(shown / board.quantum_rad_s), -CODES, CODES).astype(np.int64)
    stream, age = _stream(scene, causes, rates, counts, rng)
    means = {name: part.mean(axis=0) for name, part in rates.bias_parts_rad_s.items()}
    mean_bias = board.bias_rad_s + slow.mean(axis=0)
    mean_bias = mean_bias + sum(means[name] for name in MEAN_BIAS_CAUSES if name in means)
    truth = StreamTruth(
        rest_bias_rad_s=mean_bias,
        base_bias_rad_s=board.bias_rad_s + slow.mean(axis=0),
        bias_parts_rad_s=means,
        delay_s=parts.delay_s(causes) + age / board.odr_hz,
        sample_s=rates.sample_s,
        clean_rad_s=rates.at(),
    )
    rig = SimulatedRig(
        seed=parts.seed, program=program, causes=causes, baud=parts.baud,
        has_counter=parts.has_counter, session=scene.session,
        tracks=scene.tracks(causes, effect), motion=scene.motion(causes, effect),
        gyroscope=board, stream=stream, stream_truth=truth,
        counter_start=parts.counter_start, counter_skew=parts.counter_skew,
    )  # fmt: skip
    return Recorded(rig, mean_bias, factors(board.gain))


def _stream(
    scene: Scene,
    causes: HiddenCauses,
    rates: GridRates,
    counts: IntArray,
    rng: np.random.Generator,
) -> tuple[BoardStream, float]:
    """Return what arrives, and the mean age of the samples in samples."""
    parts, ready_s, count = scene.parts, rates.sample_s, rates.sample_s.size
    begin_s, end_s = scene.span_s
    status = np.full(count, ACCEL_VALID | TEMPERATURE_VALID, dtype=np.int64)
    status[np.any(np.abs(counts) >= CODES, axis=1)] |= SATURATED
    counts, age = _repeated(counts, causes.get("repeated_samples"), rng)
    counts = _corrupted(counts, causes.get("corrupt_samples"), rng)
    board_s = (ready_s + rng.uniform(0.0, 4000.0)) * (1.0 + parts.crystal_skew)
    arrival_s = parts.link.arrival_s(ready_s, rng)
    # Another computer records the unit, and its clock has another rate.
    host_s = arrival_s + causes.get("clock_skew") * (arrival_s - 0.5 * (begin_s + end_s))
    warming = parts.board(causes).warming
    shown_degc = warming.read_degc(ready_s - begin_s, end_s - begin_s)
    temperature = np.rint((shown_degc - TEMPERATURE_OFFSET_DEGC) / TEMPERATURE_QUANTUM_K)
    is_received = rng.uniform(size=count) >= causes.get("lost_samples")
    is_received[[0, -1]] = True
    stream = BoardStream(
        host_s=np.maximum.accumulate(host_s)[is_received],
        ticks=(np.floor(board_s * TICK_HZ).astype(np.int64) % 2**COUNTER_BITS)[is_received],
        number=np.flatnonzero(is_received),
        status=status[is_received],
        temperature=temperature.astype(np.int64)[is_received],
        gyro=counts[is_received],
        accel=_accelerometer(scene, causes, ready_s, rng)[is_received],
    )
    return stream, age


def _repeated(counts: IntArray, share: float, rng: np.random.Generator) -> tuple[IntArray, float]:
    number = np.arange(counts.shape[0])
    is_old = rng.uniform(size=number.size) < share
    is_old[0] = False
    source = np.maximum.accumulate(np.where(is_old, 0, number))
    return counts[source], float(np.mean(number - source))


def _corrupted(counts: IntArray, share: float, rng: np.random.Generator) -> IntArray:
    """Return the counts with one bit changed in some of them."""
    rows = np.flatnonzero(rng.uniform(size=counts.shape[0]) < share)
    out = counts.copy()
    out[rows, rng.integers(3, size=rows.size)] ^= 1 << rng.integers(4, 15, size=rows.size)
    return out


def _accelerometer(
    scene: Scene, causes: HiddenCauses, ready_s: FloatArray, rng: np.random.Generator
) -> IntArray:
    parts, motion = scene.parts, scene.motion(causes)
    gain = parts.gyroscope.gain @ np.diag(1.0 + rng.normal(scale=0.01, size=3))
    force = interpolated(motion.gravity_m_s2, (ready_s - motion.edges_s[0]) / motion.cell_s)
    shown = force @ gain.T + rng.normal(scale=0.2, size=3)
    shown = shown + rng.normal(scale=ACCEL_NOISE_M_S2, size=shown.shape)
    return np.asarray(np.rint(shown / ACCEL_QUANTUM_M_S2), dtype=np.int64)
