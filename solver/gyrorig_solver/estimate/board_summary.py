"""The result of one board at the end of a fit.

What to use when: `summarize_board` after `trust_region.minimise`.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate.board_fit import BoardFit
from gyrorig_solver.estimate.converged_fit import ConvergedFit, last_with_offset
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.estimate.information import PARAMETER_NAMES, add_parameter_noise
from gyrorig_solver.estimate.noise.rounding import bias_std_by_rounding
from gyrorig_solver.estimate.observability import (
    ObservabilityAnalysis,
    analyse_scaled_observability,
)
from gyrorig_solver.estimate.parameter_layout import (
    GAIN_PARAMETERS,
    eliminate_parameters,
)
from gyrorig_solver.estimate.trust_region import Convergence

TIME_OFFSET = PARAMETER_NAMES.index("time_offset")
BIASES = slice(GAIN_PARAMETERS, GAIN_PARAMETERS + 3)
ROTATION_X_GENERATOR = np.array(
    [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]
)  # d Rx(z)^T / dz


def summarize_board(
    board: BoardFit, information: FloatArray, convergence: Convergence
) -> ConvergedFit:
    """Return the result, with the common shift of each recording and the rounding of its bias.

    Args:
        board: at the end of the iteration.
        information: about the board's parameters, in the order of its layout.
        convergence: how the iteration ended.
    """
    layout = board.layout
    for recording, session in enumerate(board.sessions):
        session.derivatives.release_equations()
        position = int(layout.index(recording)[TIME_OFFSET])
        information = add_parameter_noise(information, position, session.common_std_s)
        biases = layout.index(recording)[BIASES]
        stds_rad_s = bias_std_by_rounding(board.noises[recording])
        for position, std_rad_s in zip(biases.tolist(), stds_rad_s.tolist(), strict=True):
            information = add_parameter_noise(information, position, std_rad_s)
    unit_std = layout.prior_std[layout.index(0)]

    def analyse(recording: int, offset_of: int) -> ObservabilityAnalysis:
        keep = layout.index(recording, offset_recording=offset_of)
        reduced = eliminate_parameters(information, keep, layout.prior_std)
        analysis = analyse_scaled_observability(reduced, unit_std)
        return _add_tilt_zero_variance(analysis, board.fitted_terms, board.gain)

    analyses = tuple(analyse(k, k) for k in range(len(board.sessions)))
    last = len(analyses) - 1
    offset_recording = last_with_offset(analyses)
    return ConvergedFit(
        names=(*PARAMETER_NAMES, *(n for b in layout.term_blocks() for n in b.parameter_names)),
        prior_std=unit_std,
        estimate=np.concatenate(
            [
                board.gain.ravel(),
                board.sessions[last].bias_rad_s,
                [board.sessions[offset_recording].time_offset_s],
                *(
                    fitted_term.values[fitted_term.free_indices]
                    for fitted_term in board.fitted_terms
                ),
            ]
        ),
        observability=(
            analyses[last] if offset_recording == last else analyse(last, offset_recording)
        ),
        sessions=board.sessions,
        fitted_terms=board.fitted_terms,
        session_observability=analyses,
        noises=tuple(board.noises),
        spectra=tuple(board.spectra),
        noise_sources=tuple(board.noise_sources),
        outliers=sum(session.outliers for session in board.sessions),
        convergence=convergence,
    )


def _add_tilt_zero_variance(
    observability: ObservabilityAnalysis, fitted_terms: Sequence[FittedTerm], gain: FloatArray
) -> ObservabilityAnalysis:
    """Add the causes' uncertainty of the tilt zero to the covariance of G.

    A stage that is z higher than commanded rotates the rate by Rx(z)^T: see `tilt_zero`.
    """
    tilt_zero_std = [
        fitted_term.term.tilt_zero_std_rad(fitted_term.values) for fitted_term in fitted_terms
    ]
    std = float(np.linalg.norm(tilt_zero_std))
    if std == 0.0:
        return observability
    gain_change = np.zeros(observability.covariance.shape[0])
    gain_change[:GAIN_PARAMETERS] = std * (gain @ ROTATION_X_GENERATOR).ravel()
    return replace(
        observability, covariance=observability.covariance + np.outer(gain_change, gain_change)
    )
