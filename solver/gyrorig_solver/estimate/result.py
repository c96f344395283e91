"""What one fit says about one gyroscope, and how far to trust it.

Every method (likelihood, turns, gravity) returns a `GyroFit`. A fit never is a bare
array, and "converged" is not "trustworthy".
"""

from dataclasses import dataclass, field

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.clocks.course import ClockCourse


@dataclass(frozen=True, slots=True)
class Observability:
    """What the data could show, judged before a single number is printed."""

    rank: int  # directions of gain and bias that the data fixes better than half the prior
    of: int
    condition: float  # column-normalised, of what was observed; near 1 is good
    unobservable: tuple[str, ...]  # parameter names whose value is null
    reasons: tuple[str, ...]  # each unobservable direction in words, with its remedy


@dataclass(frozen=True, slots=True, eq=False)
class NoiseLevels:
    """The noise that the residual shows, per sensor axis, shape (3,) each."""

    angle_random_walk: FloatArray  # rad/s/sqrt(Hz), one-sided, as data sheets give it
    bias_instability: FloatArray  # rad/s: S(f) = B^2/(pi f), Allan floor 0.664 B
    rate_random_walk: FloatArray  # rad/s/sqrt(s): variance grows as K^2 t
    source: str  # which part of the data they were estimated from


@dataclass(frozen=True, slots=True, eq=False)
class FitDiagnostics:
    """Arrays for pictures: block means on one uniform grid; nan where there is no data."""

    time_s: FloatArray  # (n,), since the first sample
    rate_rad_s: FloatArray  # (n, 3), as measured
    reference_rad_s: FloatArray  # (n, 3), stage rate that the reference says
    residual_rad_s: FloatArray  # (n, 3), measured minus modelled
    whitened: FloatArray  # (n, 3), residual in units of its own standard deviation, white
    moving: BoolArray  # (n,), True while the reference moves
    frequency_hz: FloatArray  # (k,), centres of the spectrum's bins
    spectrum: FloatArray  # (k, 3), one-sided residual density, (rad/s)^2/Hz
    spectrum_model: FloatArray  # (k, 3), the noise model's density
    angle_rad: FloatArray | None = None  # (2, n), pan and tilt; None without a unit


@dataclass(frozen=True, slots=True, eq=False)
class Clock:
    """What the mapping from the board's clock to the capture clock found."""

    skew_ppm: float
    wander_bound_s: float
    latency_median_s: float
    latency_max_s: float
    restarts: int
    wraps: int
    truth: str  # which clock the common gain rests on
    course: ClockCourse | None = None  # for pictures; None of long recordings


@dataclass(frozen=True, slots=True, eq=False)
class FittedCause:
    """One parameter of a cause beyond the base model."""

    name: str  # cause, or cause.parameter where it has several
    value: FloatArray  # nan where it is not observable
    std: FloatArray
    unit: str


@dataclass(frozen=True, slots=True)
class StageLevel:
    """What the board's accelerometer says of the unit at rest; see model/terms/leveling."""

    tilt_zero_rad: float  # the tilt axis' zero minus the board's mount about x
    tilt_zero_std_rad: float
    lean_rad: tuple[float, float]  # of the pan axis against the vertical, to the right, forward
    lean_std_rad: tuple[float, float]
    rests: int


@dataclass(frozen=True, slots=True, eq=False)
class RecordingFit:
    """What is one recording's own in a joint fit."""

    bias_rad_s: FloatArray  # (3,), mean over the recording
    bias_std_rad_s: FloatArray  # (3,)
    time_offset_s: float  # nan where nothing shows it
    time_offset_std_s: float


@dataclass(frozen=True, slots=True, eq=False)
class GyroFit:
    """One board's calibration with its covariance and its named reasons for distrust.

    Values that the data cannot show are nan here and null in the document. `order` and
    `covariance` hold only what is known, in the units of the values.
    """

    method: str
    terms: tuple[str, ...]
    gain: FloatArray  # (3, 3), G = S T M; nan where unobservable
    gain_std: FloatArray  # (3, 3)
    bias_rad_s: FloatArray  # (3,)
    scale: FloatArray  # (3,)
    nonorthogonality: FloatArray  # (3,), xy, zx, zy
    misalignment_rad: FloatArray  # (3,)
    time_offset_s: float  # nan where the reference has no times or no motion
    std: dict[str, float]  # by parameter name; nan where the value is
    order: tuple[str, ...]
    covariance: FloatArray  # (k, k)
    observability: Observability
    noise: NoiseLevels | None
    reduced_chi2: float  # whitened variance while moving over that at rest; 1 = noise only
    samples: int
    lost: int  # samples that the board's own counter says are missing
    outliers: int  # samples set aside as spikes
    rate_range_rad_s: tuple[float, float]  # smallest and largest rate seen, for validity
    rms_before_rad_s: float  # nominal gain, bias removed
    rms_after_rad_s: float
    temperature_range_degc: tuple[float, float] | None = None
    clock: Clock | None = None
    reference: str = ""  # one sentence: what the rates were compared with
    warnings: tuple[str, ...] = ()
    distrust: tuple[str, ...] = ()  # cause and remedy; makes the verdict `limited`
    diagnostics: FitDiagnostics | None = None
    extra: dict[str, float] = field(default_factory=dict)
    causes: tuple[FittedCause, ...] = ()
    level: StageLevel | None = None  # where the recording has an accelerometer and tilts
    recordings: tuple[RecordingFit, ...] = ()  # in the order of time, where there are several

    @property
    def identified(self) -> bool:
        """True when every parameter of the base model has a value.

        False: the motion could not show it; `observability.reasons` says what would.
        """
        return not self.observability.unobservable

    def value(self, name: str) -> float:
        """Return one parameter by its name in `order`, nan where it is unobservable."""
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
