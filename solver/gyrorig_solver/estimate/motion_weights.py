"""The weights of a recording whose noise is larger in motion, or has jitter of the sample times.

What to use when: `MotionWeights.of` for an estimate of the noise in motion; `updated` for an
estimate from the residuals of a fit.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate.noise.jitter_noise import JitterNoise, estimate_jitter_noise
from gyrorig_solver.estimate.noise.motion_noise import (
    MotionNoise,
    MotionResidual,
    estimate_motion_noise,
)
from gyrorig_solver.estimate.noise.noise_model import NoiseModel
from gyrorig_solver.estimate.noise.relative_std import MAX_LOG_WEIGHT_CHANGE, RelativeStd
from gyrorig_solver.estimate.series_state import SeriesState

MAX_LOG_JITTER_CHANGE = 0.015  # of its standard deviation; smaller changes keep the old weights


@dataclass(frozen=True, slots=True, eq=False)
class MotionWeights:
    """The noise in motion and the jitter of a recording, with the weights at its motion."""

    motion_noise: MotionNoise | None = None  # None: the sensor's noise is the same in motion
    jitter_noise: JitterNoise | None = None  # None: the residual shows no jitter
    relative_stds: dict[tuple[int, int], RelativeStd] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        motion_noise: MotionNoise | None,
        jitter_noise: JitterNoise | None,
        states: Sequence[SeriesState],
    ) -> Self:
        """Return the weights at the current motion of all series."""
        if motion_noise is None and jitter_noise is None:
            return cls()
        relative_stds: dict[tuple[int, int], RelativeStd] = {}
        for series_index, state in enumerate(states):
            parts = state.series.part_slices()
            for blocks in parts:
                relative_stds[series_index, blocks.start] = _relative_std(
                    motion_noise, jitter_noise, state, blocks, keeps_constant=len(parts) > 1
                )
        return cls(motion_noise, jitter_noise, relative_stds)

    def at_states(self, states: Sequence[SeriesState]) -> "MotionWeights":
        """Return the weights of the same noise at other states, or another motion."""
        return MotionWeights.of(self.motion_noise, self.jitter_noise, states)

    def relative_std(self, series_index: int, blocks: slice) -> RelativeStd | None:
        """Return the noise of a part relative to that at rest; None: the same at all times."""
        return self.relative_stds.get((series_index, blocks.start))

    def relative_variances(self, states: Sequence[SeriesState]) -> list[FloatArray | None]:
        """Return the variance of the white noise relative to that at rest, (n, 3); None: 1."""
        if not self.relative_stds:
            return [None] * len(states)
        return [
            np.concatenate(
                [
                    self.relative_stds[series_index, blocks.start].white_variance.T
                    for blocks in state.series.part_slices()
                ]
            )
            for series_index, state in enumerate(states)
        ]

    def mean_ratios(self, states: Sequence[SeriesState]) -> dict[str, FloatArray]:
        """Return the white noise of each motor state relative to that at rest, (3,) each."""
        if self.motion_noise is None:
            return {}
        used_rates = np.concatenate([state.rate[state.used] for state in states])
        return self.motion_noise.mean_ratios(used_rates)

    def updated(
        self,
        states: Sequence[SeriesState],
        residuals: Sequence[FloatArray],
        gain: FloatArray,
        noise: NoiseModel,
    ) -> "MotionWeights":
        """Return the weights from residuals, (n, 3) each; the same object if nothing changed.

        Args:
            states: of all series.
            residuals: of each.
            gain: G, shape (3, 3).
            noise: at rest.
        """
        series = [
            MotionResidual(residual, state.rate, state.used, state.series.part_slices())
            for state, residual in zip(states, residuals, strict=True)
        ]
        motion_noise = estimate_motion_noise(series, noise)
        jitter_noise = estimate_jitter_noise(series, gain, noise, motion_noise)
        if jitter_noise is not None and motion_noise is not None:
            # A part of the noise in motion can be that of the jitter.
            motion_noise = estimate_motion_noise(_without_jitter(series, jitter_noise), noise)
            jitter_noise = estimate_jitter_noise(series, gain, noise, motion_noise)
        if not (self._is_other_jitter(jitter_noise) or self._is_other(motion_noise, states)):
            return self
        return MotionWeights.of(motion_noise, jitter_noise, states)

    def _is_other_jitter(self, jitter_noise: JitterNoise | None) -> bool:
        """Return whether another jitter gives other weights."""
        previous = self.jitter_noise
        if jitter_noise is None or previous is None:
            return jitter_noise is not previous
        ratio = jitter_noise.deviation_s / previous.deviation_s
        return abs(float(np.log(ratio))) > MAX_LOG_JITTER_CHANGE

    def _is_other(self, motion_noise: MotionNoise | None, states: Sequence[SeriesState]) -> bool:
        """Return whether another noise in motion gives other weights."""
        previous = self.motion_noise
        if motion_noise is None or previous is None:
            return motion_noise is not previous
        ratios = [
            motion_noise.relative_variance(state.rate) / previous.relative_variance(state.rate)
            for state in states
        ]
        return any(bool(np.any(np.abs(np.log(r)) > MAX_LOG_WEIGHT_CHANGE)) for r in ratios)


def _relative_std(
    motion_noise: MotionNoise | None,
    jitter_noise: JitterNoise | None,
    state: SeriesState,
    blocks: slice,
    keeps_constant: bool,
) -> RelativeStd:
    """Return the standard deviation of one part's noise; `keeps_constant`: see `RelativeStd`."""
    rate, variance = state.rate[blocks], np.ones((blocks.stop - blocks.start, 3))
    if motion_noise is not None:
        variance = motion_noise.relative_variance(rate)
    if jitter_noise is not None:
        return jitter_noise.relative_std(rate, state.used[blocks], variance, keeps_constant)
    return RelativeStd(np.ascontiguousarray(np.sqrt(variance).T), keeps_constant)


def _without_jitter(
    series: Sequence[MotionResidual], jitter_noise: JitterNoise
) -> list[MotionResidual]:
    """Return residuals that use only the samples whose jitter is negligible."""
    return [
        replace(each, used=each.used & ~jitter_noise.acts(each.rate_rad_s, each.used))
        for each in series
    ]
