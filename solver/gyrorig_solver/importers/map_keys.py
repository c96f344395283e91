"""The keys of an import map: meaning and unit of the columns of a measurement file.

What to use when: these structures define the keys; unknown keys are errors. Each docstring
describes the keys of its part, and the page "Import map" of the documentation is made from them.
"""

from typing import Annotated, Literal

import msgspec

SCHEMA = "gyrorig/import/1"

Name = Annotated[str, msgspec.Meta(min_length=1, max_length=200)]
ColumnNumber = Annotated[int, msgspec.Meta(ge=1, le=100_000)]
Column = Name | ColumnNumber
Positive = Annotated[float, msgspec.Meta(gt=0.0)]
Triple = Annotated[list[float], msgspec.Meta(min_length=3, max_length=3)]
CountTriple = Annotated[list[int], msgspec.Meta(min_length=3, max_length=3)]
Columns = Annotated[list[Column], msgspec.Meta(min_length=1, max_length=9)]
RowCount = Annotated[int, msgspec.Meta(ge=0, le=100_000)]
FileName = Annotated[str, msgspec.Meta(pattern=r"^(?!.*\.\.)[^/\\][^\\]{0,250}$")]


class MapPart(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base of the parts of a map; unknown keys are errors."""


class TableLayout(MapPart, frozen=True):
    """How a text table is written. A table without special lines needs none of these keys.

    Keys:
        skip_rows: number of lines before the header that are left out.
        header_rows: number of lines of the header. With several lines, a column can be named by
            the text of one line, or by the texts of all lines with a space between them; an empty
            cell of a group line takes the text to its left. With 0, give the columns by number.
        comment: lines that begin with this text are left out.
        delimiter: what separates the columns. Without it, the header decides between comma,
            semicolon and tab. `space` means any number of blanks.
        decimal: the decimal sign of the numbers.
    """

    skip_rows: RowCount = 0
    header_rows: Annotated[int, msgspec.Meta(ge=0, le=10)] = 1
    comment: Annotated[str, msgspec.Meta(min_length=1, max_length=10)] | None = None
    delimiter: Literal["comma", "semicolon", "tab", "space"] | None = None
    decimal: Literal["point", "comma"] = "point"


class TimeBase(MapPart, frozen=True):
    """Source of the times of a stream: a column, or a rate and the row number.

    Keys:
        key: the column with the times.
        unit: the unit of the times.
        rate_hz: the sample rate, if there is no column with times. With `stamp: arrival`, the
            nominal rate of the sensor.
        rate_key: an array that contains the sample rate in Hz.
        origin_s: a time in s that is added to every time.
        stamp: `sampled` if the column contains the times of the samples. `arrival` if it contains
            the times of their arrival at the host, possibly in bursts; then the row number is the
            clock of the sensor.
    """

    key: Column | None = None
    unit: Literal["s", "ms", "us", "ns"] = "s"
    rate_hz: Positive | None = None
    rate_key: Name | None = None
    origin_s: float = 0.0
    stamp: Literal["sampled", "arrival"] = "sampled"


class GyroColumns(MapPart, frozen=True):
    """The gyroscope: one array of three columns, or three columns.

    Keys:
        keys: the columns x, y and z, or the name of one array with three columns.
        unit: the unit of the columns.
        scale_rad_s: the nominal value of one count in rad/s, with the unit `counts`.
        offset_counts: the code of zero in counts, which is subtracted; one number, or one per axis.
        zero: the value of the columns at zero rate, which is subtracted, in the unit of the
            columns; one number, or one per axis. Not with the unit `counts`.
        full_scale_dps: the full scale of the sensor in deg/s.
        bandwidth_hz: the bandwidth of the sensor's filter in Hz.
    """

    keys: Columns
    unit: Literal["rad/s", "deg/s", "counts"]
    scale_rad_s: Positive | None = None
    offset_counts: int | CountTriple = 0
    zero: float | Triple = 0.0
    full_scale_dps: Positive | None = None
    bandwidth_hz: Positive | None = None


class AccelColumns(MapPart, frozen=True):
    """The accelerometer, with separate times if it has them.

    Keys:
        keys: the columns x, y and z, or the name of one array with three columns.
        unit: the unit of the columns.
        scale_m_s2: the nominal value of one count in m/s^2, with the unit `counts`.
        offset_counts: the code of zero in counts, which is subtracted; one number, or one per axis.
        zero: the value of the columns at zero acceleration, which is subtracted, in the unit of
            the columns; one number, or one per axis. Not with the unit `counts`.
        time: the times of the accelerometer, if they are not those of the gyroscope.
        file: the file of the accelerometer in the folder of the input, if it is another file.
        table: how this file is written.
    """

    keys: Columns
    unit: Literal["m/s2", "g", "counts"]
    scale_m_s2: Positive | None = None
    offset_counts: int | CountTriple = 0
    zero: float | Triple = 0.0
    time: TimeBase | None = None
    file: FileName | None = None
    table: TableLayout | None = None


class TemperatureColumn(MapPart, frozen=True):
    """The temperature in degrees Celsius, with separate times if it has them.

    Keys:
        key: the column with the temperature.
        time: the times of the temperature, if they are not those of the gyroscope.
        file: the file of the temperature in the folder of the input, if it is another file.
        table: how this file is written.
    """

    key: Column
    time: TimeBase | None = None
    file: FileName | None = None
    table: TableLayout | None = None


class AttitudeColumns(MapPart, frozen=True):
    """A reference attitude; rows that are not finite are gaps.

    With `stamp: arrival` under `time` the attitudes are late by a delay that changes; the
    solver then finds the times of the frames. There `rate_hz` is not needed.

    Keys:
        keys: the four columns of a quaternion, the nine columns of a rotation matrix row by row,
            or the name of one array with four columns, nine columns or the shape (n, 3, 3).
        order: the order of a quaternion's columns, or `matrix` for rotation matrices.
        maps: what the attitudes map, from the axes of the body to those of the world or back.
        std_deg: the standard deviation per axis in degrees, if the source gives it.
        time: the times of the attitudes, if they are not those of the gyroscope.
        file: the file of the attitudes in the folder of the input, if it is another file.
        table: how this file is written.
    """

    keys: Columns
    order: Literal["wxyz", "xyzw", "matrix"]
    maps: Literal["body_to_world", "world_to_body"] = "body_to_world"
    std_deg: Positive | None = None
    time: TimeBase | None = None
    file: FileName | None = None
    table: TableLayout | None = None


class SectionSpan(MapPart, frozen=True):
    """A section by row numbers or by times; a missing bound is open.

    Keys:
        start: the first row, from 0.
        end: the row after the last one.
        begin_s: the time of the begin in s.
        end_s: the time of the end in s.
    """

    start: Annotated[int, msgspec.Meta(ge=0)] | None = None
    end: Annotated[int, msgspec.Meta(ge=0)] | None = None
    begin_s: float | None = None
    end_s: float | None = None


class MappedTurn(MapPart, frozen=True):
    """A known turn.

    Keys:
        axis: the axis in the stage frame, as a unit vector.
        angle_deg: the signed angle in degrees.
        std_deg: the standard deviation of the angle in degrees.
        over: the section that contains the turn.
    """

    axis: Triple
    angle_deg: float
    std_deg: Positive
    over: SectionSpan = SectionSpan()


class SectionFile(MapPart, frozen=True):
    """Sections listed in a JSON file next to the input, as name -> {start, end} in rows.

    Keys:
        name: the name of the JSON file.
        static: the names of the sections at rest.
        turns: the known turn of each section that is a turn.
    """

    name: Annotated[str, msgspec.Meta(pattern=r"^[^/\\]+\.json$")]
    static: list[Name] = []
    turns: dict[str, MappedTurn] = {}


class StaticMask(MapPart, frozen=True):
    """Rests, marked by a column.

    Keys:
        key: the column.
        value: the value of the column during a rest.
        shortest_s: shorter rests are left out; in s.
    """

    key: Column
    value: float
    shortest_s: Positive = 1.0


class ImportMap(MapPart, frozen=True):
    """How to convert one kind of file to a recording.

    Keys:
        schema: the name and version of this document.
        board: the name of the board.
        sensor: the type of the sensor, for example MPU-6050.
        time: the times of the gyroscope.
        gyro: the columns of the gyroscope.
        table: how the input is written, if it is a text table with special lines.
        uid: the serial number of the board.
        model: the type of the board.
        source: the origin of the data, for readers of the recording.
        accel: the columns of the accelerometer.
        temperature: the column of the temperature.
        attitude: the columns of the reference attitudes.
        static: sections in which the board is at rest.
        static_mask: a column that marks the rests.
        turns: turns by known angles.
        sections: a JSON file with sections.
        gravity_m_s2: the gravity at the place of the measurement in m/s^2.
    """

    schema: Literal["gyrorig/import/1"]
    board: Name
    sensor: str
    time: TimeBase
    gyro: GyroColumns
    table: TableLayout | None = None
    uid: str = "unknown"
    model: str | None = None
    source: str | None = None
    accel: AccelColumns | None = None
    temperature: TemperatureColumn | None = None
    attitude: AttitudeColumns | None = None
    static: list[SectionSpan] = []
    static_mask: StaticMask | None = None
    turns: list[MappedTurn] = []
    sections: SectionFile | None = None
    gravity_m_s2: Positive | None = None
