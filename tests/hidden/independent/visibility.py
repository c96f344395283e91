"""Visibility of a hidden effect in one session, relative to the true noise.

`Visibility` whitens the difference of the noise-free rates with the true densities, in the space of
the cosine transform. Then it projects out the parameters of a calibration: gain, bias, time offset
and the start delays of the moves. The energy of the rest is the non-centrality.
"""

from functools import cached_property

import numpy as np
from scipy.fft import dct
from tests.bench.accuracy.profile import FloatArray
from tests.bench.rigs.prior_sizes import HiddenCauses
from tests.bench.rigs.rig import FINE_HZ
from tests.bench.rigs.stage_motion import StageMotion
from tests.hidden.independent.parts import RigParts
from tests.hidden.independent.simulation import NO_CAUSES, GridRates, Scene

MIN_STRENGTH = 1e-9  # relative to the strongest; weaker combinations of shapes are rounding errors
TOLERANCE_S, MAX_ROUNDS = 2e-5, 5  # of the search for the best common delay
JITTER_DRAWS = 60


def compute_coefficient_variances(
    parts: RigParts, count: int, has_white: bool = True
) -> FloatArray:
    """Return the variance of the noise in each cosine coefficient but the mean's, (n - 1, 3).

    Args:
        parts: of the rig.
        count: number of samples.
        has_white: whether the white noise in front of the low-pass is included.
    """
    gyroscope = parts.gyroscope
    odr_hz = gyroscope.odr_hz
    frequency_hz = np.arange(1, count) * odr_hz / (2.0 * count)
    images = np.arange(-int(0.5 * FINE_HZ / odr_hz), int(0.5 * FINE_HZ / odr_hz) + 1)
    alias_hz = frequency_hz[:, None] + odr_hz * images
    response = parts.low_pass.compute_response(alias_hz, gyroscope.bandwidth_hz) / np.sinc(
        alias_hz / FINE_HZ
    )
    folded = np.sum(np.abs(response) ** 2, axis=1)
    white, flicker, walk = (
        np.array([getattr(level, name) for level in gyroscope.levels]) ** 2
        for name in ("white", "flicker", "walk")
    )
    density = np.outer(folded, white * has_white) + np.outer(1.0 / (np.pi * frequency_hz), flicker)
    density += np.outer(1.0 / (2.0 * (np.pi * frequency_hz) ** 2), walk)
    density += parts.floor_rad_s_rthz**2 + gyroscope.quantum_rad_s**2 / (6.0 * odr_hz)
    return np.asarray(0.5 * odr_hz * density)


class Visibility:
    """The signal space of one session without the parameters of a calibration."""

    def __init__(self, scene: Scene) -> None:
        """Simulate the session without hidden effects."""
        self.scene = scene
        self.plain: GridRates = scene.simulate_rates()
        self._count = self.plain.sample_s.size

    @cached_property
    def variances(self) -> FloatArray:
        """Variances of the cosine coefficients, (n - 1, 3)."""
        return compute_coefficient_variances(self.scene.parts, self._count)

    def whiten(self, rows_rad_s: FloatArray) -> FloatArray:
        """Return a signal (n, 3) in units of the noise, without its mean, (3 n - 3,)."""
        coefficients = dct(rows_rad_s, axis=0, norm="ortho")[1:]
        return np.asarray((coefficients / np.sqrt(self.variances)).ravel())

    def project(self, rows_rad_s: FloatArray) -> FloatArray:
        """Return a signal after projecting out the calibration parameters, (3 n - 3,)."""
        white = self.whiten(rows_rad_s)
        return np.asarray(white - self._basis @ (self._basis.T @ white))

    def compute_difference(self, hidden: GridRates, plain: GridRates | None = None) -> FloatArray:
        """Return a difference after removing its best common delay and the other parameters."""
        reference = plain or self.plain
        rates, shift_s = hidden.sample_rates(), 0.0
        slope = self.whiten(self._slope)
        for _ in range(MAX_ROUNDS):
            white = self.whiten(rates - reference.sample_rates(shift_s))
            step_s = float(slope @ white) / float(slope @ slope)
            shift_s += step_s
            if abs(step_s) < TOLERANCE_S:
                break
        return self.project(rates - reference.sample_rates(shift_s))

    @cached_property
    def motion(self) -> StageMotion:
        """The motion without hidden effects."""
        return self.scene.simulate_motion(NO_CAUSES)

    def compute_skew_difference(self, causes: HiddenCauses) -> FloatArray:
        """Return the difference from a clock with another rate, to first order, (n, 3)."""
        begin_s, end_s = self.scene.span_s
        lag_s = causes.get("clock_skew") * (self.plain.sample_s - 0.5 * (begin_s + end_s))
        return np.asarray(-self._slope * lag_s[:, None])

    def compute_noncentrality(self, hidden: GridRates) -> float:
        """Return the non-centrality of the change by hidden causes."""
        difference = self.compute_difference(hidden)
        return float(difference @ difference)

    @cached_property
    def jitter_noncentrality(self) -> float:
        """Non-centrality of jitter of 1 s: tr(S^2) / 2 minus the part in the white level."""
        rng = np.random.default_rng(0)
        draws = np.stack(
            [
                self.project(self._slope * rng.standard_normal((self._count, 1)))
                for _ in range(JITTER_DRAWS)
            ]
        )
        products = (draws @ draws.T) ** 2
        pairs = JITTER_DRAWS * (JITTER_DRAWS - 1)
        whole = float(products.sum() - np.trace(products)) / pairs
        by_axis = (draws**2).reshape(JITTER_DRAWS, -1, 3).sum(axis=1).mean(axis=0)
        level = float((by_axis**2).sum()) / (draws.shape[1] / 3.0)
        return float(0.5 * max(whole - level, 0.0))

    def compute_scatter_noncentrality(self, amplitude: FloatArray) -> float:
        """Return the non-centrality of white noise whose amplitude changes with time.

        It is twice the expected gain of the log-likelihood against a constant amplitude.

        Args:
            amplitude: relative to that at rest, at the samples, (n,).
        """
        variances_after_filter = compute_coefficient_variances(
            self.scene.parts, self._count, has_white=False
        )
        share = np.sqrt(np.mean((1.0 - variances_after_filter / self.variances) ** 2, axis=0))
        profile = 1.0 + np.outer(amplitude**2 - 1.0, share)
        gain = np.log(profile.mean(axis=0)) - np.log(profile).mean(axis=0)
        return float(self._count * gain.sum())

    @cached_property
    def _slope(self) -> FloatArray:
        return self.plain.compute_slope_rad_s2()

    @cached_property
    def _basis(self) -> FloatArray:
        """Orthonormal columns that span the parameters of a calibration."""
        gain = self.scene.parts.gyroscope.gain
        stage = (self.plain.sample_rates() - self.scene.parts.gyroscope.bias_rad_s) @ np.linalg.inv(
            gain
        ).T
        slope = self._slope @ np.linalg.inv(gain).T
        shapes = [np.outer(stage[:, k], unit) for unit in np.eye(3) for k in range(3)]
        shapes.append(self._slope)
        by_axis = (slope[:, 1:] @ gain[:, 1:].T, np.outer(slope[:, 0], gain[:, 0]))
        for axis in (0, 1):
            begins = [at_s for moved, at_s in self.scene.moves_s if moved == axis]
            for begin_s, end_s in zip(begins, [*begins[1:], np.inf], strict=True):
                during = (self.plain.sample_s >= begin_s) & (self.plain.sample_s < end_s)
                shapes.append(by_axis[axis] * during[:, None])
        columns = np.stack([self.whiten(shape) for shape in shapes], axis=1)
        norms = np.linalg.norm(columns, axis=0)
        columns = columns[:, norms > 0.0] / norms[norms > 0.0]
        values, vectors = np.linalg.eigh(columns.T @ columns)
        is_strong = values > MIN_STRENGTH * values.max()
        return np.asarray(columns @ (vectors[:, is_strong] / np.sqrt(values[is_strong])))
