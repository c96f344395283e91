"""The weights of a recording whose noise is larger in motion.

What to use when: `MotionWeights.of` for an estimate of the noise in motion; `updated` for an
estimate from the residuals of a fit.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate.noise.motion_noise import (
    MotionNoise,
    MotionResidual,
    estimate_motion_noise,
)
from gyrorig_solver.estimate.noise.noise_model import NoiseModel
from gyrorig_solver.estimate.noise.relative_std import MAX_LOG_WEIGHT_CHANGE, RelativeStd
from gyrorig_solver.estimate.series_state import SeriesState


@dataclass(frozen=True, slots=True, eq=False)
class MotionWeights:
    """The noise in motion of a recording, and the motion at which it was estimated."""

    motion_noise: MotionNoise | None = None  # None: the noise is the same in motion
    relative_stds: dict[tuple[int, int], RelativeStd] = field(default_factory=dict)

    @classmethod
    def of(cls, motion_noise: MotionNoise | None, states: Sequence[SeriesState]) -> Self:
        """Return the weights at the current motion of all series."""
        relative_stds: dict[tuple[int, int], RelativeStd] = {}
        if motion_noise is None:
            return cls()
        for series_index, state in enumerate(states):
            parts = state.series.part_slices()
            for blocks in parts:
                variance = motion_noise.relative_variance(state.rate[blocks])
                relative_stds[series_index, blocks.start] = RelativeStd(
                    np.ascontiguousarray(np.sqrt(variance).T), keeps_constant=len(parts) > 1
                )
        return cls(motion_noise, relative_stds)

    def relative_std(self, series_index: int, blocks: slice) -> RelativeStd | None:
        """Return the noise of a part relative to that at rest; None: the same at all times."""
        return self.relative_stds.get((series_index, blocks.start))

    def relative_variances(self, states: Sequence[SeriesState]) -> list[FloatArray | None]:
        """Return the variance of the noise relative to that at rest, (n, 3) each; None: 1."""
        if self.motion_noise is None:
            return [None] * len(states)
        return [
            np.concatenate(
                [
                    self.relative_stds[series_index, blocks.start].values.T ** 2
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
        self, states: Sequence[SeriesState], residuals: Sequence[FloatArray], noise: NoiseModel
    ) -> "MotionWeights":
        """Return the weights from residuals, (n, 3) each; the same object if nothing changed."""
        estimate = estimate_motion_noise(
            [
                MotionResidual(residual, state.rate, state.used, state.series.part_slices())
                for state, residual in zip(states, residuals, strict=True)
            ],
            noise,
        )
        return MotionWeights.of(estimate, states) if self._is_changed_by(estimate, states) else self

    def _is_changed_by(
        self, motion_noise: MotionNoise | None, states: Sequence[SeriesState]
    ) -> bool:
        """Return whether another noise in motion gives other weights."""
        previous = self.motion_noise
        if motion_noise is None or previous is None:
            return motion_noise is not previous
        ratios = [
            motion_noise.relative_variance(state.rate) / previous.relative_variance(state.rate)
            for state in states
        ]
        return any(bool(np.any(np.abs(np.log(r)) > MAX_LOG_WEIGHT_CHANGE)) for r in ratios)
