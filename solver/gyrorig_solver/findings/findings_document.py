"""The findings document, `gyrorig/findings/1`: its schema, to read and to write it.

What to use when: `to_yaml` to write a document, `parse_findings` to read one. An unknown number
is None.
"""

from typing import Any, Literal

import msgspec

from gyrorig_protocol.documents import dump_yaml, parse_result_document

SCHEMA = "gyrorig/findings/1"


class _Document(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base of the document's parts; unknown keys are invalid."""


class InputEntry(_Document, frozen=True):
    """One recording that was searched."""

    name: str
    sha256: str


class BoardEntry(_Document, frozen=True):
    """The board."""

    id: str
    sensor: str


class BaseModelEntry(_Document, frozen=True):
    """The base model's terms and residual."""

    terms: list[str]
    reduced_chi2: float | None
    whiteness_p: float | None


class SizeEntry(_Document, frozen=True):
    """One parameter value of a cause."""

    value: float | None
    std: float | None
    unit: str


class TestStatistics(_Document, frozen=True, omit_defaults=True):
    """The test statistics of a named cause."""

    statistic: float | None
    degrees_of_freedom: int
    p_value: float | None
    seen_as: str
    figure: str | None = None
    posterior: float | None = None


class RivalEntry(_Document, frozen=True, omit_defaults=True):
    """A rejected cause, its log-likelihood difference and the reason."""

    cause: str
    delta_log_likelihood: float | None
    reason: str
    posterior: float | None = None  # probability among all causes that were compared


class GainEntry(_Document, frozen=True, omit_defaults=True):
    """The extended model's gain on held-out data."""

    held_out_log_likelihood: float | None
    residual_rms_before: float | None
    residual_rms_after: float | None
    unit: str = "rad/s"
    interval: list[float | None] | None = None  # of the log likelihood, 95 %
    turn_error_before: float | None = None  # rad, rms over moves
    turn_error_after: float | None = None
    rms_change: list[float | None] | None = None  # rad/s, after minus before, 95 % interval
    turn_change: list[float | None] | None = None  # rad, the same of the turn error
    how: str | None = None


class ChangeEntry(_Document, frozen=True):
    """The change of one calibration parameter when a cause is included."""

    parameter: str
    before: float | None
    after: float | None
    std: float | None
    unit: str

    @property
    def sigma(self) -> float:
        """The change in standard uncertainties; 0 where it is not known."""
        if self.before is None or self.after is None or not self.std:
            return 0.0
        return abs(self.after - self.before) / self.std


class CauseEntry(_Document, frozen=True, omit_defaults=True):
    """One named cause, or the most probable of a set that the data cannot separate."""

    cause: str
    part: str
    where: str
    parameters: dict[str, SizeEntry]
    evidence: TestStatistics
    gain: GainEntry | None
    one_of: list[str] = []  # the others of the set
    rivals: list[RivalEntry] = []
    effect_on_calibration: list[ChangeEntry] = []
    harm_sigma: float | None = None  # largest of those changes, in standard uncertainties
    remedy: str = ""
    recording: str | None = None  # in which it happened; None: in all of them
    occurrence: int = 1  # its number if it happened several times in a recording


class DependenceEntry(_Document, frozen=True):
    """Another covariate on which the residual depends."""

    covariate: str
    statistic: float | None
    p_value: float | None


class UnexplainedEntry(_Document, frozen=True, omit_defaults=True):
    """The part of the residual that no known cause explains."""

    statistic: float | None
    p_value: float | None
    best_covariate: str
    figure: str | None = None
    harm: str = ""  # possible bias of the calibration, as a sentence
    harm_sigma: float | None = None  # the same, in standard deviations
    others: list[DependenceEntry] = []


class UntestableEntry(_Document, frozen=True, omit_defaults=True):
    """A cause that this recording cannot test, and what would test it."""

    cause: str
    reason: str
    where: str | None = None


class DetectableEntry(_Document, frozen=True, omit_defaults=True):
    """The minimum detectable size of a cause, and the bias that it would cause."""

    cause: str
    size: float | None
    unit: str
    where: str | None = None
    typical: float | None = None
    would_move: str | None = None
    by_sigma: float | None = None


class NextPairEntry(_Document, frozen=True):
    """What a proposed program is expected to say about two causes, or about one."""

    causes: list[str]  # one: it is compared with nothing
    expected_log_bayes_factor: float | None  # nats, the smaller of both truths
    probability: float | None  # that the truth becomes the only name


class NextExperimentEntry(_Document, frozen=True, omit_defaults=True):
    """The motion program that separates the causes that are possible."""

    pairs: list[NextPairEntry]
    program: str | None = None  # its file, beside the document; None: no program helps
    seconds: float | None = None  # that it lasts
    longest_s: float | None = None  # that it may last


class RawCheckEntry(_Document, frozen=True):
    """One check of the raw stream, without a model."""

    check: str
    recording: str
    found: bool
    said: str


class FindingsDocument(_Document, frozen=True, kw_only=True, omit_defaults=True):
    """The findings of one board. The keys have this order."""

    schema: Literal["gyrorig/findings/1"] = msgspec.field()
    board: BoardEntry
    created: str
    software: str
    recording: list[InputEntry]
    verdict: Literal["adequate", "explained", "unexplained"]
    base: BaseModelEntry
    causes: list[CauseEntry]
    unexplained: UnexplainedEntry | None = None
    gain: GainEntry | None = None  # of all causes together
    elsewhere: GainEntry | None = None  # of all causes together, on a held-out recording
    effect_on_calibration: list[ChangeEntry] = []  # of all causes together
    not_testable: list[UntestableEntry]
    minimal_detectable: list[DetectableEntry]
    raw: list[RawCheckEntry]
    remarks: list[str] = []
    next_experiment: NextExperimentEntry | None = None  # where sets of causes are stated


def to_plain(document: FindingsDocument) -> dict[str, Any]:
    """Return the document as mappings, lists and scalars, keys in the order of the schema."""
    plain: dict[str, Any] = msgspec.to_builtins(document)
    return plain


def to_yaml(document: FindingsDocument) -> str:
    """Return the document's text. Every float reads back as the same number."""
    return dump_yaml(to_plain(document))


def parse_findings(text: str | bytes, name: str) -> FindingsDocument:
    """Return the findings that a YAML document holds.

    Raises:
        InputError: it is not YAML, has another schema, or a value is not valid.
    """
    return parse_result_document(text, name, FindingsDocument, SCHEMA)
