"""Score tests with all nuisance parameters projected out.

All signals of a board's recordings are concatenated and whitened. The projector removes the part
that gain, biases, time offsets, the references' unknowns and the fitted causes can absorb, each
within its prior. The remaining energy of a signal is the information that it adds; its product with
the residual is its score.

What to use when: `NuisanceProjector.at_fit` for a fit; `whiten` for signals, `score_statistics` for
their information and score.

Source: score (Lagrange multiplier) test with nuisances eliminated; Rao, Linear Statistical
Inference, 6e.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.fft import dct, idct
from scipy.sparse import csr_array

from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.estimate.cascade import (
    TermCascade,
    effect_of_removing,
)
from gyrorig_solver.estimate.converged_fit import ConvergedFit
from gyrorig_solver.estimate.executed_motion import law_columns
from gyrorig_solver.estimate.fit_segments import build_segments, remaining_terms
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.estimate.law_effects import LawEffects, LawScale, unit_references
from gyrorig_solver.estimate.linear.gap_fill import gap_fill
from gyrorig_solver.estimate.noise.noise_model import NoiseModel
from gyrorig_solver.estimate.nuisance_basis import NuisancePrior, nuisance_basis
from gyrorig_solver.estimate.nuisance_space import (
    NuisanceSpace,
    OtherData,
    ReducedModel,
    ScoreStatistics,
)
from gyrorig_solver.estimate.segment_signals import SegmentSignals
from gyrorig_solver.estimate.series_segment import SeriesSegment
from gyrorig_solver.model import SignalState, Term
from gyrorig_solver.reference import LAW_QUANTITIES, LAW_VALUES


@dataclass(frozen=True, slots=True, eq=False)
class LawStatistics:
    """Score statistics of values of the motion law."""

    together: ScoreStatistics  # of samples and replies, to first order
    replies: ScoreStatistics  # of the replies alone
    scale: LawScale

    def subset(self, values: IntArray) -> Self:
        """Return the statistics of some values; `values`: their positions, shape (k,)."""
        return replace(
            self,
            together=self.together.subset(values),
            replies=self.replies.subset(values),
            scale=self.scale.subset(values),
        )


class NuisanceProjector(SegmentSignals, NuisanceSpace):
    """The projection orthogonal to a fit's nuisance space; see the module."""

    def __init__(
        self,
        segments: Sequence[SeriesSegment],
        fitted_terms: Sequence[FittedTerm],
        basis: FloatArray,
        local: csr_array,
        prior: NuisancePrior,
        active_terms: Sequence[FittedTerm] = (),
    ) -> None:
        """Use `at_fit` instead; the effect of `active_terms` is removed from the residual."""
        SegmentSignals.__init__(self, segments, active_terms)
        self.fitted_terms = tuple(fitted_terms)
        residual = self.whiten(
            [[residual[None] for residual in segment.residuals] for segment in segments]
        )
        lengths = [channel.length for channel in residual.channels]
        NuisanceSpace.__init__(self, residual.dense()[0], lengths, basis, local, prior)
        # None: its law differs from that of the residual
        self._solution: ConvergedFit | None = None
        self._law_statistics: LawStatistics | None = None
        self.statistics_by_family: dict[str, ScoreStatistics] = {}

    @classmethod
    def at_fit(
        cls,
        solution: ConvergedFit,
        followed_terms: Sequence[FittedTerm] | None = None,
        restored_terms: Sequence[FittedTerm] = (),
        noises: Sequence[NoiseModel] | None = None,
    ) -> Self:
        """Return the projector at a fit.

        Args:
            solution: the fit, with the state of its sessions.
            followed_terms: causes that belong to the nuisance space; by default those of the fit.
            restored_terms: causes of the fit whose effect is added back to the residual.
            noises: of each recording; by default those of the fit.
        """
        followed = solution.fitted_terms if followed_terms is None else tuple(followed_terms)
        active_terms = remaining_terms(solution, restored_terms)
        segments = build_segments(solution, restored_terms, noises)
        basis, local, prior = nuisance_basis(solution, segments, followed)
        projector = cls(segments, followed, basis, local, prior, active_terms)
        # The moves are those of the fit, so a cause that is added back must not change them.
        if not any(restored.term.law_quantity for restored in restored_terms):
            projector._solution = solution
        return projector

    @classmethod
    def of_effect(
        cls,
        solution: ConvergedFit,
        replaced_term: FittedTerm | None,
        cause: FittedTerm | None,
        noises: Sequence[NoiseModel],
    ) -> Self:
        """Return the projector of a fit whose residual is the effect of one cause, without noise.

        Every unknown is at the mean of its prior. The log-likelihood that another cause gains on
        this residual is the part of the effect that it can explain.

        Args:
            solution: a fit with `replaced_term`; the samples themselves are not used.
            replaced_term: the cause of the fit that is removed; None: no cause.
            cause: the cause whose effect is the residual; None: the residual is zero.
            noises: of each recording.
        """
        replaced_terms = [] if replaced_term is None else [replaced_term]
        others = remaining_terms(solution, replaced_terms)
        segments = [
            replace(segment, residuals=_effect_of(cause, others, segment))
            for segment in build_segments(solution, replaced_terms, noises)
        ]
        basis, local, prior = nuisance_basis(solution, segments, others)
        prior = replace(
            prior,
            local_score=np.zeros_like(prior.local_score),
            shared_score=np.zeros_like(prior.shared_score),
            motion_offset=np.zeros_like(prior.motion_offset),
        )
        return cls(segments, others, basis, local, prior, others)

    def drop_terms(self, removed: Sequence[int]) -> ReducedModel:
        """Return the fit's model without some of its causes; their effect is added back.

        Args:
            removed: numbers of causes among those of this projector.
        """
        rows = np.ones(self._basis.shape[0], dtype=np.bool_)
        first = self._prior.first_term
        for k, fitted_term in enumerate(self.fitted_terms):
            rows[first : first + fitted_term.free_indices.size] = k not in removed
            first += fitted_term.free_indices.size
        if not removed:
            return ReducedModel(np.flatnonzero(rows), self.residual)
        removed_terms = [term for k, term in enumerate(self.fitted_terms) if k in removed]
        direct_terms = [term for term in removed_terms if term.term.law_quantity is None]

        def restored_effect(state: SignalState) -> FloatArray:
            return effect_of_removing(direct_terms, self.fitted_terms, state)[None]

        effect = self.evaluate_signals(restored_effect, exact=True).dense()[0]
        return ReducedModel(
            np.flatnonzero(rows), self.residual + effect + self._law_effect(removed_terms)
        )

    def _law_effect(self, removed_terms: Sequence[FittedTerm]) -> FloatArray:
        """Return the whitened effect of the terms that change the motion law, (all,).

        The derivatives contain the moves, which follow the replies under the other law.
        """
        effect = np.zeros(self.residual.size)
        first = self._prior.first_term
        references = {} if self._solution is None else unit_references(self._solution)
        if not references:
            return effect
        law_scale = LawScale.of(list(references.values()))
        for fitted_term in self.fitted_terms:
            stop = first + fitted_term.free_indices.size
            if fitted_term in removed_terms and fitted_term.term.law_quantity is not None:
                values = fitted_term.values[fitted_term.free_indices]
                at = 2 * LAW_QUANTITIES.index(fitted_term.term.law_quantity)
                scale = law_scale.subset(at + fitted_term.free_indices)
                effect += (scale.effect_shares(values) * values) @ self._basis[first:stop]
            first = stop
        return effect

    def law_statistics(self, term: Term) -> LawStatistics | None:
        """Return the statistics of a cause that changes the motion law, under its law.

        They use the samples, the moves that follow the replies, and the replies themselves. The
        values are pan and tilt.

        Returns:
            None if the cause does not change the law, or the reference has no law.
        """
        if term.law_quantity is None or self._solution is None:
            return None
        if self._law_statistics is None:
            effects = LawEffects.of(self._solution, self.segments)
            if effects is None:
                self._solution = None
                return None
            self._law_statistics = self._statistics_of_law(effects)
        first = 2 * LAW_QUANTITIES.index(term.law_quantity)
        return self._law_statistics.subset(np.array([first, first + 1]))

    def _statistics_of_law(self, effects: LawEffects) -> LawStatistics:
        white = self.whiten(effects.direct).dense()
        first_local, first_shared = 0, self.board_parameters
        for profile in effects.profiles:
            local = profile.local_count
            shared = profile.shift.shape[0] - local
            white += (self._local[first_local : first_local + local].T @ profile.shift[:local]).T
            white += profile.shift[local:].T @ self._basis[first_shared : first_shared + shared]
            first_local, first_shared = first_local + local, first_shared + shared
        information, score = effects.reply_information(), effects.reply_score()
        columns = law_columns(self.fitted_terms, self._prior.first_term)
        fitted = columns.law_values
        cross = np.zeros((self._basis.shape[0], LAW_VALUES))
        cross[columns.parameters] = information[fitted]
        together = self.dense_statistics(white, OtherData(information, cross, score))
        # From the replies alone, the fitted values of the law follow the replies.
        inverse = np.linalg.pinv(information[np.ix_(fitted, fitted)], hermitian=True)
        follow = information[:, fitted] @ inverse
        replies = ScoreStatistics(
            information - follow @ information[fitted],
            score - follow @ score[fitted],
            np.diag(information).copy(),
            np.zeros((LAW_VALUES, self.board_parameters)),
        )
        return LawStatistics(together, replies, effects.scale)

    def weighted_residual(self) -> list[FloatArray]:
        """Return the residual times the inverse noise covariance, (n, 3) per part.

        Its product with an unwhitened signal is the signal's score.
        """
        signals = []
        for segment, model, white in self.split_parts(self.residual):
            std = np.sqrt(segment.noise.dct_variance(model.used.size)).T
            spectrum = dct(white, axis=-1, norm="ortho")
            if model.relative_std is not None:
                spectrum = model.relative_std.divide_adjoint(spectrum)
            weighted = idct(spectrum / std, axis=-1, norm="ortho")
            fill = gap_fill(model.used, segment.noise)
            signals.append((weighted * model.used if fill is None else fill.adjoint(weighted)).T)
        return signals


def _effect_of(
    cause: FittedTerm | None, others: Sequence[FittedTerm], segment: SeriesSegment
) -> tuple[FloatArray, ...]:
    """Return the exact effect of a cause in addition to others, zero where unused, (n, 3) each."""
    if cause is None:
        return tuple(np.zeros_like(residual) for residual in segment.residuals)
    return tuple(
        np.where(
            used[:, None], TermCascade(others, state).joint_effect(cause.term, cause.values), 0.0
        )
        for state, used in zip(segment.exact_states, segment.used, strict=True)
    )
