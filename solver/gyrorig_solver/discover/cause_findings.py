"""Result types of a search for the causes of a residual.

What to use when: `CauseFindings` for the findings of one board; `FitExplanation` adds the two
fits, for figures and for the calibration.
"""

from dataclasses import dataclass
from typing import Literal

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate import ConvergedFit, FittedTerm
from gyrorig_solver.model import Part, Term

# adequate: the base model leaves nothing but noise. explained: it did not, the named causes
# account for all of it. unexplained: structure remains that no known cause explains.
MIN_AGREEMENT_P = 1e-3  # boards that differ more are reported to disagree
Verdict = Literal["adequate", "explained", "unexplained"]


@dataclass(frozen=True, slots=True)
class FittedValue:
    """One fitted parameter value of a cause, SI units."""

    name: str  # parameter and part, as in gap.pan
    value: float
    std: float  # inf where the data do not determine it
    unit: str
    typical: float  # of an ordinary rig


@dataclass(frozen=True, slots=True)
class RivalCause:
    """A rejected cause with its log-likelihood difference from the named cause."""

    cause: str
    delta_log_likelihood: float  # nats, its best fit's minus the named one's; below 0: worse
    posterior: float  # posterior probability among all compared causes
    reason: str  # why it lost, in words


@dataclass(frozen=True, slots=True)
class ConfidenceInterval:
    """A value with its 95 % confidence interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class HeldOutGain:
    """The gain of a model on held-out data."""

    how: str  # which data those were
    log_likelihood: ConfidenceInterval  # nats, the extended model's minus the base model's
    rms_before: float  # rad/s, of the residual, all axes
    rms_after: float
    turn_error_before_rad: float  # rms over moves of the integrated residual
    turn_error_after_rad: float
    rms_change: ConfidenceInterval  # rad/s, after minus before
    turn_change: ConfidenceInterval | None = None  # rad, after minus before; None: too few moves


@dataclass(frozen=True, slots=True)
class Attribution:
    """Whether a cause belongs to the unit or to one of several boards."""

    owner: Literal["unit", "board"]
    detected_by: int  # boards whose own data show it
    board_count: int  # that were on the unit
    disagreement_p: float | None  # of a unit's: boards differ as much in its size by chance

    @property
    def description(self) -> str:
        """The attribution as text."""
        if self.owner == "unit":
            text = (
                f"this is a cause of the unit, and {self.detected_by} of {self.board_count} boards "
                "show it"
            )
            agree = self.disagreement_p is None or self.disagreement_p > MIN_AGREEMENT_P
            return text if agree else f"{text}, with different sizes"
        if self.detected_by == 1:
            others = (
                "the other board does not show it"
                if self.board_count == 2
                else f"none of the other {self.board_count - 1} boards shows it"
            )
            return f"this is a cause of this board only, because {others}"
        return (
            f"this is a cause of the board, and {self.detected_by} of {self.board_count} boards "
            "have it"
        )


@dataclass(frozen=True, slots=True)
class CalibrationChange:
    """The change of one calibration parameter when a cause is included in the fit."""

    parameter: str  # scale.z, as the calibration names it
    before: float
    after: float
    std: float  # of the value after
    unit: str

    @property
    def sigma(self) -> float:
        """The change in standard uncertainties of the value after."""
        return abs(self.after - self.before) / self.std if self.std > 0.0 else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class NamedCause:
    """An identified cause. If `one_of` is not empty, the data cannot distinguish it from those."""

    term: Term
    where: tuple[str, ...]  # parts that it acts at: x, y, z, pan, tilt; () where it has none
    extension: FittedTerm  # as fitted, to be taken into a calibration
    values: tuple[FittedValue, ...]
    statistic: float  # twice the log likelihood that leaving it out would cost
    degrees_of_freedom: int
    p_value: float  # of its first sight: scans and the catalogue's size counted
    posterior: float
    one_of: tuple[str, ...]  # the other causes of the 95 % set
    rivals: tuple[RivalCause, ...]
    changes: tuple[CalibrationChange, ...]  # what leaving it out does to the calibration
    gain: HeldOutGain | None  # None: too little data to hold any out
    attribution: Attribution | None = None  # None: there was one board only
    recording: str | None = None  # in which it happened, of several; None: in all of them

    @property
    def cause(self) -> str:
        """The cause's id in the catalogue."""
        return self.term.cause

    @property
    def part(self) -> Part:
        """The part of the rig to which the cause belongs."""
        return self.term.part

    @property
    def candidates(self) -> tuple[str, ...]:
        """The credible set, the most probable cause first; a single name is a set of one."""
        return (self.cause, *self.one_of)

    @property
    def sentence(self) -> str:
        """A sentence for the person at the rig."""
        text = self.term.describe(self.extension.values)
        if self.recording is not None:
            text += f", in {self.recording}"
        return text if self.attribution is None else f"{text}; {self.attribution.description}"

    @property
    def parameter_bias_sigma(self) -> float:
        """The largest change of a calibration parameter, in standard uncertainties."""
        return max((change.sigma for change in self.changes), default=0.0)


@dataclass(frozen=True, slots=True, eq=False)
class DependenceTest:
    """A test of whether the residual depends on a covariate, without naming a cause."""

    covariate: str  # id: pan_angle, tilt_angle, speed, time, ...
    description: str  # "on the pan angle"
    statistic: float
    degrees_of_freedom: int
    p_value: float  # all signatures counted
    axis: str | None = None  # sensor axis that shows it most, None: all alike
    log_evidence: float = 0.0  # nats for a free function of this against none; 0 of scatter


@dataclass(frozen=True, slots=True, eq=False)
class UnexplainedResidual:
    """The part of the residual that no cause of the catalogue explains."""

    leading: DependenceTest
    others: tuple[DependenceTest, ...]  # those that are significant too
    named_share: float  # of the base model's misfit that the named causes explain


@dataclass(frozen=True, slots=True)
class DetectionLimit:
    """The minimum detectable size of a cause that was not found, and the bias at that size."""

    cause: str
    where: str | None
    size: float  # smallest that would have been seen 4 times in 5, SI
    unit: str
    typical: float
    biased_parameter: str  # which parameter of the calibration it would move most
    parameter_bias_sigma: float  # by how many standard deviations, at that size


@dataclass(frozen=True, slots=True)
class UntestableCause:
    """A cause that these recordings cannot test, and what would test it."""

    cause: str
    where: str | None
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class CauseFindings:
    """All findings of the search for one board."""

    verdict: Verdict
    causes: tuple[NamedCause, ...]  # the most harmful first
    unexplained: UnexplainedResidual | None
    dependence_tests: tuple[
        DependenceTest, ...
    ]  # of the base model's residual, the strongest first
    detection_limits: tuple[DetectionLimit, ...]  # the most harmful first
    untestable: tuple[UntestableCause, ...]
    base_terms: tuple[str, ...]
    base_reduced_chi2: float
    base_whiteness_p: float  # probability of this result from noise alone
    extended_reduced_chi2: float
    gain: HeldOutGain | None  # of all named causes together
    changes: tuple[CalibrationChange, ...]  # by all named causes together
    duration_s: float  # that the search took
    other_recording_gain: HeldOutGain | None = (
        None  # of all named causes, on a recording that had no part in it
    )

    @property
    def fitted_terms(self) -> tuple[FittedTerm, ...]:
        """The named causes that a fit can include, as fitted."""
        fitted = (cause.extension for cause in self.causes if cause.term.kind == "effect")
        return tuple(fitted_term for fitted_term in fitted if fitted_term.free_indices.size)


@dataclass(frozen=True, slots=True, eq=False)
class FitExplanation:
    """Findings, with the fits without and with the named causes."""

    board: str
    findings: CauseFindings
    solution_base: ConvergedFit
    solution_extended: ConvergedFit  # the same as the base where no cause was named
    remarks: tuple[str, ...] = ()  # on candidates whose fit did not converge

    def residuals(self) -> tuple[list[FloatArray], list[FloatArray]]:
        """Return the residuals of all series without and with the named causes, rad/s."""
        return self.solution_base.residuals(), self.solution_extended.residuals()
