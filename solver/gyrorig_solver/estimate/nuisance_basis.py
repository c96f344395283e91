"""Whitened Jacobian of a fit, and the prior information about its unknowns.

What to use when: `nuisance_basis` for the space that a fit can absorb; `nuisance_projector` to
remove this space from signals.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.fft import idct
from scipy.sparse import block_diag, csc_array, csr_array

from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.estimate.cascade import fitted_derivatives
from gyrorig_solver.estimate.converged_fit import ConvergedFit
from gyrorig_solver.estimate.executed_motion import law_columns, replace_law_derivatives
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.estimate.linear.gap_fill import gap_fill
from gyrorig_solver.estimate.linear.whitening import PartModel
from gyrorig_solver.estimate.parameter_layout import ParameterLayout
from gyrorig_solver.estimate.series_segment import SeriesSegment
from gyrorig_solver.model import SignalState


@dataclass(frozen=True, slots=True, eq=False)
class NuisancePrior:
    """The prior of all unknowns of a fit: local unknowns, and the others."""

    local: csc_array
    cross: FloatArray
    shared: FloatArray
    local_score: FloatArray
    shared_score: FloatArray
    first_term: int  # position of the causes among the shared unknowns
    board_parameters: int  # number of the board's parameters: G, b, tau, causes
    motion_offset: FloatArray = field(
        default_factory=lambda: np.zeros(0)
    )  # of a motion's unknowns:
    # prior mean minus current value


def nuisance_basis(
    solution: ConvergedFit, segments: Sequence[SeriesSegment], fitted_terms: Sequence[FittedTerm]
) -> tuple[FloatArray, csr_array, NuisancePrior]:
    """Return the whitened derivatives of a fit, and the prior of its unknowns.

    The order is G, each recording's (b, tau), the causes, each reference's shared unknowns.
    """
    layout = ParameterLayout.of([fitted_terms], len(solution.sessions))
    informations = [session.reference.information for session in solution.sessions]
    shared_first = layout.size + np.cumsum([0, *(k.size[1] for k in informations)])
    local_first = np.cumsum([0, *(k.size[0] for k in informations)])
    lengths = [3 * sum(u.size for u in segment.used) for segment in segments]
    starts = np.cumsum([0, *lengths])
    basis = np.zeros((int(shared_first[-1]), int(starts[-1])))
    rows, columns, values = [], [], []
    for segment, start in zip(segments, starts[:-1], strict=True):
        first_shared = int(shared_first[segment.session_index])
        shared_count = segment.models[0].columns.shared.shape[0]
        row_of_signal = np.array(
            [
                *layout.index(segment.session_index),
                *range(first_shared, first_shared + shared_count),
            ]
        )
        parts = [
            _part_derivatives(model, state, solution.gain, fitted_terms)
            for model, state in zip(segment.models, segment.exact_states, strict=True)
        ]
        column = int(start)
        for channel in segment.whiten(parts):
            stop = column + channel.length
            basis[row_of_signal[channel.signal_index], column:stop] = channel.rows
            column = stop
        for entries in _local_derivatives(segment, solution.gain, int(start)):
            rows.append(entries[0] + local_first[segment.session_index])
            columns.append(entries[1])
            values.append(entries[2])
    shape = (int(local_first[-1]), int(starts[-1]))
    triple = (
        np.concatenate(values or [np.zeros(0)]),
        (
            np.concatenate(rows or [np.zeros(0, np.int64)]),
            np.concatenate(columns or [np.zeros(0, np.int64)]),
        ),
    )
    local = csr_array(triple, shape=shape)
    columns_of_law = law_columns(fitted_terms, layout.first_term)
    for k, session in enumerate(solution.sessions):
        profile = columns_of_law.profile(session.reference)
        if profile is not None:
            local_count = informations[k].size[0]
            local_rows = local[int(local_first[k]) : int(local_first[k + 1])]
            shared_rows = basis[int(shared_first[k]) : int(shared_first[k + 1])]
            basis[columns_of_law.parameters] += (
                local_rows.T @ profile.shift[:local_count]
            ).T + profile.shift[local_count:].T @ shared_rows
    return (
        basis,
        local,
        _prior_information(solution, fitted_terms, layout, shared_first, local_first),
    )


def _prior_information(
    solution: ConvergedFit,
    fitted_terms: Sequence[FittedTerm],
    layout: ParameterLayout,
    shared_first: IntArray,
    local_first: IntArray,
) -> NuisancePrior:
    size = int(shared_first[-1])
    shared, cross = np.zeros((size, size)), np.zeros((int(local_first[-1]), size))
    local_score, shared_score = np.zeros(int(local_first[-1])), np.zeros(size)
    # Unobservable parameters keep their prior; otherwise causes along them seem identifiable.
    diagonal = np.arange(layout.size)
    shared[diagonal, diagonal] = layout.prior_std**-2.0
    for fitted_term, block in zip(fitted_terms, layout.term_blocks(), strict=True):
        if fitted_term.other_boards_prior is not None:
            term_slice = slice(block.start, block.start + block.size)
            shared[term_slice, term_slice] += fitted_term.other_boards_prior.information
            shared_score[term_slice] += fitted_term.other_boards_prior.score(
                fitted_term.values[fitted_term.free_indices]
            )
    local_blocks = []
    pull_and_local_count = [
        (fitted_term.reference.prior_offset, fitted_term.reference.information.size[0])
        for fitted_term in solution.sessions
    ]
    motion_offset = np.concatenate(
        [*(p[:m] for p, m in pull_and_local_count), *(p[m:] for p, m in pull_and_local_count)]
    )
    for k, session in enumerate(solution.sessions):
        information = session.reference.information
        pull = information.multiply(session.reference.prior_offset)
        shared_slice = slice(int(shared_first[k]), int(shared_first[k + 1]))
        local_slice = slice(int(local_first[k]), int(local_first[k + 1]))
        local_blocks.append(information.local)
        cross[local_slice, shared_slice], shared[shared_slice, shared_slice] = (
            information.cross,
            information.shared,
        )
        columns = law_columns(fitted_terms, layout.first_term)
        profile = columns.profile(session.reference)
        if profile is not None:
            positions = columns.parameters
            shared[np.ix_(positions, positions)] += profile.information
            shared_score[positions] += profile.score
        local_score[local_slice] = pull[: information.size[0]]
        shared_score[shared_slice] = pull[information.size[0] :]
    nonempty_blocks = [fitted_term for fitted_term in local_blocks if fitted_term.shape[0]]
    local = (
        csc_array(block_diag(nonempty_blocks, format="csc"))
        if nonempty_blocks
        else csc_array((0, 0))
    )
    return NuisancePrior(
        local,
        cross,
        shared,
        local_score,
        shared_score,
        layout.first_term,
        layout.size,
        motion_offset,
    )


def _part_derivatives(
    model: PartModel, state: SignalState, gain: FloatArray, fitted_terms: Sequence[FittedTerm]
) -> FloatArray:
    """Return a part's derivatives by all but local unknowns, sensor frame, (q, n, 3)."""
    cause_derivatives = fitted_derivatives(fitted_terms, state)
    share = None if model.pass_through is None else model.pass_through.at_stage("profile")
    replace_law_derivatives(cause_derivatives, fitted_terms, model.columns.law, gain, share)
    return np.concatenate(
        [model.base_derivatives(gain), cause_derivatives, model.shared_derivatives(gain)]
    )


def _local_derivatives(
    segment: SeriesSegment, gain: FloatArray, start: int
) -> list[tuple[IntArray, IntArray, FloatArray]]:
    """Return rows, columns and values of a segment's local derivatives, whitened."""
    entries = []
    for model in segment.models:
        packed, n = model.columns.packed, model.used.size
        if packed.count:
            std = np.sqrt(segment.noise.dct_variance(n))
            signals = idct(
                model.packed_spectra_at(gain, gap_fill(model.used, segment.noise))
                / std.T[:, None, :],
                axis=-1,
                norm="ortho",
            )
            if model.relative_std is not None:
                signals = signals / model.relative_std.values[:, None]
            for k in range(packed.count):
                a, b = int(packed.first_interval[k]), int(packed.stop_interval[k])
                values = signals[:, packed.row[k], a:b] * packed.scale[k]
                columns = start + np.arange(3)[:, None] * n + np.arange(a, b)
                rows = np.full(values.size, packed.unknown_index[k], dtype=np.int64)
                entries.append((rows, columns.ravel(), values.ravel()))
        start += 3 * n
    return entries
