"""Firmware that prints one JSON object per sample, with the keys that the rig file gives."""

import msgspec

from gyrorig_daemon.emulator.board.emulated_protocol import EmulatedProtocol
from gyrorig_daemon.emulator.emulator_settings import BoardSettings
from gyrorig_daemon.emulator.rig_truth import DEG, mdps_per_count
from gyrorig_protocol.board import BoardFrame, Sample
from gyrorig_protocol.board_protocols.json_lines import JsonOptions

_GYRO_PER_MDPS = {"dps": 1e-3, "mdps": 1.0, "rad/s": 1e-3 * DEG}
_TIME_PER_US = {"s": 1e-6, "ms": 1e-3, "us": 1, "ns": 1000}


class EmulatedJson(EmulatedProtocol):
    """Sends samples only; rates have as many decimals as a double."""

    name = "json"

    def encode(self, frame: BoardFrame, settings: BoardSettings) -> bytes:
        """Return a line."""
        if not isinstance(frame, Sample):
            return b""
        options = msgspec.convert(dict(settings.options), JsonOptions)
        factor = _GYRO_PER_MDPS.get(options.gyro_unit)
        gyro: list[float] = list(frame.gyro)
        if factor is not None:
            gyro = [n * mdps_per_count(settings) * factor for n in gyro]
        values = {
            options.time_key: (frame.device_time or 0) * _TIME_PER_US[options.time_unit],
            options.sequence_key: frame.sequence,
            options.gyro_key: gyro,
            options.accel_key: frame.accel,
            options.temperature_key: frame.temperature,
        }
        line = {key: value for key, value in values.items() if key and value is not None}
        return msgspec.json.encode(line) + b"\r\n"


PROTOCOL = EmulatedJson()
