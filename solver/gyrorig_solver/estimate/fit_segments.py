"""The series of a fit with their state and residual, and the likelihood of the fit.

What to use when: `build_segments` for signals in units of the noise; `negative_log_likelihood` to
compare fits at the same noise levels.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate.cascade import CLIPPING_STAGES, effect_of_removing, pass_through_of
from gyrorig_solver.estimate.converged_fit import ConvergedFit
from gyrorig_solver.estimate.executed_motion import reference_cost
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.estimate.linear.whitening import PartModel
from gyrorig_solver.estimate.noise.noise_model import NoiseModel
from gyrorig_solver.estimate.series_segment import SeriesSegment
from gyrorig_solver.model import SignalState


def build_segments(
    solution: ConvergedFit,
    restored_terms: Sequence[FittedTerm] = (),
    noises: Sequence[NoiseModel] | None = None,
) -> list[SeriesSegment]:
    """Return each series of a fit, with its state and residual; arguments as for `at_fit`."""
    active_terms = remaining_terms(solution, restored_terms)
    segments = []
    for session_index, session in enumerate(solution.sessions):
        noise = (noises or solution.noises)[session_index]
        session_residuals = session.residuals(solution.gain)
        parts_of_series: dict[
            int, list[tuple[PartModel, SignalState, SignalState, FloatArray]]
        ] = {}
        for series_index, blocks, fitted_model, state, exact_state in session.iter_derivatives(
            solution.gain
        ):
            residual, model = session_residuals[series_index][blocks].copy(), fitted_model
            if restored_terms:
                restored_effect = effect_of_removing(
                    restored_terms, solution.fitted_terms, exact_state
                )
                residual += np.where(model.used[:, None], restored_effect, 0.0)
            if any(fitted_term.term.stage in CLIPPING_STAGES for fitted_term in restored_terms):
                model = replace(
                    fitted_model, pass_through=pass_through_of(active_terms, exact_state)
                )
            parts_of_series.setdefault(series_index, []).append(
                (model, state, exact_state, residual)
            )
        for parts in parts_of_series.values():
            models, states, exact_states, residuals = zip(*parts, strict=True)
            used = tuple(part_model.used for part_model in models)
            segments.append(
                SeriesSegment(session_index, used, states, exact_states, models, residuals, noise)
            )
    return segments


def negative_log_likelihood(solution: ConvergedFit, noises: Sequence[NoiseModel]) -> float:
    """Return the cost of a fit at given noise levels, with the motion's prior, up to a constant."""
    cost = 0.0
    for segment in build_segments(solution, (), noises):
        for channel in segment.whiten([residual[None] for residual in segment.residuals]):
            cost += 0.5 * float(np.sum(channel.rows**2))
    for session in solution.sessions:
        cost += reference_cost(session.reference)
    return cost


def remaining_terms(
    solution: ConvergedFit, restored_terms: Sequence[FittedTerm]
) -> list[FittedTerm]:
    """Return the causes whose effect stays removed from the residual."""
    return [
        fitted_term
        for fitted_term in solution.fitted_terms
        if all(fitted_term is not restored for restored in restored_terms)
    ]
