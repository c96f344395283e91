"""Result types of a search for the causes of a residual.

What to use when: `CauseFindings` for the findings of one board; `FitExplanation` adds the two
fits, for figures and for the calibration.
"""

from dataclasses import dataclass
from typing import Literal

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate import ConvergedFit, FittedTerm
from gyrorig_solver.model import Part, Term

MIN_AGREEMENT_P = 1e-3  # boards with a smaller p-value are reported to disagree
# adequate: the residual of the base model is noise. explained: the named causes explain the rest
# of that residual. unexplained: a part of the residual is left that no known cause explains.
Verdict = Literal["adequate", "explained", "unexplained"]


@dataclass(frozen=True, slots=True)
class FittedValue:
    """One fitted parameter value of a cause, SI units."""

    name: str  # parameter and part, as in gap.pan
    value: float
    std: float  # inf if the data do not determine the value
    unit: str
    typical: float  # size on an ordinary rig


@dataclass(frozen=True, slots=True)
class RivalCause:
    """A rejected cause with its log-likelihood difference from the named cause."""

    cause: str
    delta_log_likelihood: float  # nats, best fit minus that of the named cause; below 0: worse
    posterior: float  # posterior probability among all compared causes
    reason: str  # why it was rejected, as text


@dataclass(frozen=True, slots=True)
class ConfidenceInterval:
    """A value with its 95 % confidence interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class HeldOutGain:
    """The gain of a model on held-out data."""

    how: str  # which data were held out, as text
    log_likelihood: ConfidenceInterval  # nats, extended model minus base model
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
    detected_by: int  # number of boards whose own data show the cause
    board_count: int  # number of boards on the unit
    disagreement_p: float | None  # p-value of the boards having one size; for a cause of the unit

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

    parameter: str  # as the calibration names it, for example scale.z
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
    """An identified cause; the data cannot distinguish it from the causes in `one_of`."""

    term: Term
    where: tuple[str, ...]  # parts on which it acts: x, y, z, pan, tilt; () if it has no parts
    extension: FittedTerm  # as fitted, for use in a calibration
    values: tuple[FittedValue, ...]
    statistic: float  # twice the log-likelihood that the fit loses without the cause
    degrees_of_freedom: int
    p_value: float  # of its detection, with all scanned templates and tests counted
    posterior: float
    one_of: tuple[str, ...]  # the other causes of the 95 % set
    rivals: tuple[RivalCause, ...]
    changes: tuple[CalibrationChange, ...]  # of the calibration if the cause is left out
    gain: HeldOutGain | None  # None: too few data to hold any out
    attribution: Attribution | None = None  # None: there was one board only
    recording: str | None = None  # the recording in which it acts; None: all of them

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
        """The credible set, the most probable cause first."""
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


@dataclass(frozen=True, slots=True)
class SignificanceTest:
    """A statistic that is chi-squared in noise, with its p-value."""

    statistic: float
    degrees_of_freedom: int
    p_value: float

    @property
    def excess(self) -> float:
        """The statistic minus its mean in noise."""
        return self.statistic - self.degrees_of_freedom

    def on(self, covariate: str, description: str, tests: int = 1) -> "DependenceTest":
        """Return the test as that of a covariate; `tests`: how many share the false alarms."""
        p_value = min(1.0, self.p_value * tests)
        return DependenceTest(
            covariate, description, self.statistic, self.degrees_of_freedom, p_value
        )


@dataclass(frozen=True, slots=True, eq=False)
class DependenceTest:
    """A test of whether the residual depends on a covariate, without naming a cause."""

    covariate: str  # id: pan_angle, tilt_angle, speed, time, ...
    description: str  # for example "on the pan angle"
    statistic: float
    degrees_of_freedom: int
    p_value: float  # with all tests counted
    axis: str | None = None  # sensor axis that shows it most; None: no such axis
    log_evidence: float = 0.0  # nats, smooth function against none; 0 for a test of the variance
    recording_index: int | None = None  # the recording that was tested; None: all of them

    @property
    def excess(self) -> float:
        """The statistic minus its mean in noise."""
        return self.statistic - self.degrees_of_freedom

    @property
    def key(self) -> tuple[str, int | None]:
        """The covariate and the recording; several tests can have the same."""
        return self.covariate, self.recording_index


@dataclass(frozen=True, slots=True, eq=False)
class UnexplainedResidual:
    """The part of the residual that no cause of the catalogue explains."""

    leading: DependenceTest
    others: tuple[DependenceTest, ...]  # the other significant tests
    named_share: float  # share of the misfit of the base model that the named causes explain


@dataclass(frozen=True, slots=True)
class DetectionLimit:
    """The minimum detectable size of a cause that was not found, and the bias at that size."""

    cause: str
    where: str | None
    size: float  # smallest size that the test detects with a power of 0.8, SI
    unit: str
    typical: float
    biased_parameter: str = ""  # the calibration parameter that the cause would bias most
    parameter_bias_sigma: float = 0.0  # that bias at this size, in standard uncertainties


@dataclass(frozen=True, slots=True)
class UntestableCause:
    """A cause that these recordings cannot test, with the reason or the motion that it needs."""

    cause: str
    where: str | None
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class CauseFindings:
    """All findings of the search for one board."""

    verdict: Verdict
    causes: tuple[NamedCause, ...]  # the most harmful first
    unexplained: UnexplainedResidual | None
    # Of the base model's residual, the most significant first.
    dependence_tests: tuple[DependenceTest, ...]
    detection_limits: tuple[DetectionLimit, ...]  # the most harmful first
    untestable: tuple[UntestableCause, ...]
    base_terms: tuple[str, ...]
    base_reduced_chi2: float
    base_whiteness_p: float  # smallest p-value of the tests of the base model's residual
    gain: HeldOutGain | None  # of all named causes together
    changes: tuple[CalibrationChange, ...]  # by all named causes together
    duration_s: float  # of the search
    # Of all named causes, on a recording that was not fitted.
    other_recording_gain: HeldOutGain | None = None

    @property
    def fitted_terms(self) -> tuple[FittedTerm, ...]:
        """The named causes that a fit can contain, as fitted."""
        fitted = (cause.extension for cause in self.causes if cause.term.kind == "effect")
        return tuple(fitted_term for fitted_term in fitted if fitted_term.free_indices.size)


@dataclass(frozen=True, slots=True, eq=False)
class FitExplanation:
    """Findings, with the fits without and with the named causes."""

    board: str
    findings: CauseFindings
    solution_base: ConvergedFit
    solution_extended: ConvergedFit  # equal to the base if no cause was named
    remarks: tuple[str, ...] = ()  # on candidates whose fit did not converge

    def residuals(self) -> tuple[list[FloatArray], list[FloatArray]]:
        """Return the residuals of all series without and with the named causes, rad/s."""
        return self.solution_base.residuals(), self.solution_extended.residuals()
