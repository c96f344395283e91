"""The schema of the twin, `gyrorig/twin/1`, a section of a rig file.

All values are in SI units. Base parameters and causes are those of one fit, with the meaning that
they have in a calibration and in findings: what the base model absorbs of a cause is in the base
parameters. The emulator separates the two.

Times are on one axis, that of the times in the findings of the first board: its zero is the
first sample. `first_move_s` links this axis to a later session. A field that is left out keeps the
default of the emulator.
"""

from typing import Annotated, Literal

import msgspec

SCHEMA = "gyrorig/twin/1"

Source = Literal["recording", "profile", "unit", "default"]

_LARGEST = 1e12
Number = Annotated[float, msgspec.Meta(ge=-_LARGEST, le=_LARGEST)]
Deviation = Annotated[float, msgspec.Meta(ge=0.0, le=_LARGEST)]
Seconds = Annotated[float, msgspec.Meta(ge=-1e7, le=1e7)]
Text = Annotated[str, msgspec.Meta(max_length=200)]
Unit = Annotated[str, msgspec.Meta(max_length=32)]
Name = Annotated[str, msgspec.Meta(min_length=1, max_length=80, pattern=r"^[\w.@ -]+$")]
_THREE = msgspec.Meta(min_length=3, max_length=3)
Triple = Annotated[tuple[Number, ...], _THREE]
DeviationTriple = Annotated[tuple[Deviation, ...], _THREE]
Positive = Annotated[float, msgspec.Meta(gt=0.0, le=_LARGEST)]
Steps = Annotated[int, msgspec.Meta(ge=-10_000_000, le=10_000_000)]
Speed = Annotated[int, msgspec.Meta(ge=0, le=10_000_000)]


class _Part(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base of the section's parts; unknown keys are invalid."""


class Scalar(_Part, frozen=True):
    """A number with its standard deviation; None if that is unknown.

    `source` is `recording` if the recordings determine the value, `profile` for a data sheet,
    `unit` for what is kept of a unit, and `default` if nothing determines it.
    """

    value: Number
    std: Deviation | None
    unit: Unit
    source: Source = "recording"


class Vector(_Part, frozen=True):
    """One number per sensor axis."""

    value: Triple
    std: DeviationTriple | None
    unit: Unit
    source: Source = "recording"


class Matrix(_Part, frozen=True):
    """A 3 x 3 matrix, row by row."""

    value: Annotated[tuple[Triple, ...], _THREE]
    std: Annotated[tuple[DeviationTriple, ...], _THREE] | None
    unit: Unit
    source: Source = "recording"


class TwinRecording(_Part, frozen=True):
    """A recording of the fit. The times are on the time axis of its causes."""

    name: Text
    sha256: Annotated[str, msgspec.Meta(pattern=r"^[0-9a-f]{64}$")]
    begin_s: Seconds  # of the first sample
    end_s: Seconds  # of the last one
    first_move_s: Seconds | None = None  # the request of the first move; None without a unit


class TwinClock(_Part, frozen=True):
    """The clock of a device. A clock with a positive skew is fast."""

    skew: Scalar | None = None  # relative to the host's clock
    wander: Scalar | None = None  # random walk of the skew, 1/sqrt(s)
    tick_hz: Positive | None = None  # nominal


class UnitFacts(_Part, frozen=True, omit_defaults=True):
    """What the unit reports about itself, as in the metadata `gyrorig.ptu` of a recording."""

    model: Text | None = None
    serial: Text | None = None
    resolution_arcsec: Positive | None = None
    pan_min_steps: Steps | None = None
    pan_max_steps: Steps | None = None
    tilt_min_steps: Steps | None = None
    tilt_max_steps: Steps | None = None
    base_speed_steps_s: Speed | None = None
    acceleration_steps_s2: Speed | None = None
    upper_speed_steps_s: Speed | None = None
    counter_hz: Positive | None = None


class TwinUnit(_Part, frozen=True):
    """The motion unit. Its errors are causes."""

    answer_time: Scalar | None = None  # s, from a command's last byte to the reply's first one
    start_delay: Scalar | None = None  # s, from a command's last byte to the start of the move
    counter: TwinClock = TwinClock()
    facts: UnitFacts = UnitFacts()


class TwinLink(_Part, frozen=True):
    """The latency of the host, in s: arrival = line + floor + exponential jitter, and stalls."""

    floor: Scalar | None = None
    jitter: Scalar | None = None  # mean of the exponential part
    stall_interval: Scalar | None = None  # mean; 0: no stalls
    stall_shortest: Scalar | None = None
    stall_longest: Scalar | None = None
    write_floor: Scalar | None = None  # from the write call to the first bit
    write_jitter: Scalar | None = None


class TwinTemperature(_Part, frozen=True):
    """The temperature of a board by time, with straight lines between the points."""

    time_s: Annotated[tuple[Seconds, ...], msgspec.Meta(min_length=2, max_length=2000)]
    degc: Annotated[
        tuple[Annotated[float, msgspec.Meta(ge=-273.15, le=1000.0)], ...],
        msgspec.Meta(min_length=2, max_length=2000),
    ]
    reference_degc: float | None = None  # at which bias and gain hold; None: the mean of `degc`


class TwinBoard(_Part, frozen=True):
    """One board: y = gain x omega(t - time_offset), low-pass filtered, + bias.

    The noise levels are totals, with the effect of a named `bias_random_walk`.
    """

    gain: Matrix  # STM of the calibration
    bias: Vector  # rad/s
    time_offset: Scalar  # s, with the delay of the low-pass
    noise_density: Vector | None = None  # rad/s/sqrt(Hz), one-sided
    bias_instability: Vector | None = None  # rad/s
    rate_random_walk: Vector | None = None  # rad/s/sqrt(s)
    noise_floor: Vector | None = None  # rad/s/sqrt(Hz), one-sided, behind the low-pass; None: 0
    odr: Scalar | None = None  # Hz, true, by the host's clock
    bandwidth: Scalar | None = None  # Hz, as configured
    full_scale: Scalar | None = None  # rad/s, as configured
    count: Scalar | None = None  # rad/s per count, nominal
    clock: TwinClock = TwinClock()
    stamp_jitter: Scalar | None = None  # s, mean
    temperature: TwinTemperature | None = None  # in the first recording
    # In the recordings after the first one, by the name of the recording.
    later_temperatures: Annotated[
        dict[Annotated[str, msgspec.Meta(max_length=255)], TwinTemperature],
        msgspec.Meta(max_length=1000),
    ] = {}
    # Effects in the residual of the fit that no known cause explains; the twin does not have them.
    unexplained: Annotated[tuple[Text, ...], msgspec.Meta(max_length=100)] = ()


class TwinCause(_Part, frozen=True):
    """An identified cause; names and units are those of findings."""

    cause: Annotated[str, msgspec.Meta(pattern=r"^[a-z][a-z0-9_]{0,39}$")]
    where: Annotated[str, msgspec.Meta(max_length=80)]  # "pan, tilt", or "all"
    parameters: Annotated[dict[Name, Scalar], msgspec.Meta(min_length=1, max_length=64)]
    board: str | None = None  # None: of the unit or the environment
    recording: Text | None = None  # in which it happened; None: in all


class Posterior(_Part, frozen=True):
    """Joint covariance of values of one fit.

    Names are paths: boards.ID.gain.0.2, boards.ID.bias.1, boards.ID.time_offset, causes.0.gap.pan,
    unit.answer_time. The covariance is in the units of the values.
    """

    names: Annotated[
        tuple[Annotated[str, msgspec.Meta(max_length=160)], ...],
        msgspec.Meta(min_length=1, max_length=400),
    ]
    covariance: Annotated[
        tuple[Annotated[tuple[Number, ...], msgspec.Meta(max_length=400)], ...],
        msgspec.Meta(min_length=1, max_length=400),
    ]


class Twin(_Part, frozen=True, kw_only=True):
    """The whole section."""

    schema: Literal["gyrorig/twin/1"]
    created: Text
    software: Text
    recordings: Annotated[tuple[TwinRecording, ...], msgspec.Meta(min_length=1, max_length=1000)]
    unit: TwinUnit | None = None
    link: TwinLink = TwinLink()
    boards: Annotated[dict[str, TwinBoard], msgspec.Meta(min_length=1, max_length=64)]
    causes: Annotated[tuple[TwinCause, ...], msgspec.Meta(max_length=200)] = ()
    posterior: Posterior | None = None
