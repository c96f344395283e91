"""Schema of the calibration document, `gyrorig/calibration/1`, with its reader and writer.

What to use when: `calibration_as_yaml` to write a document, `parse_calibration` to read one.
A value that the motion could not determine is None, never a number, and its parameter is listed
in `observability.unobservable`.
"""

from typing import Annotated, Any, Literal

import msgspec

from gyrorig_protocol.documents import dump_yaml, parse_result_document
from gyrorig_solver.calibration.document_checks import check_document
from gyrorig_solver.calibration.temperature_record import TemperatureRecord

SCHEMA = "gyrorig/calibration/1"
MODEL = "y = S T M omega + b"

Matrix = list[list[float | None]]

UNKNOWN_IDENTITIES = frozenset({"", "unknown"})  # uid or sensor of old boards, imports, tables


def are_different(identity: str, other: str) -> bool:
    """Return whether two uids, or two types of sensors, are known and different."""
    return not {identity, other} & UNKNOWN_IDENTITIES and identity != other


class _DocumentPart(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base of the document's parts: unknown keys are errors."""


class BoardSettings(_DocumentPart, frozen=True, omit_defaults=True):
    """The settings for which the result is valid; unknown ones are omitted."""

    odr_hz: float | None = None
    bandwidth_hz: float | None = None
    gyro_full_scale_dps: float | None = None
    gyro_scale_rad_s: float | None = None
    config_hash: str | None = None


class BoardRecord(_DocumentPart, frozen=True):
    """The board and its settings."""

    id: str
    uid: str
    sensor: str
    config: BoardSettings

    def has_other_uid(self, uid: str) -> bool:
        """Return whether this board and the board with `uid` are different; both must be known."""
        return are_different(self.uid, uid)

    def difference_from(self, other: "BoardRecord") -> str | None:
        """Return the key in which another board differs, None if both can be the same board.

        The id counts, and what is known of both: uid, sensor and settings.
        """
        if self.id != other.id:
            return "id"
        if self.has_other_uid(other.uid):
            return "uid"
        if are_different(self.sensor, other.sensor):
            return "sensor"
        for key in self.config.__struct_fields__:
            value, other_value = getattr(self.config, key), getattr(other.config, key)
            if None not in (value, other_value) and value != other_value:
                return key
        return None


class SolvedInput(_DocumentPart, frozen=True):
    """One recording from which the result was solved."""

    name: str
    sha256: str
    start: str
    duration_s: float
    samples: int
    lost: int


class SolverRecord(_DocumentPart, frozen=True):
    """The solver and its settings."""

    version: str
    method: str
    terms: list[str]
    config_sha256: str


class Units(_DocumentPart, frozen=True):
    """The units of all quantities that do not give their unit."""

    rate: str = "rad/s"
    temperature: str = "degC"
    time: str = "s"


class Parameter(_DocumentPart, frozen=True):
    """One parameter: value, standard uncertainty, unit; None where it was not observable."""

    value: list[float | None] | float | None
    std: list[float | None] | float | None
    unit: str


class NoiseFigure(_DocumentPart, frozen=True):
    """One noise coefficient per axis; None where it was not estimated."""

    value: list[float | None]
    unit: str


class Matrices(_DocumentPart, frozen=True):
    """The factors of the sensor matrix and their product, row by row."""

    S: Matrix
    T: Matrix
    M: Matrix
    STM: Matrix


class Covariance(_DocumentPart, frozen=True):
    """The full covariance of the parameters that have a value, in their units."""

    order: list[str]
    matrix: list[list[float]]


class ObservabilityRecord(_DocumentPart, frozen=True):
    """Observability: how much of the model the motion determined."""

    rank: int
    of: int
    unobservable: list[str]
    condition: float | None


class HeldOut(_DocumentPart, frozen=True):
    """The rate error on held-out data."""

    rms_before: float
    rms_after: float
    unit: str = "rad/s"


class RestToRestCheck(_DocumentPart, frozen=True):
    """Comparison of rates with the angles between static intervals, which do not depend on time."""

    moves: int
    p_value: float  # of the difference; small means inconsistent
    largest_sigma: float


class LevelRecord(_DocumentPart, frozen=True):
    """Leveling of the unit from the board's accelerometer, rad.

    `tilt_zero` is the tilt axis' zero minus the board's mounting angle about x: no sensor on the
    board separates the two. `lean` is the pan axis' angle to the vertical, to the right and
    forward.
    """

    tilt_zero: float
    tilt_zero_std: float
    lean: list[float]
    lean_std: list[float]
    rests: int


class RecordingParameters(_DocumentPart, frozen=True):
    """Parameters per recording of a joint solve; None where not observable."""

    name: str
    bias: list[float | None]  # mean over the recording, rad/s
    bias_std: list[float | None]
    time_offset: float | None  # s
    time_offset_std: float | None


class Quality(_DocumentPart, frozen=True, omit_defaults=True):
    """Goodness of fit. `reduced_chi2` is about 1 if the residual is noise."""

    reduced_chi2: float | None
    warnings: list[str]
    held_out: HeldOut | None = None
    efficiency: dict[str, float] | None = None
    outliers: int | None = None
    rest_to_rest: RestToRestCheck | None = None
    level: LevelRecord | None = None  # if the accelerometer was recorded at several tilts
    recordings: list[RecordingParameters] | None = None  # if several were solved together
    # of the board's thermometer, whose zero may be unknown; `validity` has calibrated temperatures
    mean_temperature_degc: float | None = None
    boards_together: int | None = None  # on one unit at the same time
    boards_on_one_clock: int | None = None  # on one bus, with a common time base
    clock_moved_s: float | None = None  # change of the times by the common time base, rms
    clock_skew_ppm: float | None = None  # the board's clock against its host's; + is fast
    # causes and covariates that tests found significant beside this model; None: not tested
    remaining_effects: list[str] | None = None


class Trust(_DocumentPart, frozen=True):
    """The verdict on the result.

    good: use it within its validity. limited: read the reasons before using the values.
    refused: do not use it. Each reason contains the remedy.
    """

    verdict: Literal["good", "limited", "refused"]
    reasons: list[str]  # each with its remedy


class Validity(_DocumentPart, frozen=True, omit_defaults=True):
    """The range of rates and temperatures in the recordings."""

    rate_rad_s: Annotated[list[float], msgspec.Meta(min_length=2, max_length=2)]
    temperature_degc: Annotated[list[float], msgspec.Meta(min_length=2, max_length=2)] | None = None
    config_hash: str | None = None


class FindingsReference(_DocumentPart, frozen=True):
    """The findings of `gyrorig explain`, if it was run."""

    verdict: str
    causes: list[str]
    file: str

    @property
    def distinct_causes(self) -> list[str]:
        """The causes for a text: one that has several axes is named once."""
        return list(dict.fromkeys(self.causes))


class ParameterUncertainty(_DocumentPart, frozen=True):
    """The standard uncertainty of one value: noise, causes that were not identified, and both."""

    type_a: float  # as `std`
    type_b: float
    total: float
    interval: Annotated[list[float], msgspec.Meta(min_length=2, max_length=2)]
    limit: float  # largest `total` of a good calibration
    unit: str


class BudgetRow(_DocumentPart, frozen=True):
    """A contribution to the total uncertainty of one parameter."""

    parameter: str
    cause: str
    place: str | None  # an axis; None where the cause has none
    contribution: float  # standard uncertainty, in the parameter's unit
    share: float  # of the total variance that would vanish without the cause
    remedy: str  # the motion or measurement that reduces it


class UncertaintyRecord(_DocumentPart, frozen=True):
    """The total uncertainty (GUM) of the base parameters.

    Shares of causes that resemble each other overlap, therefore they need not sum to one.
    """

    coverage_factor: float  # of an interval, in units of `total`, if all errors are normal
    parameters: dict[str, ParameterUncertainty]
    budget: list[BudgetRow]  # for each parameter the largest first
    settings_sha256: str  # of the prior sizes and the limits
    # of each interval; None where it is the value and k times `total` on both sides
    coverage_probability: float | None = None


class UnitPriorRecord(_DocumentPart, frozen=True, omit_defaults=True):
    """The stored posterior of the pan-tilt unit that corrected the values."""

    id: str
    version: int
    recordings: int  # that the version counts
    days: float  # between the version and the recording
    sha256: str | None = None  # `sha256:` digest of the version; None for a file named by a user


class CalibrationDocument(_DocumentPart, frozen=True, kw_only=True, omit_defaults=True):
    """One calibration of one board: immutable once written. The keys have this order."""

    schema: Literal["gyrorig/calibration/1"] = msgspec.field()
    board: BoardRecord
    version: Annotated[int, msgspec.Meta(ge=1, le=999_999_999)]
    previous: str | None = None
    created: str
    inputs: list[SolvedInput]
    solver: SolverRecord
    units: Units
    model: str
    parameters: dict[str, Parameter]
    matrices: Matrices
    covariance: Covariance
    observability: ObservabilityRecord
    noise: dict[str, NoiseFigure]
    quality: Quality
    trust: Trust
    validity: Validity
    temperature: TemperatureRecord | None = None  # bias and scale against temperature
    uncertainty: UncertaintyRecord | None = None  # None: of a fit without type B uncertainty
    unit_prior: UnitPriorRecord | None = None  # None: the prior sizes of the table
    findings: FindingsReference | None = None


def calibration_as_mapping(calibration: CalibrationDocument) -> dict[str, Any]:
    """Return the document as mappings, lists and scalars, in the order of the schema."""
    mapping: dict[str, Any] = msgspec.to_builtins(calibration)
    return mapping


def calibration_as_yaml(calibration: CalibrationDocument) -> str:
    """Return the document as YAML. Every float reads back as the same number."""
    return dump_yaml(calibration_as_mapping(calibration))


def parse_calibration(text: str | bytes, name: str) -> CalibrationDocument:
    """Return the calibration of a YAML document.

    Raises:
        InputError: it is not YAML, has another schema, does not match it, or has names or lists
            that no calibration has.
    """
    document = parse_result_document(text, name, CalibrationDocument, SCHEMA)
    check_document(document, name)
    return document
