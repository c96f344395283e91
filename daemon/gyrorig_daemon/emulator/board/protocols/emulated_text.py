"""Firmware that prints lines of numbers, in the columns that the rig file gives."""

from gyrorig_daemon.emulator.board.emulated_protocol import EmulatedProtocol
from gyrorig_daemon.emulator.emulator_settings import BoardSettings
from gyrorig_daemon.emulator.rig_truth import ACCEL_COUNTS_PER_G, DEG, mdps_per_count
from gyrorig_protocol.board import BoardFrame, ColumnMap, Sample

_GYRO_PER_MDPS = {"dps": 1e-3, "mdps": 1.0, "rad/s": 1e-3 * DEG}
_ACCEL_PER_G = {"g": 1.0, "mg": 1e3, "m/s2": 9.80665}
_TIME_PER_US = {"s": 1e-6, "ms": 1e-3, "us": 1, "ns": 1000, "ticks": 1}


class EmulatedText(EmulatedProtocol):
    """Sends samples only."""

    name = "text"

    def encode(self, frame: BoardFrame, settings: BoardSettings) -> bytes:
        """Return a line."""
        if not isinstance(frame, Sample):
            return b""
        if settings.columns is not None:
            return _columns_line(frame, settings, settings.columns)
        numbers = [*frame.gyro, *(frame.accel or ())]
        if settings.text_time:
            numbers.insert(0, frame.device_time or 0)
        if settings.text_temperature:
            numbers.append(frame.temperature or 0)
        return (settings.text_separator.join(map(str, numbers)) + "\r\n").encode()


PROTOCOL = EmulatedText()


def _columns_line(sample: Sample, settings: BoardSettings, columns: ColumnMap) -> bytes:
    """Return a line in the columns of a rig file; other columns contain 0."""
    fields = ["0"] * (columns.columns or columns.min_columns)
    per_count = mdps_per_count(settings)
    gyro_factor = _GYRO_PER_MDPS.get(columns.gyro_unit)
    for column, count in zip(columns.gyro, sample.gyro, strict=True):
        physical = None if gyro_factor is None else count * per_count * gyro_factor
        fields[column] = str(count) if physical is None else f"{physical:.7f}"
    if columns.accel is not None and sample.accel is not None:
        accel_factor = _ACCEL_PER_G.get(columns.accel_unit)
        for column, count in zip(columns.accel, sample.accel, strict=True):
            physical = None if accel_factor is None else count / ACCEL_COUNTS_PER_G * accel_factor
            fields[column] = str(count) if physical is None else f"{physical:.6f}"
    if columns.time is not None:
        time = (sample.device_time or 0) * _TIME_PER_US[columns.time_unit]
        fields[columns.time] = str(time) if isinstance(time, int) else f"{time:.6f}"
    if columns.sequence is not None:
        fields[columns.sequence] = str(sample.sequence)
    if columns.temperature is not None:
        count = sample.temperature or 0  # in 0.1 degC
        in_degc = columns.temperature_unit == "degC"
        fields[columns.temperature] = f"{0.1 * count:.1f}" if in_degc else str(count)
    return ((columns.separator or ",").join(fields) + "\r\n").encode()
