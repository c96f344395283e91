"""The findings document, `gyrorig/findings/1`: its shape, read and written.

What to use when: `to_yaml` for a document made here, `parse_findings` for one that comes from
a file. A number that nobody knows is None.
"""

from typing import Any, Literal

import msgspec

from gyrorig_protocol.documents import dump_yaml, parse_schema

SCHEMA = "gyrorig/findings/1"


class _Document(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base of the document's parts: unknown keys are refused."""


class Input(_Document, frozen=True):
    """One recording that was looked at."""

    name: str
    sha256: str


class Subject(_Document, frozen=True):
    """Which board."""

    id: str
    sensor: str


class Base(_Document, frozen=True):
    """What the model without any cause leaves."""

    terms: list[str]
    reduced_chi2: float | None
    whiteness_p: float | None


class Size(_Document, frozen=True):
    """One value of a cause."""

    value: float | None
    std: float | None
    unit: str


class Evidence(_Document, frozen=True, omit_defaults=True):
    """Why a cause is named."""

    statistic: float | None
    degrees_of_freedom: int
    p_value: float | None
    seen_as: str
    figure: str | None = None
    posterior: float | None = None


class Rival(_Document, frozen=True):
    """What else was weighed, by how much it lost, and why."""

    cause: str
    delta_log_likelihood: float | None
    reason: str


class Gain(_Document, frozen=True, omit_defaults=True):
    """What the extended model is worth on data it was not fitted to."""

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


class Change(_Document, frozen=True):
    """What a cause does to one parameter of the calibration when it is taken in."""

    parameter: str
    before: float | None
    after: float | None
    std: float | None
    unit: str


class Cause(_Document, frozen=True, omit_defaults=True):
    """One named cause, or the likeliest of a set that the data cannot tell apart."""

    cause: str
    part: str
    where: str
    parameters: dict[str, Size]
    evidence: Evidence
    gain: Gain | None
    one_of: list[str] = []  # the others of the set
    rivals: list[Rival] = []
    effect_on_calibration: list[Change] = []
    harm_sigma: float | None = None  # largest of those changes, in standard deviations
    remedy: str = ""
    recording: str | None = None  # of several, in which it happened; None: in all of them


class Dependence(_Document, frozen=True):
    """What the rest depends on, too."""

    covariate: str
    statistic: float | None
    p_value: float | None


class Unexplained(_Document, frozen=True, omit_defaults=True):
    """What no known cause accounts for."""

    statistic: float | None
    p_value: float | None
    best_covariate: str
    figure: str | None = None
    harm: str = ""  # what it might do to the calibration, in words
    harm_sigma: float | None = None  # the same, in standard deviations
    others: list[Dependence] = []


class NotTestable(_Document, frozen=True, omit_defaults=True):
    """What this recording could not have shown, and what would."""

    cause: str
    reason: str
    where: str | None = None


class Detectable(_Document, frozen=True, omit_defaults=True):
    """How large a cause may be unseen, and what that would do to the calibration."""

    cause: str
    size: float | None
    unit: str
    where: str | None = None
    typical: float | None = None
    would_move: str | None = None
    by_sigma: float | None = None


class RawLook(_Document, frozen=True):
    """One look at the raw stream, without a model."""

    check: str
    recording: str
    found: bool
    said: str


class FindingsDocument(_Document, frozen=True, omit_defaults=True):
    """All that is said of one board."""

    schema: Literal["gyrorig/findings/1"] = msgspec.field()
    board: Subject
    created: str
    software: str
    recording: list[Input]
    verdict: Literal["adequate", "explained", "unexplained"]
    base: Base
    causes: list[Cause]
    not_testable: list[NotTestable]
    minimal_detectable: list[Detectable]
    raw: list[RawLook]
    unexplained: Unexplained | None = None
    gain: Gain | None = None  # of all causes together
    elsewhere: Gain | None = None  # the same, on a recording that had no part in finding them
    effect_on_calibration: list[Change] = []  # of all causes together
    remarks: list[str] = []


_ORDER = (
    *("schema", "board", "created", "software", "recording", "verdict", "base", "causes"),
    *(
        "unexplained",
        "gain",
        "elsewhere",
        "effect_on_calibration",
        "not_testable",
        "minimal_detectable",
    ),
    *("raw", "remarks"),
)


def to_plain(document: FindingsDocument) -> dict[str, Any]:
    """Return the document as mappings, lists and scalars, in the order of the contract."""
    plain: dict[str, Any] = msgspec.to_builtins(document)
    return {key: plain[key] for key in _ORDER if key in plain}


def to_yaml(document: FindingsDocument) -> str:
    """Return the document's text. Every float reads back as the very same number."""
    return dump_yaml(to_plain(document))


def parse_findings(text: str | bytes, name: str) -> FindingsDocument:
    """Return the findings that a YAML document holds.

    Args:
        text: the document.
        name: what to call it in an error, usually its file name.

    Raises:
        InputError: it is not YAML, of another schema, or does not keep the contract.
    """
    return parse_schema(text, name, FindingsDocument, SCHEMA, "holds no findings")
