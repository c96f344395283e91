"""The result of one fit: a gyroscope's parameters, their covariance and their limitations.

Every method (likelihood, turns, gravity) returns a `GyroFit`. A fit is never a bare array, and
"converged" does not mean "trustworthy".
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.data.clocks.clock_trace import ClockTrace
from gyrorig_solver.estimate.rest_to_rest import CrossCheck
from gyrorig_solver.estimate.temperature.temperature_fit import TemperatureFit
from gyrorig_solver.model import LevelEstimate


@dataclass(frozen=True, slots=True)
class ObservabilityReport:
    """Parameters that the data determine; decided before any number is printed."""

    rank: int  # directions of gain and bias better than half of their prior
    of: int
    condition: float  # column-normalised, of the observable part; near 1 is good
    unobservable: tuple[str, ...]  # names of the parameters whose value is null
    reasons: tuple[str, ...]  # of each unobservable direction, with its remedy


@dataclass(frozen=True, slots=True, eq=False)
class NoiseLevels:
    """The noise levels of the residual, per sensor axis, shape (3,) each."""

    angle_random_walk: FloatArray  # rad/s/sqrt(Hz), one-sided, as in data sheets
    bias_instability: FloatArray  # rad/s: S(f) = B^2/(pi f), Allan floor 0.664 B
    rate_random_walk: FloatArray  # rad/s/sqrt(s): variance grows as K^2 t
    source: str  # the part of the data used
    # White noise while the stage, pan or tilt moves, by "in_motion", "pan_motion", "tilt_motion";
    # empty if it is the same as at rest.
    white_by_motor_state: Mapping[str, FloatArray] = field(default_factory=dict)
    noise_floor: FloatArray | None = None  # rad/s/sqrt(Hz), one-sided, after the low-pass


@dataclass(frozen=True, slots=True, eq=False)
class FitDiagnostics:
    """Arrays for plots: block means on one uniform grid; nan without data."""

    time_s: FloatArray  # (n,), since the first sample
    rate_rad_s: FloatArray  # (n, 3), as measured
    reference_rad_s: FloatArray  # (n, 3), stage rate of the reference
    residual_rad_s: FloatArray  # (n, 3), measured minus modelled
    whitened: FloatArray  # (n, 3), residual divided by its standard deviation, white
    moving: BoolArray  # (n,), True while the reference moves
    frequency_hz: FloatArray  # (k,), centres of the spectrum's bins
    spectrum: FloatArray  # (k, 3), one-sided residual density, (rad/s)^2/Hz
    spectrum_model: FloatArray  # (k, 3), the noise model's density
    angle_rad: FloatArray | None = None  # (2, n), pan and tilt; None without a unit


@dataclass(frozen=True, slots=True, eq=False)
class ClockQuality:
    """The quality of the mapping from the board's clock to the capture clock."""

    skew_ppm: float
    wander_bound_s: float
    latency_median_s: float
    latency_max_s: float
    restarts: int
    wraps: int
    truth: str  # the clock that defines the scale factors
    course: ClockTrace | None = None  # for plots; None for long recordings


@dataclass(frozen=True, slots=True, eq=False)
class FittedParameter:
    """One parameter of a cause beyond the base model."""

    name: str  # cause, or cause.parameter if it has several
    value: FloatArray  # nan if unobservable
    std: FloatArray
    unit: str


@dataclass(frozen=True, slots=True, eq=False)
class RecordingFit:
    """The parameters of one recording in a joint fit."""

    bias_rad_s: FloatArray  # (3,), mean over the recording
    bias_std_rad_s: FloatArray  # (3,)
    time_offset_s: float  # nan if unobservable
    time_offset_std_s: float


@dataclass(frozen=True, slots=True)
class BoardSharing:
    """Properties that a board's fit shares with other boards of the recordings; None without."""

    fitted_together: int | None = None  # boards of one joint fit
    on_one_clock: int | None = None  # boards with one time base, in the last recording
    # rms of the change of this board's times by the common time base
    clock_change_s: float | None = None


NO_SHARING = BoardSharing()


@dataclass(frozen=True, slots=True)
class GravityMoves:
    """The moves between rests that a fit to gravity compared."""

    moves: int
    poses: int
    sigma_rad: float  # standard deviation of a move's residual in each direction
    predicted_sigma_rad: float  # the same, from the noise and the rests


@dataclass(frozen=True, slots=True, eq=False)
class GyroFit:
    """One board's calibration with its covariance and its limitations.

    Values that the data do not determine are nan here and null in the document. `order` and
    `covariance` contain only known values, in the units of the values.
    """

    method: str
    terms: tuple[str, ...]
    gain: FloatArray  # (3, 3), G = S T M; nan if unobservable
    gain_std: FloatArray  # (3, 3)
    bias_rad_s: FloatArray  # (3,)
    scale: FloatArray  # (3,)
    nonorthogonality: FloatArray  # (3,), xy, zx, zy
    misalignment_rad: FloatArray  # (3,)
    time_offset_s: float  # nan without times or motion in the reference
    std: dict[str, float]  # by parameter name; nan like the value
    order: tuple[str, ...]
    covariance: FloatArray  # (k, k)
    observability: ObservabilityReport
    noise: NoiseLevels | None
    reduced_chi2: float  # whitened variance while moving over that at rest; 1 = noise only
    samples: int
    lost: int  # samples missing according to the board's counter
    outliers: int  # samples rejected as outliers
    rate_range_rad_s: tuple[float, float]  # smallest and largest rate, for the validity
    rms_before_rad_s: float  # with the nominal gain, bias removed
    rms_after_rad_s: float
    temperature_range_degc: tuple[float, float] | None = None
    clock: ClockQuality | None = None
    reference: str = ""  # one sentence: the reference of the rates
    warnings: tuple[str, ...] = ()
    refused_reasons: tuple[str, ...] = ()  # cause and remedy; the verdict becomes `refused`
    limited_reasons: tuple[str, ...] = ()  # cause and remedy; the verdict becomes `limited`
    diagnostics: FitDiagnostics | None = None
    rest_to_rest: CrossCheck | None = None  # on a pan-tilt unit
    mean_temperature_degc: float | None = None  # of the last recording; absolute or not
    sharing: BoardSharing = NO_SHARING
    gravity_moves: GravityMoves | None = None  # if the reference is gravity
    causes: tuple[FittedParameter, ...] = ()
    level: LevelEstimate | None = None  # if the recording has an accelerometer and tilts
    temperature: TemperatureFit | None = None  # the bias over temperature
    recordings: tuple[RecordingFit, ...] = ()  # in the order of time, if there are several
    reference_clock_skew: float = 0.0  # corrected, of the reference relative to the gyro's clock
    link: str = "serial"  # on which most of the lost samples were lost

    @property
    def identified(self) -> bool:
        """True if every parameter of the base model has a value.

        If False, `observability.reasons` states which motion would determine the missing ones.
        """
        return not self.observability.unobservable

    def value(self, name: str) -> float:
        """Return one parameter by its name in `order`, nan if it is unobservable."""
        group, _, part = name.partition(".")
        index = {"x": 0, "y": 1, "z": 2, "xy": 0, "zx": 1, "zy": 2}
        if name == "time_offset":
            return self.time_offset_s
        values = {
            "bias": self.bias_rad_s,
            "scale": self.scale,
            "nonorthogonality": self.nonorthogonality,
            "misalignment": self.misalignment_rad,
        }[group]
        return float(np.asarray(values)[index[part]])
