"""The prediction of one part of a series and its derivatives, with the causes of a fit.

What to use when: `predict_part` for the samples, `build_part_model` for the derivatives.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate.cascade import (
    effect_and_mask,
    fitted_derivatives,
    pass_through_of,
)
from gyrorig_solver.estimate.executed_motion import replace_law_derivatives
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.estimate.linear.whitening import PartModel
from gyrorig_solver.estimate.reference_prediction import PartDerivatives, predict_rate
from gyrorig_solver.estimate.series import Series
from gyrorig_solver.estimate.series_state import FitValues, PredictedPart, SeriesState
from gyrorig_solver.model import SignalState


def predict_part(
    series: Series,
    blocks: slice,
    values: FitValues,
    fitted_terms: Sequence[FittedTerm],
    state: SignalState | None,
) -> PredictedPart:
    """Return the samples of a part and their prediction.

    Args:
        series: one of the recording.
        blocks: of the part.
        values: of the fit.
        fitted_terms: causes of the fit.
        state: exact signal state; None: there are no causes.
    """
    samples = series.samples_of_blocks(blocks)
    predicted = predict_rate(series, blocks, values.reference, values.lag_s)
    usable, effect, timing_sensitive = series.good[samples] & predicted.known, None, None
    sample_effect = None
    if state is not None:
        # A pulse or a low-pass changes the samples at an edge more than their mean.
        sample_state = replace(state, instants_per_block=1)
        sample_effect, mask = effect_and_mask(fitted_terms, sample_state)
        effect = state.block_means(sample_effect)
        timing_sensitive = None if mask is None else series.used_blocks(mask)
    if timing_sensitive is not None:
        usable = usable & ~np.repeat(timing_sensitive, series.samples_per_block)
    measured = series.rate_rad_s(samples)
    return PredictedPart(measured, predicted.rate, usable, effect, sample_effect, timing_sensitive)


def build_part_model(
    series_state: SeriesState,
    blocks: slice,
    columns: PartDerivatives,
    fitted_terms: Sequence[FittedTerm],
    state: SignalState | None,
    gain: FloatArray,
) -> PartModel:
    """Return the block means of a part and its derivatives.

    Args:
        series_state: the current prediction.
        blocks: of the part.
        columns: derivatives by lag and reference.
        fitted_terms: causes of the fit.
        state: exact signal state; None: no value of a cause is fitted.
        gain: G, shape (3, 3).
    """
    cause_derivatives, pass_through = np.zeros((0, blocks.stop - blocks.start, 3)), None
    if state is not None:
        cause_derivatives = fitted_derivatives(fitted_terms, state)
        pass_through = pass_through_of(fitted_terms, state)
    share = None if pass_through is None else pass_through.at_stage("profile")
    replace_law_derivatives(cause_derivatives, fitted_terms, columns.law, gain, share)
    return PartModel(
        rate=series_state.rate[blocks].copy(),
        used=series_state.used[blocks].copy(),
        cause_derivatives=cause_derivatives,
        columns=columns,
        pass_through=pass_through,
    )
