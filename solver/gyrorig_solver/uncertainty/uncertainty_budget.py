"""Uncertainty budget of a fit: the contributions of causes that the fit has not identified."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.discover import (
    CALIBRATION_PARAMETERS,
    AttitudeFitSpace,
    CalibrationValues,
)
from gyrorig_solver.estimate import (
    GAIN_PARAMETERS,
    SESSION_PARAMETERS,
    ConvergedFit,
    NuisanceProjector,
    ScoreStatistics,
    join_signals,
)
from gyrorig_solver.estimate.corrected_fit import FitCorrection
from gyrorig_solver.model import Term, recording_index_of
from gyrorig_solver.uncertainty.fit_linearisation import FitLinearisation, linearise_fit
from gyrorig_solver.uncertainty.marginal_covariance import MarginalCauses
from gyrorig_solver.uncertainty.mixture_interval import (
    ErrorMixture,
    UncertainSizes,
    error_mixture,
)
from gyrorig_solver.uncertainty.prior_effects import (
    UnidentifiedCause,
    unidentified_causes,
    whitened_effects,
)
from gyrorig_solver.uncertainty.uncertainty_settings import UncertaintySettings, default_settings
from gyrorig_solver.uncertainty.unit_marginals import UnitMarginals, size_prior, unit_information
from gyrorig_solver.uncertainty.unit_values import (
    UnitInformation,
    UnitPosterior,
    unit_value_names,
)

MAX_JOINT_VALUES = 40_000_000  # of effects in memory at a time, 320 MB


@dataclass(frozen=True, slots=True, eq=False)
class BudgetEntry:
    """Contribution of one cause at one place to each parameter, SI."""

    term: Term
    place: str | None
    std: FloatArray  # (p,), root of the mean square error that would vanish without the cause

    @property
    def cause(self) -> str:
        """The id of the cause."""
        return self.term.cause

    @property
    def remedy(self) -> str:
        """The motion or measurement that reduces the contribution."""
        return self.term.excitation


@dataclass(frozen=True, slots=True, eq=False)
class OtherEntry:
    """Contribution to each parameter that is not from a cause of the catalogue, SI."""

    cause: str  # the id in the budget
    std: FloatArray  # (p,)
    remedy: str
    place: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class UncertaintyBudget:
    """The type B uncertainty of the parameters `CALIBRATION_PARAMETERS`, SI."""

    covariance: FloatArray  # (p, p), of the causes given the data
    # (p,), of the stated values, from causes as far as the data show them
    expected_error: FloatArray
    entries: tuple[BudgetEntry | OtherEntry, ...]
    settings: UncertaintySettings
    corrections: tuple[FitCorrection, ...] = ()  # of each recording, by the unit's posterior
    unit_information: UnitInformation | None = None  # of the recordings on the unit's sizes
    mixture: ErrorMixture | None = None  # of the errors by causes; None if all are normal

    @property
    def std(self) -> FloatArray:
        """The type B standard uncertainty of each parameter, (p,).

        The expected error is not corrected in the stated values, therefore its square counts.
        """
        return np.sqrt(np.clip(np.diag(self.covariance), 0.0, None) + self.expected_error**2)

    def widened(self, entry: OtherEntry) -> "UncertaintyBudget":
        """Return the budget with one more contribution that the others do not contain."""
        mixture = self.mixture
        if mixture is not None:
            mixture = replace(mixture, variance=mixture.variance + entry.std**2)
        return replace(
            self,
            covariance=self.covariance + np.diag(entry.std**2),
            entries=(*self.entries, entry),
            mixture=mixture,
        )

    def expanded_uncertainty(self, noise_std: FloatArray, probability: float) -> FloatArray:
        """Return U of each parameter, (p,): stated value ± U contains the true value.

        Args:
            noise_std: type A standard uncertainty, (p,); NaN gives NaN.
            probability: of the interval.
        """
        mixture = self.mixture
        if mixture is None:
            mixture = ErrorMixture.normal(self.expected_error, np.diag(self.covariance))
        return mixture.expanded_uncertainty(noise_std, probability)


def assess_uncertainty(
    solution: ConvergedFit,
    settings: UncertaintySettings | None = None,
    projector: NuisanceProjector | None = None,
    unit_prior: UnitPosterior | None = None,
) -> UncertaintyBudget:
    """Return the uncertainty that the causes a fit has not identified add to it.

    Args:
        solution: the fit, with the causes that were identified.
        settings: prior sizes; by default the shipped ones.
        projector: at this fit, if there is one already.
        unit_prior: what other recordings have shown of the unit. With it, the budget is that of the
            corrected values; see `corrections`.
    """
    settings = default_settings() if settings is None else settings
    projector = NuisanceProjector.at_fit(solution) if projector is None else projector
    causes = unidentified_causes(projector, solution.fitted_terms, settings)
    budget = _assess_causes(solution, causes, settings, projector, unit_prior)
    return _with_offset_ambiguity(budget, solution)


def assess_space(
    space: AttitudeFitSpace, settings: UncertaintySettings | None = None
) -> UncertaintyBudget:
    """Return what the unidentified causes add to the uncertainty of a fit to reference attitudes.

    Args:
        space: the fit, with the causes that were identified.
        settings: prior sizes; by default the shipped ones. The causes of a unit do not count.
    """
    settings = default_settings() if settings is None else settings
    size, projector = len(CALIBRATION_PARAMETERS), space.projector()
    causes = unidentified_causes(projector, space.fitted_terms, settings, space.terms)
    if not causes:
        return UncertaintyBudget(np.zeros((size, size)), np.zeros(size), (), settings)
    statistics = _joint_statistics(projector, causes)
    calibration = space.calibration()
    return _budget_by_data(calibration, statistics, causes, settings)


def _assess_causes(
    solution: ConvergedFit,
    causes: Sequence[UnidentifiedCause],
    settings: UncertaintySettings,
    projector: NuisanceProjector,
    unit_prior: UnitPosterior | None,
) -> UncertaintyBudget:
    """Return the uncertainty that the causes a fit has not identified add to it."""
    size = len(CALIBRATION_PARAMETERS)
    if not causes:
        return UncertaintyBudget(np.zeros((size, size)), np.zeros(size), (), settings)
    statistics = _joint_statistics(projector, causes)
    fits = linearise_fit(solution, settings, causes, statistics)
    information = unit_information(fits[-1], len(unit_value_names()))
    calibration = CalibrationValues.of(solution)
    if unit_prior is not None:
        marginals = [UnitMarginals.of(fit, unit_prior) for fit in fits]
        mixture = _corrected_mixture(calibration, marginals[-1], fits[-1], unit_prior, causes)
        return _corrected_budget(calibration, marginals, causes, settings, information, mixture)
    budget = _budget_by_data(calibration, statistics, causes, settings, fits[-1])
    return replace(budget, unit_information=information)


def _budget_by_data(
    calibration: CalibrationValues,
    statistics: ScoreStatistics,
    causes: Sequence[UnidentifiedCause],
    settings: UncertaintySettings,
    fit: FitLinearisation | None = None,
) -> UncertaintyBudget:
    """Return the budget of values that are not corrected by the unit's posterior.

    Args:
        calibration: the stated values.
        statistics: of the causes at the fit.
        causes: those that were not identified.
        settings: prior sizes.
        fit: the last one of the linearised fits; without it, `statistics` has the information of
            the data.
    """
    influence = np.stack([calibration.propagate(absorbed) for absorbed in statistics.absorbed])
    data = statistics if fit is None else fit
    marginal = MarginalCauses.of(data.information, data.score, influence)
    return UncertaintyBudget(
        covariance=marginal.parameter_covariance,
        expected_error=marginal.expected_error,
        entries=tuple(_entries(causes, marginal)),
        settings=settings,
        mixture=_mixture(data.information, data.score, influence, causes),
    )


def _with_offset_ambiguity(budget: UncertaintyBudget, solution: ConvergedFit) -> UncertaintyBudget:
    """Add the ambiguity of the stated time offset that identified causes leave."""
    covariance, entries = budget.covariance.copy(), list(budget.entries)
    index = CALIBRATION_PARAMETERS.index("time_offset")
    series = solution.sessions[solution.offset_recording].series
    duration_s = float(series[-1].time_s[-1] - series[0].time_s[0])
    for fitted_term in solution.fitted_terms:
        ambiguity_s = fitted_term.term.time_offset_ambiguity_s(fitted_term.values, duration_s)
        is_stated = recording_index_of(fitted_term.term) in (None, solution.offset_recording)
        if ambiguity_s > 0.0 and is_stated:
            std = np.zeros(len(CALIBRATION_PARAMETERS))
            std[index] = ambiguity_s
            covariance[index, index] += ambiguity_s**2
            entries.append(BudgetEntry(fitted_term.term, None, std))
    mixture = budget.mixture
    if mixture is not None:
        added = np.diag(covariance) - np.diag(budget.covariance)
        mixture = replace(mixture, variance=mixture.variance + added)
    return replace(budget, covariance=covariance, entries=tuple(entries), mixture=mixture)


def _mixture(
    information: FloatArray,
    score: FloatArray,
    influence: FloatArray,
    causes: Sequence[UnidentifiedCause],
) -> ErrorMixture:
    """Return the distribution of the errors of the fitted values."""
    cause, probability, scale = _presence(causes)
    return error_mixture(
        UncertainSizes(
            information=information * np.outer(scale, scale),
            score=score * scale,
            influence=influence * scale[:, None],
            cause=cause,
            probability=probability,
            prior_covariance=np.eye(len(cause)),
            prior_mean=np.zeros(len(cause)),
        )
    )


def _corrected_mixture(
    calibration: CalibrationValues,
    marginals: UnitMarginals,
    fit: FitLinearisation,
    unit_prior: UnitPosterior,
    causes: Sequence[UnidentifiedCause],
) -> ErrorMixture:
    """Return the distribution of the errors of the values that the unit's posterior has corrected.

    The sizes of the unit are certain: their posterior is normal.
    """
    cause, probability, scale = _presence(causes)
    left_out = len(cause)
    cause = np.append(cause, np.zeros(len(fit.unit_position) - left_out, dtype=np.int64))
    cause[fit.unit_position >= 0] = len(probability)
    scale = np.append(scale, np.ones(len(cause) - left_out))
    scale[fit.unit_position >= 0] = 1.0
    information, score = fit.data_terms()
    prior_covariance, prior_mean = size_prior(fit, unit_prior)
    base = GAIN_PARAMETERS + SESSION_PARAMETERS
    jacobian = calibration.jacobian
    mixture = error_mixture(
        UncertainSizes(
            information=information * np.outer(scale, scale),
            score=score * scale,
            influence=-(jacobian @ marginals.derivative[:base]).T * scale[:, None],
            cause=cause,
            probability=np.append(probability, 1.0),
            prior_covariance=prior_covariance,
            prior_mean=prior_mean,
        )
    )
    by_sizes = marginals.derivative @ marginals.size_covariance @ marginals.derivative.T
    rest = (marginals.total_covariance - marginals.noise_covariance - by_sizes)[:base, :base]
    return ErrorMixture(
        mixture.weight,
        mixture.mean + jacobian @ marginals.applied[:base],
        mixture.variance + np.diag(jacobian @ rest @ jacobian.T),
    )


def _presence(causes: Sequence[UnidentifiedCause]) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return the cause of each signal, each cause's probability, and the signals' scale.

    A signal is in units of the root mean square over absence and presence. Times its scale it is in
    units of the standard deviation if present.
    """
    probability = np.array([cause.prior.probability for cause in causes])
    cause = np.repeat(np.arange(len(causes)), [cause.signal_count for cause in causes])
    return cause, probability, 1.0 / np.sqrt(probability[cause])


def _corrected_budget(
    calibration: CalibrationValues,
    marginals: Sequence[UnitMarginals],
    causes: Sequence[UnidentifiedCause],
    settings: UncertaintySettings,
    information: UnitInformation,
    mixture: ErrorMixture,
) -> UncertaintyBudget:
    """Return the budget of the values that the unit's posterior has corrected."""
    last, base = marginals[-1], GAIN_PARAMETERS + SESSION_PARAMETERS
    jacobian = calibration.jacobian
    added = (last.total_covariance - last.noise_covariance)[:base, :base]
    marginal = MarginalCauses(
        last.size_covariance, last.size_mean, (jacobian @ last.derivative[:base]).T
    )
    return UncertaintyBudget(
        covariance=jacobian @ added @ jacobian.T,
        expected_error=jacobian @ last.expected_error[:base],
        entries=tuple(_entries(causes, marginal)),
        settings=settings,
        corrections=tuple(FitCorrection(m.shift, m.noise_covariance) for m in marginals),
        unit_information=information,
        mixture=mixture,
    )


def _joint_statistics(
    projector: NuisanceProjector, causes: Sequence[UnidentifiedCause]
) -> ScoreStatistics:
    """Return information and score of all causes, with the similarity between causes.

    For a long recording, two batches of effects are in memory at a time, and the effects are
    evaluated again for each pair. A sum over batches without the pairs would give too small an
    uncertainty: causes that resemble each other, such as axes that are not perpendicular and a
    board that slipped, would seem determined.
    """
    max_signals = max(1, MAX_JOINT_VALUES // projector.residual.size)
    if sum(cause.signal_count for cause in causes) <= max_signals:
        return projector.score_statistics(whitened_effects(projector, causes))
    batches = _batches(causes, max(1, max_signals // 2))
    if len(batches) == 1:  # one cause, which needs more memory than the limit
        return projector.score_statistics(whitened_effects(projector, causes))
    stops = np.cumsum([sum(cause.signal_count for cause in batch) for batch in batches])
    rows = [np.arange(a, b) for a, b in zip([0, *stops[:-1]], stops, strict=True)]
    count = int(stops[-1])
    information, score, energy = np.zeros((count, count)), np.zeros(count), np.zeros(count)
    absorbed = np.zeros((count, projector.board_parameters))
    for first in range(len(batches) - 1):
        effects = whitened_effects(projector, batches[first])
        for second in range(first + 1, len(batches)):
            pair = np.concatenate([rows[first], rows[second]])
            other = whitened_effects(projector, batches[second])
            statistics = projector.score_statistics(join_signals([effects, other]))
            information[np.ix_(pair, pair)] = statistics.information
            score[pair], energy[pair] = statistics.score, statistics.energy
            absorbed[pair] = statistics.absorbed
    return ScoreStatistics(information, score, energy, absorbed)


def _batches(
    causes: Sequence[UnidentifiedCause], max_signals: int
) -> list[list[UnidentifiedCause]]:
    """Return the causes in batches of at most `max_signals` signals, or of one cause."""
    batches: list[list[UnidentifiedCause]] = []
    count = 0
    for cause in causes:
        if not batches or count + cause.signal_count > max_signals:
            batches.append([])
            count = 0
        batches[-1].append(cause)
        count += cause.signal_count
    return batches


def _entries(causes: Sequence[UnidentifiedCause], marginal: MarginalCauses) -> list[BudgetEntry]:
    """Return the contribution of each cause at each of its places."""
    keys = [(cause.term, place) for cause in causes for place in cause.places]
    order = dict.fromkeys(keys)
    entries = []
    for key in order:
        group = np.array([k for k, other in enumerate(keys) if other == key], dtype=np.int64)
        entries.append(BudgetEntry(*key, np.sqrt(marginal.mean_square_without(group))))
    return entries
