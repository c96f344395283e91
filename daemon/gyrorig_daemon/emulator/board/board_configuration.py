"""Identity and configuration of the emulated firmware: HELLO, SET and ACK.

A SET takes effect with the sensor's next block, as when a FIFO is emptied first; ACK follows.
Values that the sensor does not support stay unchanged, and ACK contains the values in force.
"""

import hashlib
import zlib
from dataclasses import replace

from gyrorig_daemon.emulator.emulator_settings import BANDWIDTHS_HZ, BoardSettings
from gyrorig_daemon.emulator.physics.imu import ImuTruth
from gyrorig_daemon.emulator.rig_truth import (
    ACCEL_COUNTS_PER_G,
    DEG,
    GYRO_MDPS_PER_COUNT,
    mdps_per_count,
)
from gyrorig_protocol.board.json_frames import Ack, Hello, Sensor, Set

FIRMWARE = "1"  # short, because HELLO is one frame
_WHO_L3G4200D, _WHO_ADXL345, _ID_BMP085 = 0xD3, 0xE5, 0x55
_MAX_SIX_AXIS_SAMPLES, _MAX_THREE_AXIS_SAMPLES = 18, 39  # samples that fit into a frame


def hello_frame(settings: BoardSettings, boot: int) -> Hello:
    """Return HELLO after start number `boot`."""
    sensors = [
        Sensor(
            who=_WHO_L3G4200D,
            full_scale=_int_if_whole(settings.full_scale_dps),
            per_count=round(mdps_per_count(settings) * 1e-3, 6),
            rate_hz=_int_if_whole(settings.odr_hz),
            bandwidth_hz=_int_if_whole(settings.bandwidth_hz),
        )
    ]
    if settings.accel:
        sensors.append(Sensor(_WHO_ADXL345, 16, 1.0 / ACCEL_COUNTS_PER_G, unit="g"))
    sensors.append(Sensor(_ID_BMP085, 85, 0.1, unit="degC"))
    return Hello(
        protocol=1,
        fw=FIRMWARE,
        board="GY80",
        uid=hashlib.blake2b(settings.name.encode(), digest_size=4).hexdigest(),
        boot=boot,
        sensors=tuple(sensors),
        config=config_hash(settings),
    )


def config_hash(settings: BoardSettings) -> str:
    """Return a hash of the settings that SET can change."""
    values = (
        settings.odr_hz,
        settings.bandwidth_hz,
        settings.full_scale_dps,
        settings.batch,
        settings.accel,
    )
    return f"{zlib.crc32(repr(values).encode()):08x}"


def apply_set(settings: BoardSettings, requested: Set) -> BoardSettings:
    """Return the settings in force after a SET."""
    if requested.rate_hz in BANDWIDTHS_HZ:
        settings = replace(settings, odr_hz=float(requested.rate_hz))
    bandwidth = requested.bandwidth_hz or settings.bandwidth_hz
    bandwidths_hz = BANDWIDTHS_HZ.get(settings.odr_hz, (settings.bandwidth_hz,))
    settings = replace(
        settings, bandwidth_hz=min(bandwidths_hz, key=lambda hz: abs(hz - bandwidth))
    )
    if requested.full_scale_dps in GYRO_MDPS_PER_COUNT:
        settings = replace(settings, full_scale_dps=float(requested.full_scale_dps), count_mdps=0.0)
    if requested.accel is not None:
        settings = replace(settings, accel=requested.accel)
    max_samples = _MAX_SIX_AXIS_SAMPLES if settings.accel else _MAX_THREE_AXIS_SAMPLES
    return replace(settings, batch=min(requested.batch or settings.batch, max_samples))


def acknowledge(settings: BoardSettings) -> Ack:
    """Return ACK with the settings in force."""
    return Ack(
        config=config_hash(settings),
        rate_hz=settings.odr_hz,
        bandwidth_hz=settings.bandwidth_hz,
        full_scale_dps=settings.full_scale_dps,
        batch=settings.batch,
        accel=settings.accel,
    )


def reconfigure_imu(imu: ImuTruth, before: BoardSettings, after: BoardSettings) -> ImuTruth:
    """Return the same sensor with other settings: errors stay, rates and ranges change."""
    ratio = after.odr_hz / before.odr_hz
    return replace(
        imu,
        odr_hz=imu.odr_hz * ratio,
        tau_s=imu.tau_s / ratio,
        bandwidth_hz=after.bandwidth_hz,
        gyro_scale_rad_s=mdps_per_count(after) * 1e-3 * DEG,
        gyro_limit_rad_s=after.full_scale_dps * DEG,
    )


def _int_if_whole(number: float) -> float:
    """Return a whole number as an int, because HELLO must fit into a frame."""
    return int(number) if number == int(number) else number
