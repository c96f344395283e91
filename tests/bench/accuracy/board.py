"""A simulated board on the stage: gain, bias, lag, noise, and the counts that it sends."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq
from tests.bench.accuracy.motor_noise import MotorNoise
from tests.bench.accuracy.noise import Levels, low_pass, wander
from tests.bench.accuracy.profile import FloatArray, Path

GROUPS = ("bias", "scale", "nonorthogonality", "misalignment")
NAMES = (
    "bias.x", "bias.y", "bias.z",
    "scale.x", "scale.y", "scale.z",
    "nonorthogonality.xy", "nonorthogonality.zx", "nonorthogonality.zy",
    "misalignment.x", "misalignment.y", "misalignment.z",
    "time_offset",
)  # fmt: skip
QUANTA_RAD_S = tuple(float(np.radians(mdps * 1e-3)) for mdps in (8.75, 7.62939453125))
PAD_S = 1.0  # of rest about a piece, for the low-pass


@dataclass(frozen=True, slots=True, eq=False)
class Board:
    """What is true of one board in one run."""

    gain: FloatArray  # (3, 3)
    bias_rad_s: FloatArray  # (3,), at the begin
    lag_s: float  # from the stage's motion to the sample, the low-pass apart
    bandwidth_hz: float
    rate_hz: float
    levels: tuple[Levels, Levels, Levels]

    @property
    def delay_s(self) -> float:
        """The whole lag: with the low-pass' group delay at 0, sqrt(2)/(2 pi f_c)."""
        return self.lag_s + float(np.sqrt(2.0) / (2.0 * np.pi * self.bandwidth_hz))

    @property
    def oversampling(self) -> int:
        """How many fine intervals make a sample."""
        return max(5, round(20.0 * self.bandwidth_hz / self.rate_hz))


def draw_board(rate_hz: float, bandwidth_hz: float, rng: np.random.Generator) -> Board:
    """Return a board of an ordinary kind (data sheets: L3G4200D, MPU-6050, MPU-6500)."""
    scale = np.diag(1.0 + rng.normal(scale=0.03, size=3))
    skew = np.eye(3)
    skew[np.tril_indices(3, -1)] = rng.normal(scale=0.01, size=3)
    gain = scale @ skew @ rotation(rng.normal(scale=0.03, size=3))
    white = np.radians(0.005 * 6.0 ** rng.uniform())  # 0.005 to 0.03 dps/sqrt(Hz)
    flicker_hz, walk_hz = 0.003 * 10.0 ** rng.uniform(size=2)  # where they meet the white
    quantum = float(rng.choice(QUANTA_RAD_S))
    levels = []
    for _ in range(3):
        white_axis = white * float(rng.uniform(0.8, 1.25))
        levels.append(
            Levels(
                white=white_axis,
                flicker=white_axis * float(np.sqrt(np.pi * flicker_hz) * rng.uniform(0.7, 1.4)),
                walk=white_axis
                * float(2.0 * np.pi * walk_hz / 3.0 / np.sqrt(2.0) * rng.uniform(0.7, 1.4)),
                quantum_rad_s=quantum,
            )
        )
    return Board(
        gain=gain,
        bias_rad_s=rng.uniform(-0.1, 0.1, size=3),
        lag_s=float(rng.uniform(0.002, 0.03)),
        bandwidth_hz=bandwidth_hz,
        rate_hz=rate_hz,
        levels=(levels[0], levels[1], levels[2]),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Counts:
    """The samples of one run and what they were made of."""

    time_s: FloatArray  # (n,)
    rate_rad_s: FloatArray  # (n, 3), whole quanta
    clean_rad_s: FloatArray  # (n, 3), G omega through the low-pass
    bias_rad_s: FloatArray  # (n, 3), as it wandered

    @property
    def noise_rad_s(self) -> FloatArray:
        """All that is not motion nor the mean bias."""
        return np.asarray(self.rate_rad_s - self.clean_rad_s - self.bias_rad_s.mean(axis=0))


def sample(
    board: Board,
    path: Path,
    span_s: tuple[float, float],
    rng: np.random.Generator,
    motor_noise: MotorNoise | None = None,
) -> Counts:
    """Return the samples of a board from span begin to end."""
    begin_s, end_s = span_s
    n = int((end_s - begin_s) * board.rate_hz)
    time_s = begin_s + np.arange(n) / board.rate_hz
    clean = seen(board, path, begin_s, n) @ board.gain.T
    bias = board.bias_rad_s + np.stack(
        [wander(level, n, board.rate_hz, rng) for level in board.levels], axis=1
    )
    white = np.stack([_white(board, level, n, rng) for level in board.levels], axis=1)
    if motor_noise is not None:
        late_s = begin_s - board.lag_s
        fine_s = late_s + np.arange(n * board.oversampling) / (board.rate_hz * board.oversampling)
        amplitude = motor_noise.amplitude(path, fine_s)
        white += np.stack([_white(board, level, n, rng, amplitude) for level in board.levels], 1)
    quantum = board.levels[0].quantum_rad_s
    rate = np.rint((clean + bias + white) / quantum) * quantum
    return Counts(time_s, rate, clean, bias)


def seen(board: Board, path: Path, begin_s: float, count: int, slope: bool = False) -> FloatArray:
    """Return the stage rate, or its slope in time, as samples see it, shape (count, 3).

    Args:
        board: for its lag, low-pass and rate.
        path: at rest within a second before the first and after the last sample.
        begin_s: time of the first sample.
        count: how many.
        slope: the derivative instead.
    """
    fine_hz = board.rate_hz * board.oversampling
    pad = round(PAD_S * board.rate_hz)
    m = next_fast_len((count + 2 * pad) * board.oversampling, real=True)
    edges = begin_s - pad / board.rate_hz + np.arange(m + 1) / fine_hz
    return through(board, path.mean_rate_rad_s(edges), slope)[pad : pad + count]


def through(board: Board, rate_rad_s: FloatArray, slope: bool) -> FloatArray:
    """Send means over fine intervals through lag and low-pass; value k is at interval k's begin."""
    m, fine_hz = rate_rad_s.shape[0], board.rate_hz * board.oversampling
    f = rfftfreq(m, 1.0 / fine_hz)
    # A mean belongs to its interval's middle, and has been smoothed over it.
    response = low_pass(f, board.bandwidth_hz) / np.sinc(f / fine_hz)
    response = response * np.exp(-2j * np.pi * f * (board.lag_s + 0.5 / fine_hz))
    if slope:
        response = response * 2j * np.pi * f
    filtered = irfft(rfft(rate_rad_s, axis=0) * response[:, None], m, axis=0)
    return np.asarray(filtered[:: board.oversampling], dtype=np.float64)


def _white(
    board: Board,
    level: Levels,
    count: int,
    rng: np.random.Generator,
    amplitude: FloatArray | None = None,
) -> FloatArray:
    fine_hz = board.rate_hz * board.oversampling
    m = next_fast_len(count * board.oversampling, real=True)
    f = rfftfreq(m, 1.0 / fine_hz)
    raw = rng.normal(scale=level.white * np.sqrt(fine_hz / 2.0), size=m)
    if amplitude is not None:
        raw[: amplitude.size] *= amplitude
        raw[amplitude.size :] = 0.0
    smooth = irfft(rfft(raw) * low_pass(f, board.bandwidth_hz), m)
    return np.asarray(smooth[: count * board.oversampling : board.oversampling], dtype=np.float64)


def rotation(vector: FloatArray) -> FloatArray:
    """Return the rotation by a vector, from its quaternion."""
    angle = float(np.linalg.norm(vector))
    w = np.cos(angle / 2.0)
    x, y, z = vector * (0.5 * np.sinc(angle / (2.0 * np.pi)))
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def factors(gain: FloatArray) -> FloatArray:
    """Return scale, non-orthogonality and misalignment of G = S T M, shape (9,).

    G G' = L L' with L = S T lower triangular (Cholesky), and M = L^-1 G.
    """
    lower = np.linalg.cholesky(gain @ gain.T)
    scale = np.diag(lower)
    unit = lower / scale[:, None]
    turn = np.linalg.solve(lower, gain)
    skew = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    sine = float(np.linalg.norm(skew)) / 2.0
    vector = skew / 2.0 * (np.arcsin(sine) / sine if sine > 0.0 else 1.0)
    return np.concatenate([scale, [unit[1, 0], unit[2, 0], unit[2, 1]], vector])


def factor_slopes(gain: FloatArray) -> NDArray[np.float64]:
    """Return d factors / d G row by row, by central differences, shape (9, 9)."""
    columns = []
    for k in range(9):
        step = np.zeros(9)
        step[k] = 1e-6
        change = step.reshape(3, 3)
        columns.append((factors(gain + change) - factors(gain - change)) / 2e-6)
    return np.stack(columns, axis=1)
