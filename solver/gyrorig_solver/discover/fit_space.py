"""A fit whose residual is searched for causes, for any kind of reference.

The search, the checks and the findings are the same code for all references. Each kind of reference
has a subclass of `FitSpace`, which repeats its fit with causes and whitens signals with its noise.
Each intended difference between two kinds is an attribute or a method of this class.

What to use when: `MotionFitSpace` for a board on a pan-tilt unit or at rest, `AttitudeFitSpace` for
reference attitudes.
"""

import weakref
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Self, TypeVar

from gyrorig_solver.data import FloatArray
from gyrorig_solver.discover.calibration_changes import CalibrationValues
from gyrorig_solver.discover.cause_findings import DependenceTest
from gyrorig_solver.discover.exact_fit import FittedCandidate
from gyrorig_solver.estimate import (
    MAX_EVALUATIONS,
    Convergence,
    FittedTerm,
    NuisanceProjector,
    ObservabilityAnalysis,
    SignalCount,
)
from gyrorig_solver.model import Term, term_label

# Whitened signals of a candidate's fit that take as long as one evaluation of the likelihood with
# its derivatives; measured.
SIGNALS_PER_EVALUATION = 100
Projector = TypeVar("Projector", bound=NuisanceProjector)


@dataclass(frozen=True, slots=True, eq=False)
class NoiseAlternative:
    """A cause that is significant with typical noise levels only; a bias walk may explain it."""

    candidate: FittedCandidate
    effective_trials: float
    likelihood_gain_nats: float  # by the cause, with noise levels fitted with and without it
    log_evidence: float  # of the cause with typical bias noise, minus a random walk without it


@dataclass(slots=True)
class SearchEffort:
    """The effort of the fits of a search; common to all fits that start from one fit."""

    samples: int = 0  # of all recordings, which one evaluation of the likelihood uses
    refit_evaluations: int = 0  # of the likelihood
    signal_count: SignalCount = field(default_factory=SignalCount)  # of fits of candidates
    _latest: "weakref.ref[FitSpace] | None" = None

    @property
    def evaluations(self) -> int:
        """The evaluations of the likelihood that take as long as all fits so far."""
        return self.refit_evaluations + self.signal_count.signals // SIGNALS_PER_EVALUATION

    def count(self, convergence: Convergence) -> None:
        """Count the evaluations of all rounds of a refit."""
        self.refit_evaluations += convergence.total_evaluations

    def count_signals(self, projector: Projector) -> Projector:
        """Count a projector as one evaluation, and from now on its signals; return it."""
        self.refit_evaluations += 1
        projector.signal_count = self.signal_count
        return projector

    def add(self, space: "FitSpace") -> None:
        """Count a refit, and free the caches of the previous one.

        A search keeps many fits, and the caches of a fit take about 3 kB per sample. The next
        projector is usually that of the latest fit.
        """
        self.count(space.convergence)
        previous = None if self._latest is None else self._latest()
        if previous is not None:
            previous.release_caches()
        self._latest = weakref.ref(space)


class FitSpace(ABC):
    """A fit and the causes in it. It is immutable: a refit returns another fit."""

    # True if the noise of the reference is unknown: then significance is not enough for a name.
    needs_held_out_gain: bool = False
    terms: Mapping[str, Term]  # all causes by id, testable or not
    base_terms: tuple[str, ...]  # the terms of the base model
    recording_names: tuple[str, ...]
    offset_recording: int  # the recording whose time offset the calibration states
    duration_s: float  # of all recordings
    fitted_terms: tuple[FittedTerm, ...]
    convergence: Convergence
    observability: ObservabilityAnalysis  # of G, (b, tau), and at the end the causes' values
    effort: SearchEffort
    outliers: int = 0  # samples rejected as outliers of this model
    has_typical_noise: bool = True  # noise levels of a typical part, which hide no cause

    @property
    def labels(self) -> frozenset[str]:
        """The labels of the causes in the fit."""
        return frozenset(term_label(fitted_term.term) for fitted_term in self.fitted_terms)

    @property
    def free_causes(self) -> list[int]:
        """The indices of the causes with fitted values; the others belong to the base model."""
        return [k for k, term in enumerate(self.fitted_terms) if term.free_indices.size]

    def terms_without(self, *dropped: int) -> list[FittedTerm]:
        """Return the causes of the fit except some, for a refit; `dropped`: their indices."""
        return [term for k, term in enumerate(self.fitted_terms) if k not in dropped]

    @abstractmethod
    def projector(self, typical: bool = False) -> NuisanceProjector:
        """Return the nuisance projector at the fit, with fitted or typical noise levels."""

    @abstractmethod
    def projector_without(self, *dropped: int) -> NuisanceProjector:
        """Return the projector without some causes, with their effects added to the residual."""

    @abstractmethod
    def refit(
        self, fitted_terms: Sequence[FittedTerm], max_evaluations: int = MAX_EVALUATIONS
    ) -> Self:
        """Return the fit with these causes, each with good start values."""

    @abstractmethod
    def negative_log_likelihood(self, noise_of: Self) -> float:
        """Return the negative log-likelihood, nats, at the typical noise levels of another fit."""

    @abstractmethod
    def log_likelihoods(self, models: Sequence[Self]) -> list[float]:
        """Return the log-likelihoods at the noise of this fit, on the data that all models use."""

    @abstractmethod
    def reduced_chi2(self) -> float:
        """Return the reduced chi-square of the residual."""

    @abstractmethod
    def calibration(self) -> CalibrationValues:
        """Return the calibration parameters of the fit."""

    @abstractmethod
    def parameter_shift(self, other: Self) -> FloatArray:
        """Return the change of G and each (b, tau) from this fit to another one, (board,).

        Only the part that the calibration states is necessary; the rest can be zero.
        """

    @abstractmethod
    def dependence_tests(self, projector: NuisanceProjector) -> list[DependenceTest]:
        """Test the residual for smooth functions; `projector`: at the fit, with fitted noise."""

    def changes_law(self, term: Term) -> bool:
        """Return whether a cause changes the motion law, so that its gain needs a separate fit."""
        del term
        return False

    def release_caches(self) -> None:  # noqa: B027 - nothing to free by default
        """Free the caches, which are computed again when needed."""

    def confirm(self) -> Self:
        """Return the fit, continued if new derivatives would change its values."""
        return self

    def refit_gain(self) -> Self:
        """Return the fit with its gain searched again if a cause hides rates from it."""
        return self

    def noise_alternative(
        self, candidate: FittedCandidate, trials: float, extended: Self, tests: int
    ) -> NoiseAlternative | None:
        """Return a candidate that a random walk of the bias may explain; None if it is confirmed.

        Args:
            candidate: as found with typical noise levels.
            trials: the effective number of its templates.
            extended: the fit with the candidate.
            tests: how many share the false alarms.
        """
        del candidate, trials, extended, tests
        return None


Space = TypeVar("Space", bound=FitSpace)
