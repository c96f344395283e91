"""Metadata of a board in a recording: from its HELLO, then from the configuration.

Unknown values are left out, never guessed.
"""

import math

from gyrorig_daemon.config import BoardPort
from gyrorig_protocol.board import Hello
from gyrorig_protocol.board.json_frames import Sensor
from gyrorig_protocol.board_protocols import find_protocol
from gyrorig_protocol.errors import UsageError

STANDARD_GRAVITY_M_S2 = 9.80665  # CGPM 1901, resolution 2
_RAD_PER_DEG = math.pi / 180.0
_TO_RAD_S = {"dps": _RAD_PER_DEG, "rad/s": 1.0}
_TO_M_S2 = {"g": STANDARD_GRAVITY_M_S2, "m/s2": 1.0}
# WHO_AM_I register values; L3G4200D: ST Doc ID 17116
_SENSOR_NAMES = {0xD3: "L3G4200D"}


def board_metadata(config: BoardPort, hello: Hello | None) -> dict[str, str]:
    """Return the record `gyrorig.board.<id>` of a recording.

    Raises:
        UsageError: neither the board nor the configuration has a required value.
    """
    values: dict[str, str | float | int | None] = {"link": "can" if config.bus else "serial"}
    values |= _from_hello(hello) if hello is not None else _from_protocol(config)
    facts = config.facts
    for key in facts.__struct_fields__:
        if values.get(key) in (None, ""):
            values[key] = getattr(facts, key)
    for key in ("uid", "sensor", "gyro_scale_rad_s"):
        if not values.get(key):
            raise UsageError(
                f"board {config.id} does not report the value `{key}`, which a recording needs",
                f"add the key `{key}` under `facts` of the board in the rig file",
            )
    return {key: _text(value) for key, value in values.items() if value not in (None, "")}


def _from_hello(hello: Hello) -> dict[str, str | float | int | None]:
    gyro = next((s for s in hello.sensors if s.unit in _TO_RAD_S), None)
    accel = next((s for s in hello.sensors if s.unit in _TO_M_S2), None)
    thermometer = next((s for s in hello.sensors if s.unit == "degC"), None)
    values: dict[str, str | float | int | None] = {
        "uid": hello.uid,
        "model": hello.board,
        "firmware": hello.fw,
        "config_hash": hello.config,
        "tick_hz": hello.tick_hz,
        "counter_bits": 32,  # the width of a sample's timestamp in GCB1
    }
    if gyro is not None:
        to_rad_s = _TO_RAD_S[gyro.unit]
        values["sensor"] = _sensor_name(gyro)
        values["odr_hz"] = gyro.rate_hz
        values["bandwidth_hz"] = gyro.bandwidth_hz
        in_dps = gyro.unit == "dps"
        values["gyro_full_scale_dps"] = (
            gyro.full_scale if in_dps else gyro.full_scale / _RAD_PER_DEG
        )
        values["gyro_scale_rad_s"] = gyro.per_count * to_rad_s
    if accel is not None:
        values["accel_scale_m_s2"] = accel.per_count * _TO_M_S2[accel.unit]
    if thermometer is not None:
        values["temperature_scale_c"] = thermometer.per_count
    return values


def _from_protocol(config: BoardPort) -> dict[str, str | float | int | None]:
    protocol = find_protocol(config.format, bool(config.bus))
    return {"counter_bits": protocol.counter_bits, **protocol.scales(config)}


def _sensor_name(sensor: Sensor) -> str:
    if isinstance(sensor.who, str):
        return sensor.who
    return _SENSOR_NAMES.get(sensor.who, f"who-am-i {sensor.who:#04x}")


def _text(value: str | float | int | None) -> str:
    return value if isinstance(value, str) else repr(value)
