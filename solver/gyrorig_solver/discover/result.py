"""What a search for the causes of a residual concludes.

What to use when: `Findings` is all that is said of one board; `Explained` adds the two fits
it rests on, for pictures and for the calibration.
"""

from dataclasses import dataclass
from typing import Literal

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.estimate.extension import Extension
from gyrorig_solver.estimate.likelihood import Solution
from gyrorig_solver.model.terms.protocol import Part, Term

# adequate: the base model leaves nothing but noise. explained: it did not, the named causes
# account for all of it. unexplained: structure remains that no known cause explains.
DISAGREE_P = 1e-3  # once in a thousand by chance: boards that differ more are said to
Verdict = Literal["adequate", "explained", "unexplained"]


@dataclass(frozen=True, slots=True)
class Value:
    """One fitted value of a cause, SI."""

    name: str  # parameter and part, as in gap.pan
    value: float
    std: float  # inf where the data say nothing of it
    unit: str
    typical: float  # of an ordinary rig


@dataclass(frozen=True, slots=True)
class Rival:
    """Another cause that was fitted in the same place, and by how much it lost."""

    cause: str
    delta_log_likelihood: float  # nats, its best fit's minus the named one's; below 0: worse
    posterior: float  # share of belief among all that were weighed
    reason: str  # why it lost, in words


@dataclass(frozen=True, slots=True)
class Interval:
    """A figure with its 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Gain:
    """What a model is worth on data that it was not fitted to."""

    how: str  # which data those were
    log_likelihood: Interval  # nats, the extended model's minus the base model's
    rms_before: float  # rad/s, of the residual, all axes
    rms_after: float
    turn_error_before_rad: float  # rms over moves of the integrated residual
    turn_error_after_rad: float
    rms_change: Interval  # rad/s, after minus before
    turn_change: Interval | None = None  # rad, after minus before; None: too few moves


@dataclass(frozen=True, slots=True)
class Whose:
    """Whether a cause is the unit's or a board's, where several boards were on the unit."""

    whose: Literal["unit", "board"]
    seen_by: int  # boards whose own data show it
    boards: int  # that were on the unit
    disagreement_p: float | None  # of a unit's: boards differ as much in its size by chance

    @property
    def words(self) -> str:
        """The same for a person."""
        if self.whose == "unit":
            said = f"the unit's: seen by {self.seen_by} of {self.boards} boards"
            agree = self.disagreement_p is None or self.disagreement_p > DISAGREE_P
            return said if agree else f"{said}, which do not agree on its size"
        if self.seen_by == 1:
            if self.boards == 2:
                return "this board's alone: the other does not show it"
            return f"this board's alone: none of the other {self.boards - 1} shows it"
        return f"the board's own: {self.seen_by} of {self.boards} boards have one"


@dataclass(frozen=True, slots=True)
class CalibrationChange:
    """What a cause does to one parameter of the calibration when it is taken in."""

    parameter: str  # scale.z, as the calibration names it
    before: float
    after: float
    std: float  # of the value after
    unit: str

    @property
    def sigma(self) -> float:
        """The change in standard deviations."""
        return abs(self.after - self.before) / self.std if self.std > 0.0 else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class NamedCause:
    """A cause that was found. Where `one_of` is not empty the data cannot tell it from those."""

    term: Term
    where: tuple[str, ...]  # parts that it acts at: x, y, z, pan, tilt; () where it has none
    extension: Extension  # as fitted, to be taken into a calibration
    values: tuple[Value, ...]
    statistic: float  # twice the log likelihood that leaving it out would cost
    degrees_of_freedom: int
    p_value: float  # of its first sight: scans and the catalogue's size counted
    posterior: float
    one_of: tuple[str, ...]  # the other causes of the 95 % set
    rivals: tuple[Rival, ...]
    changes: tuple[CalibrationChange, ...]  # what leaving it out does to the calibration
    gain: Gain | None  # None: too little data to hold any out
    whose: Whose | None = None  # None: there was one board only
    recording: str | None = None  # in which it happened, of several; None: in all of them

    @property
    def cause(self) -> str:
        """Its id in the catalogue."""
        return self.term.cause

    @property
    def part(self) -> Part:
        """The part of the rig that it belongs to."""
        return self.term.part

    @property
    def candidates(self) -> tuple[str, ...]:
        """The stated set, the likeliest first; a sole name is a set of one."""
        return (self.cause, *self.one_of)

    @property
    def sentence(self) -> str:
        """What it means to a person at the rig."""
        said = self.term.sentence(self.extension.values)
        if self.recording is not None:
            said += f", in {self.recording}"
        return said if self.whose is None else f"{said}; {self.whose.words}"

    @property
    def harm_sigma(self) -> float:
        """The largest change that it makes in the calibration, standard deviations."""
        return max((one.sigma for one in self.changes), default=0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Signature:
    """A nameless test: does the residual depend on something?"""

    covariate: str  # id: pan_angle, tilt_angle, speed, time, ...
    words: str  # "on the pan angle"
    statistic: float
    degrees_of_freedom: int
    p_value: float  # all signatures counted
    axis: str | None = None  # sensor axis that shows it most, None: all alike
    evidence: float = 0.0  # nats for a free function of this against none; 0 of scatter


@dataclass(frozen=True, slots=True, eq=False)
class Unexplained:
    """What no cause of the catalogue accounts for."""

    best: Signature
    others: tuple[Signature, ...]  # those that are significant too
    named_share: float  # of the base model's misfit that the named causes explain


@dataclass(frozen=True, slots=True)
class Limit:
    """A cause that was not found: how large it may be unseen, and what that would do."""

    cause: str
    where: str | None
    size: float  # smallest that would have been seen 4 times in 5, SI
    unit: str
    typical: float
    moves: str  # which parameter of the calibration it would move most
    harm_sigma: float  # by how many standard deviations, at that size


@dataclass(frozen=True, slots=True)
class NotTestable:
    """What this recording could not have shown, and what would."""

    cause: str
    where: str | None
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class Findings:
    """All that is said of one board."""

    verdict: Verdict
    causes: tuple[NamedCause, ...]  # the most harmful first
    unexplained: Unexplained | None
    signatures: tuple[Signature, ...]  # of the base model's residual, the strongest first
    absent: tuple[Limit, ...]  # the most harmful first
    not_testable: tuple[NotTestable, ...]
    base_terms: tuple[str, ...]
    base_reduced_chi2: float
    base_whiteness_p: float  # nothing but noise would look so odd this often
    extended_reduced_chi2: float
    gain: Gain | None  # of all named causes together
    changes: tuple[CalibrationChange, ...]  # by all named causes together
    seconds: float  # that the search took
    elsewhere: Gain | None = None  # of all named causes, on a recording that had no part in it

    @property
    def extensions(self) -> tuple[Extension, ...]:
        """The named causes that a fit can follow, as fitted."""
        fitted = (one.extension for one in self.causes if one.term.kind == "effect")
        return tuple(one for one in fitted if one.free.size)


@dataclass(frozen=True, slots=True, eq=False)
class Explained:
    """Findings and the fits they rest on."""

    board: str
    findings: Findings
    solution_base: Solution
    solution_extended: Solution  # the same as the base where no cause was named

    def residuals(self) -> tuple[list[FloatArray], list[FloatArray]]:
        """Return the residuals of all series without and with the named causes, rad/s."""
        return self.solution_base.residuals(), self.solution_extended.residuals()
