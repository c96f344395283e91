"""Derivatives of a recording's samples and the normal equations from them, for several iterations.

What to use when: `DerivativeCache.part_model` for the derivatives of one part of a series,
`equations_for` before the normal equations of a recording are computed.
"""

from collections.abc import Sequence
from dataclasses import replace

from gyrorig_solver.estimate.executed_motion import executed_motion
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.estimate.linear.normal_equations import (
    CachedNormalEquations,
    NormalEquations,
)
from gyrorig_solver.estimate.linear.whitening import PartModel, WhitenedPart
from gyrorig_solver.estimate.noise.noise_model import NoiseModel
from gyrorig_solver.estimate.noise.relative_std import RelativeStd
from gyrorig_solver.estimate.part_model import build_part_model
from gyrorig_solver.estimate.reference_prediction import predict_derivatives
from gyrorig_solver.estimate.series import PART_BLOCKS
from gyrorig_solver.estimate.series_state import FitValues, SeriesState
from gyrorig_solver.estimate.signal_state_cache import SignalStateCache


class DerivativeCache:
    """Computes derivatives and normal equations, and keeps them until they are discarded."""

    def __init__(self) -> None:
        """Start without derivatives."""
        self.are_current = True  # whether they belong to the current values of the fit
        self.equation_noise: NoiseModel | None = None  # of the last normal equations
        self._is_fine = False
        self._models: dict[tuple[int, int], PartModel] = {}
        self._equations: CachedNormalEquations | None = None

    def copy(self, with_derivatives: bool) -> "DerivativeCache":
        """Return a cache for another fit.

        `with_derivatives`: keep the derivatives, for a step that may be rejected.
        """
        other = DerivativeCache()
        other.equation_noise, other._is_fine = self.equation_noise, self._is_fine
        if with_derivatives:
            other.are_current = False
            other._models, other._equations = self._models.copy(), self._equations
        return other

    def discard(self) -> None:
        """Discard the derivatives; the next normal equations need new ones."""
        self.release()
        self.are_current = True

    def refine(self) -> bool:
        """Use the fine grid from now on; return False if it is used already."""
        if self._is_fine:
            return False
        self._is_fine = True
        self.discard()
        return True

    def release(self) -> None:
        """Free the derivatives and equations, which can be computed again."""
        self._models.clear()
        self._equations = None

    def release_equations(self) -> None:
        """Free the normal equations, which only further iterations would need."""
        self._equations = None

    def part_model(
        self,
        series_state: SeriesState,
        blocks: slice,
        values: FitValues,
        fitted_terms: Sequence[FittedTerm],
        signal_states: SignalStateCache,
        relative_std: RelativeStd | None,
    ) -> PartModel:
        """Return the derivatives of one part of a series.

        Args:
            series_state: the current prediction.
            blocks: of the part.
            values: of the fit.
            fitted_terms: causes of the fit.
            signal_states: of the recording.
            relative_std: of the noise; None: the same at all times.
        """
        series, key = series_state.series, (id(series_state.series), blocks.start)
        if key in self._models:
            model = self._models[key]
            if model.relative_std is not relative_std:
                model = self._models[key] = replace(model, relative_std=relative_std)
            return model
        is_fitted = any(fitted_term.free_indices.size for fitted_term in fitted_terms)
        state = signal_states.state(series, blocks, values, exact=True) if is_fitted else None
        motion = executed_motion(values.reference)
        columns = predict_derivatives(series, blocks, motion, values.lag_s, self._is_fine)
        model = build_part_model(series_state, blocks, columns, fitted_terms, state, values.gain)
        model = replace(model, relative_std=relative_std)
        # The state of a part of a long series is computed again if needed, to save memory.
        if series.block_count <= 2 * PART_BLOCKS:
            self._models[key] = model
        return model

    def equations_for(
        self, noise: NoiseModel, relative_std: RelativeStd | None
    ) -> CachedNormalEquations | None:
        """Return earlier equations that have the same weights within a few percent, or None.

        Args:
            noise: at rest.
            relative_std: of the noise of the first part; None: the same at all times.
        """
        equations = self._equations
        if equations is not None and not equations.is_valid_for(noise, relative_std):
            equations = None
        self.equation_noise = noise if equations is None else equations.noise
        return equations

    def keep_equations(self, part: WhitenedPart, normal: NormalEquations) -> None:
        """Keep the equations of a recording of one part, at the noise of the last request."""
        if self.equation_noise is not None:
            self._equations = CachedNormalEquations(part, normal, self.equation_noise)
