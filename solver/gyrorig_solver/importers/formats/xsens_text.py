"""Text exports of Xsens MT Manager: a table after header lines that begin with `//`.

Source: exports of MT Manager 4.x and 2022.2: the header contains `// Start Time` or
`//  MT Manager version`, and `// Update Rate: 100.0Hz` in older versions. The columns are
`PacketCounter` (16 bits), `SampleTimeFine` (10 kHz), `Gyr_X` in rad/s, `Acc_X` in m/s^2,
`OriInc_q0` to `OriInc_q3` (the delta_q of the strapdown integration), `Quat_q0` to `Quat_q3`,
`Mat[1][1]`, `Temperature`. Xsens: MT Manager User Manual (MT0216P) and MTi Family Reference Manual
(MT1600P): delta_q is the exact rotation between two packets.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.importers.map_keys import TableLayout
from gyrorig_solver.importers.measured_streams import (
    AccelStream,
    GyroStream,
    MeasuredBoard,
    MeasuredStreams,
    PoseStream,
    TemperatureStream,
)
from gyrorig_solver.importers.measurement_columns import MeasurementColumns, open_columns
from gyrorig_solver.importers.measurement_format import (
    BOARD_OPTIONS,
    FormatMatch,
    ImportOptions,
    read_head,
)

_HEAD_BYTES = 20_000
_TICK_S = 1e-4  # SampleTimeFine
_COUNTER = 1 << 16
_FINE_COUNTER = 1 << 32
_RATE = re.compile(r"//\s*(?:Update Rate|Sample rate|Output rate)\s*:\s*([0-9.]+)\s*Hz", re.I)
_DEVICE = re.compile(r"//\s*(?:DeviceId|Device ID)\s*:\s*([0-9A-Fa-f]{6,16})", re.I)
_PRODUCT = re.compile(r"//\s*ProductCode\s*:\s*([\w-]{1,40})", re.I)
_GYRO = ["Gyr_X", "Gyr_Y", "Gyr_Z"]
_DELTA = ["OriInc_q1", "OriInc_q2", "OriInc_q3", "OriInc_q0"]
_ACCEL = ["Acc_X", "Acc_Y", "Acc_Z"]
_QUATERNION = ["Quat_q1", "Quat_q2", "Quat_q3", "Quat_q0"]


@dataclass(frozen=True, slots=True)
class XsensText:
    """One device of an export of MT Manager."""

    name: str = "xsens"
    title: str = "text export of Xsens MT Manager"
    extra: str = ""
    used_options: frozenset[str] = BOARD_OPTIONS | {"topics"}

    def detect(self, source: Path) -> FormatMatch | None:
        """Return a match for `//` lines and a line with the column PacketCounter."""
        head = read_head(source, _HEAD_BYTES)
        if not head.startswith(b"//") or b"PacketCounter" not in head:
            return None
        return FormatMatch("a text export of Xsens MT Manager")

    def read(self, source: Path, options: ImportOptions) -> MeasuredStreams:
        """Return rates, or rates from delta_q; `--topic Quat` uses the sensor's own attitude."""
        options.check_topics(("Quat",))
        head = read_head(source, _HEAD_BYTES).decode("utf-8", errors="replace")
        lines = [line for line in head.splitlines() if not line.startswith("//")]
        layout = _layout(lines[0] if lines else "")
        names = [name.strip() for name in re.split(r"[\t;,]", lines[0])] if lines else []
        rates = "rates" if all(key in names for key in _GYRO) else "delta_q"
        keys = _GYRO if rates == "rates" else _DELTA
        if not all(key in names for key in keys):
            listed = ", ".join(names)[:200]
            raise InputError(
                f"the export {source.name} has neither the columns Gyr_X to Gyr_Z nor OriInc_q0 "
                f"to OriInc_q3, but only {listed}",
                "select rate of turn or delta_q in the export settings of MT Manager",
            )
        wanted = [
            key
            for key in (*keys, *_ACCEL, *_QUATERNION, "PacketCounter", "SampleTimeFine",
                        "Temperature")
            if key in names
        ]  # fmt: skip
        columns = open_columns(source, wanted, layout)
        time_s, rate_hz, notes = _times(columns, wanted, head, source)
        number = _numbers(columns, wanted, time_s)
        values = columns.matrix(keys, len(keys))
        if rates == "delta_q":
            values = _rates_of_delta_q(values, _period_s(time_s, number))
        accel = None
        if all(key in names for key in _ACCEL):
            accel = AccelStream(columns.matrix(_ACCEL, 3))
        temperature = None
        if "Temperature" in names:
            temperature = TemperatureStream(columns.matrix(["Temperature"], 1)[:, 0])
        device, product = _DEVICE.search(head), _PRODUCT.search(head)
        board = MeasuredBoard(
            options.board or (device[1] if device else "XSENS"),
            GyroStream(time_s, values, rate_hz=rate_hz, number=number),
            accel,
            temperature,
            {
                "sensor": options.sensor or "unknown",
                "uid": device[1] if device else "unknown",
                "model": product[1] if product else "Xsens",
            },
        )
        poses, more = _poses(columns, names, time_s, options)
        return MeasuredStreams(
            f"imported from {source.name}: {rates} of an Xsens export",
            (board,),
            poses=poses,
            notes=(*notes, *more),
        )


def _layout(header: str) -> TableLayout:
    delimiter = "tab" if "\t" in header else "semicolon" if ";" in header else "comma"
    return TableLayout(comment="//", delimiter=delimiter)  # type: ignore[arg-type] # one of three


def _times(
    columns: MeasurementColumns, wanted: list[str], head: str, source: Path
) -> tuple[FloatArray, float | None, list[str]]:
    """Return the device's times in s, the nominal rate if the header gives it, and notes.

    Raises:
        InputError: neither the table nor the header gives the times.
    """
    rate = _RATE.search(head)
    rate_hz = float(rate[1]) if rate and 0.1 <= float(rate[1]) <= 10_000.0 else None
    if "SampleTimeFine" in wanted:
        ticks = columns.matrix(["SampleTimeFine"], 1)[:, 0]
        if np.all(np.isfinite(ticks)) and ticks.size > 1:
            time_s = _unwrap(ticks, _FINE_COUNTER) * _TICK_S
            _check_rate(_period_s(time_s, _numbers(columns, wanted, time_s)), rate_hz, source)
            return time_s, rate_hz, []
    if "PacketCounter" in wanted and rate_hz is not None:
        counter = columns.matrix(["PacketCounter"], 1)[:, 0]
        if np.all(np.isfinite(counter)):
            steps = _unwrap(counter, _COUNTER)
            lost = int(steps[-1] - steps[0]) + 1 - steps.size
            notes = ["the times are those of PacketCounter and the update rate of the header"]
            notes += [f"{lost} packets are missing"] if lost else []
            return steps / rate_hz, rate_hz, notes
    raise InputError(
        f"the export {source.name} has no times: SampleTimeFine is empty, and the header has no "
        "update rate",
        "export again with SampleTimeFine, or use the format csv with a column map and `rate_hz`",
    )


def _numbers(columns: MeasurementColumns, wanted: list[str], time_s: FloatArray) -> IntArray | None:
    """Return the numbers of the packets; None without a counter that counts every packet.

    The times show how often the counter of 16 bits overflowed in a gap.
    """
    if "PacketCounter" not in wanted or time_s.size < 2:
        return None
    counter = columns.matrix(["PacketCounter"], 1)[:, 0]
    if not np.all(np.isfinite(counter)):
        return None
    steps = np.mod(np.diff(counter), _COUNTER)
    step_s = np.diff(time_s)
    if np.min(steps) != 1.0:
        return None
    expected = step_s / float(np.median(step_s / steps))
    steps += _COUNTER * np.maximum(np.rint((expected - steps) / _COUNTER), 0.0)
    return np.concatenate([[0], np.cumsum(steps)]).astype(np.int64)


def _period_s(time_s: FloatArray, number: IntArray | None) -> float:
    """Return the time of one packet; missing packets do not change it if they are counted."""
    steps = 1 if number is None else np.diff(number)
    return float(np.median(np.diff(time_s) / steps))


def _check_rate(step_s: float, rate_hz: float | None, source: Path) -> None:
    if rate_hz is not None and not 0.9 < step_s * rate_hz < 1.1:
        raise InputError(
            f"in the export {source.name}, SampleTimeFine in units of 0.1 ms gives steps of "
            f"{1e3 * step_s:.4g} ms, but the update rate is {rate_hz:g} Hz",
            "use the format csv with a column map that gives the unit of the times",
        )


def _unwrap(counter: FloatArray, size: int) -> FloatArray:
    """Return a counter that overflows as one that increases, from its first value."""
    steps = np.mod(np.diff(counter), size)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _rates_of_delta_q(delta_xyzw: FloatArray, step_s: float) -> FloatArray:
    """Return the mean rate of each step in rad/s from its rotation, shape (n, 3)."""
    vector, scalar = delta_xyzw[:, :3], delta_xyzw[:, 3]
    sign = np.where(scalar < 0.0, -1.0, 1.0)
    length = np.linalg.norm(vector, axis=1)
    angle = 2.0 * np.arctan2(length, np.abs(scalar))
    factor = np.where(length > 0.0, angle / np.where(length > 0.0, length, 1.0), 2.0)
    return np.asarray(vector * (sign * factor / step_s)[:, None], dtype=np.float64)


def _poses(
    columns: MeasurementColumns, names: list[str], time_s: FloatArray, options: ImportOptions
) -> tuple[PoseStream | None, list[str]]:
    if not all(key in names for key in _QUATERNION):
        return None, []
    if "Quat" not in options.topics:
        return None, [
            "Quat_q0 to Quat_q3 are not used as a reference, because the device computes them "
            "from the same gyroscope (--topic Quat uses them)"
        ]
    poses = PoseStream.of_rows(time_s, columns.matrix(_QUATERNION, 4))
    return poses, ["the reference is the device's own attitude, computed from the same gyroscope"]


FORMAT = XsensText()
