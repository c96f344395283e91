"""Measured streams: what every importer reads, before it becomes a recording.

What to use when: a format's `read` returns `MeasuredStreams`; `imported_recording.write_streams`
writes them. All times are in seconds since `MeasuredStreams.origin_ns`, so that an absolute time
keeps its nanoseconds.
"""

from dataclasses import dataclass, field
from typing import Literal, Self

import numpy as np

from gyrorig_protocol.recording.writer import Attachment
from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.importers.map_keys import SectionSpan

STANDARD_GRAVITY_M_S2 = 9.80665  # the unit g, CGPM 1901
LENGTH_TOLERANCE = 0.01  # of a quaternion
# sampled: the device's own time of each sample; arrival: the time at which the host received it.
StampKind = Literal["sampled", "arrival"]


@dataclass(frozen=True, slots=True, eq=False)
class GyroStream:
    """The rates of one sensor; a row that is not finite is no sample.

    With `stamp` "arrival" the sample number is the clock of the sensor. Without a counter of the
    source, the numbers of sampled rows are those of their times, and those of arrivals the rows.
    """

    time_s: FloatArray  # (n,), increasing; arrival times can repeat
    values: FloatArray  # (n, 3), rad/s, or counts if `scale_rad_s` is given
    scale_rad_s: float | None = None  # nominal scale of a count
    stamp: StampKind = "sampled"
    rate_hz: float | None = None  # nominal sample rate, if the source gives it
    number: IntArray | None = None  # (n,), sample counter of the source, if it has one


@dataclass(frozen=True, slots=True, eq=False)
class AccelStream:
    """The accelerations of one sensor; rows that are not finite are lost."""

    values: FloatArray  # (m, 3), m/s^2, or counts if `scale_m_s2` is given
    time_s: FloatArray | None = None  # (m,); None: the times of the gyro
    scale_m_s2: float | None = None
    stamp: StampKind = "sampled"  # arrival times can repeat


@dataclass(frozen=True, slots=True, eq=False)
class TemperatureStream:
    """The temperatures of one sensor; values that are not finite are lost."""

    temperature_degc: FloatArray  # (m,)
    time_s: FloatArray | None = None  # (m,); None: the times of the gyro
    stamp: StampKind = "sampled"  # arrival times can repeat


@dataclass(frozen=True, slots=True, eq=False)
class PoseStream:
    """Reference attitudes, body to world, without the lost ones.

    The rows are in the order of the frames. Stamps that jitter can go back by a little.
    """

    time_s: FloatArray  # (n,)
    orientation_xyzw: FloatArray  # (n, 4), length 1
    standard_deviation_rad: float = float("nan")  # per axis; nan if the source does not give it
    stamp: StampKind = "sampled"
    rate_hz: float | None = None  # nominal rate, if the source gives it
    lost: int = 0

    @classmethod
    def of_rows(
        cls, time_s: FloatArray, orientation_xyzw: FloatArray, stamp: StampKind = "sampled"
    ) -> Self:
        """Return the rows whose quaternion has the length 1; the others are lost."""
        length = np.linalg.norm(orientation_xyzw, axis=1)
        is_valid = np.isfinite(length) & (np.abs(length - 1.0) < LENGTH_TOLERANCE)
        unit = orientation_xyzw[is_valid] / length[is_valid, None]
        return cls(time_s[is_valid], unit, stamp=stamp, lost=int((~is_valid).sum()))


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredBoard:
    """The streams of one board.

    A board without a gyro has only streams that another file's board of the same name completes.
    """

    name: str
    gyro: GyroStream | None = None
    accel: AccelStream | None = None
    temperature: TemperatureStream | None = None
    # keys of `gyrorig.board.<id>` in a recording, for example sensor, model, bandwidth_hz
    metadata: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class MeasuredPhase:
    """A rest or a known turn over some rows or times of one board."""

    name: Literal["static", "turn"]
    board: str  # whose gyro rows or times the span specifies
    span: SectionSpan  # times are since `origin_ns`
    text: str = ""  # of a turn, from `turn_text`


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredStreams:
    """All that one source holds of a measurement, neutral to its format."""

    source: str  # for readers of the recording, for example "imported from log.csv"
    boards: tuple[MeasuredBoard, ...] = ()
    poses: PoseStream | None = None
    phases: tuple[MeasuredPhase, ...] = ()
    origin_ns: int = 0  # the source's time 0 in the recording; Unix time if the source has it
    gravity_m_s2: float | None = None
    attachments: tuple[Attachment, ...] = ()
    notes: tuple[str, ...] = ()
