"""The calibration document, `gyrorig/calibration/1`: its shape, read and written.

What to use when: `to_yaml` for a document made here, `parse_calibration` for one that
comes from a file. A value that the motion could not show is None, never a number, and
its parameter is named in `observability.unobservable`.
"""

from typing import Annotated, Any, Literal

import msgspec

from gyrorig_protocol.documents import dump_yaml, parse_schema

SCHEMA = "gyrorig/calibration/1"
MODEL = "y = S T M omega + b"

Matrix = list[list[float | None]]


class _Document(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base of the document's parts: unknown keys are refused."""


class BoardConfig(_Document, frozen=True, omit_defaults=True):
    """The settings the result holds for; what the recording did not say is left out."""

    odr_hz: float | None = None
    bandwidth_hz: float | None = None
    gyro_full_scale_dps: float | None = None
    gyro_scale_rad_s: float | None = None
    config_hash: str | None = None


class Board(_Document, frozen=True):
    """Which board, and how it was set."""

    id: str
    uid: str
    sensor: str
    config: BoardConfig


class SolvedInput(_Document, frozen=True):
    """One recording that the result was solved from."""

    name: str
    sha256: str
    start: str
    duration_s: float
    samples: int
    lost: int


class SolverRecord(_Document, frozen=True):
    """What solved it, and with which settings."""

    version: str
    method: str
    terms: list[str]
    config_sha256: str


class Units(_Document, frozen=True):
    """The units of every quantity that does not name its own."""

    rate: str = "rad/s"
    temperature: str = "degC"
    time: str = "s"


class Parameter(_Document, frozen=True):
    """One parameter: value, standard deviation, unit; None where it was not observable."""

    value: list[float | None] | float | None
    std: list[float | None] | float | None
    unit: str


class NoiseFigure(_Document, frozen=True):
    """One coefficient of the noise, per axis; None where it was not estimated."""

    value: list[float | None]
    unit: str


class Matrices(_Document, frozen=True):
    """The factors of the gain matrix and their product, rows first."""

    S: Matrix
    T: Matrix
    M: Matrix
    STM: Matrix


class Covariance(_Document, frozen=True):
    """The full covariance, in the units of the parameters, of those that have a value."""

    order: list[str]
    matrix: list[list[float]]


class Observability(_Document, frozen=True):
    """How much of the model the motion could show."""

    rank: int
    of: int
    unobservable: list[str]
    condition: float | None


class HeldOut(_Document, frozen=True):
    """The rate error on data that the fit has not seen."""

    rms_before: float
    rms_after: float
    unit: str = "rad/s"


class SecondOpinion(_Document, frozen=True):
    """The turns from rest to rest beside the rates: blind to timing, so a judge of it."""

    moves: int
    p_value: float  # of the difference, in the combined uncertainty; small is bad
    largest_sigma: float


class Level(_Document, frozen=True):
    """How the unit stands by the board's accelerometer, rad.

    `tilt_zero` is the tilt axis' zero minus the board's mount about x: no sensor on the
    board tells the two apart. `lean` is the pan axis against the vertical, to the right and
    forward.
    """

    tilt_zero: float
    tilt_zero_std: float
    lean: list[float]
    lean_std: list[float]
    rests: int


class OwnOfRecording(_Document, frozen=True):
    """What is free in each recording of a joint solve; None where it was not observable."""

    name: str
    bias: list[float | None]  # mean over the recording, rad/s
    bias_std: list[float | None]
    time_offset: float | None  # s
    time_offset_std: float | None


class Quality(_Document, frozen=True, omit_defaults=True):
    """How well the model explains the data. `reduced_chi2` is 1 when noise is all that is left."""

    reduced_chi2: float | None
    warnings: list[str]
    held_out: HeldOut | None = None
    efficiency: dict[str, float] | None = None
    outliers: int | None = None
    rest_to_rest: SecondOpinion | None = None
    level: Level | None = None  # where the accelerometer was recorded at several tilts
    recordings: list[OwnOfRecording] | None = None  # where several were solved together
    # of the board's own thermometer; its zero may be unknown, see `validity` for one that is not
    mean_temperature_degc: float | None = None
    boards_together: int | None = None  # on one unit at once, its motion found by all of them
    boards_on_one_clock: int | None = None  # on one bus, their times made one by its edges
    clock_moved_s: float | None = None  # by that, rms
    clock_skew_ppm: float | None = None  # the board's clock against its host's; + is fast


class Trust(_Document, frozen=True):
    """Whether to use the result.

    good: use it inside its validity. limited: use what has a value, and read the reasons.
    refused: do not use it; every reason names what to do first.
    """

    verdict: Literal["good", "limited", "refused"]
    reasons: list[str]  # each names its cause and its remedy


class Validity(_Document, frozen=True, omit_defaults=True):
    """The range of rates and temperatures that the recordings covered."""

    rate_rad_s: Annotated[list[float], msgspec.Meta(min_length=2, max_length=2)]
    temperature_degc: Annotated[list[float], msgspec.Meta(min_length=2, max_length=2)] | None = None
    config_hash: str | None = None


class Findings(_Document, frozen=True):
    """What `gyrorig explain` found, if it was asked."""

    verdict: str
    causes: list[str]
    file: str


class Calibration(_Document, frozen=True, omit_defaults=True):
    """One result for one board: immutable once written."""

    schema: Literal["gyrorig/calibration/1"] = msgspec.field()
    board: Board
    version: Annotated[int, msgspec.Meta(ge=1)]
    created: str
    inputs: list[SolvedInput]
    solver: SolverRecord
    units: Units
    model: str
    parameters: dict[str, Parameter]
    matrices: Matrices
    covariance: Covariance
    observability: Observability
    noise: dict[str, NoiseFigure]
    quality: Quality
    trust: Trust
    validity: Validity
    previous: str | None = None
    findings: Findings | None = None


_ORDER = (
    *("schema", "board", "version", "previous", "created", "inputs", "solver", "units", "model"),
    *("parameters", "matrices", "covariance", "observability", "noise", "quality", "trust"),
    *("validity", "findings"),
)


def to_plain(calibration: Calibration) -> dict[str, Any]:
    """Return the document as mappings, lists and scalars, in the order of the contract."""
    plain: dict[str, Any] = msgspec.to_builtins(calibration)
    return {key: plain[key] for key in _ORDER if key in plain}


def to_yaml(calibration: Calibration) -> str:
    """Return the document's text. Every float reads back as the very same number."""
    return dump_yaml(to_plain(calibration))


def parse_calibration(text: str | bytes, name: str) -> Calibration:
    """Return the calibration that a YAML document holds.

    Args:
        text: the document.
        name: what to call it in an error, usually its file name.

    Raises:
        InputError: it is not YAML, of another schema, or does not keep the contract.
    """
    return parse_schema(text, name, Calibration, SCHEMA, "is no calibration")
