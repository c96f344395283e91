"""What the emulated firmware says of itself, and what it makes of a SET.

A SET takes effect at the sensor's next block, as when a FIFO is drained first; ACK comes
after that. What the sensor cannot do stays as it is, and ACK says what is in force.
"""

import hashlib
import zlib
from dataclasses import replace

from gyrorig_daemon.emulator.physics.imu import ImuTruth
from gyrorig_daemon.emulator.settings import BANDWIDTHS_HZ, BoardSettings
from gyrorig_daemon.emulator.truth import ACCEL_COUNTS_PER_G, DEG, GYRO_MDPS
from gyrorig_protocol.board.hello import Ack, Hello, Sensor, Set

FIRMWARE = "1"  # short: HELLO is one frame
_WHO_L3G4200D, _WHO_ADXL345, _ID_BMP085 = 0xD3, 0xE5, 0x55
_MOST_SIX_AXIS, _MOST_THREE_AXIS = 18, 39  # samples that fit into a frame


def hello(settings: BoardSettings, boot: int) -> Hello:
    """Return HELLO after start number `boot`."""
    sensors = [
        Sensor(
            who=_WHO_L3G4200D,
            full_scale=_short(settings.full_scale_dps),
            per_count=round(GYRO_MDPS[settings.full_scale_dps] * 1e-3, 6),
            rate_hz=_short(settings.odr_hz),
            bandwidth_hz=_short(settings.bandwidth_hz),
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
    """Return a hash of what SET can change."""
    parts = (
        settings.odr_hz,
        settings.bandwidth_hz,
        settings.full_scale_dps,
        settings.batch,
        settings.accel,
    )
    return f"{zlib.crc32(repr(parts).encode()):08x}"


def effective(settings: BoardSettings, wanted: Set) -> BoardSettings:
    """Return the settings in force after a SET."""
    if wanted.rate_hz in BANDWIDTHS_HZ:
        settings = replace(settings, odr_hz=float(wanted.rate_hz))
    bandwidth = wanted.bandwidth_hz or settings.bandwidth_hz
    known = BANDWIDTHS_HZ.get(settings.odr_hz, (settings.bandwidth_hz,))
    settings = replace(settings, bandwidth_hz=min(known, key=lambda hz: abs(hz - bandwidth)))
    if wanted.full_scale_dps in GYRO_MDPS:
        settings = replace(settings, full_scale_dps=float(wanted.full_scale_dps))
    if wanted.accel is not None:
        settings = replace(settings, accel=wanted.accel)
    most = _MOST_SIX_AXIS if settings.accel else _MOST_THREE_AXIS
    return replace(settings, batch=min(wanted.batch or settings.batch, most))


def acknowledgement(settings: BoardSettings) -> Ack:
    """Return ACK with the settings in force."""
    return Ack(
        config=config_hash(settings),
        rate_hz=settings.odr_hz,
        bandwidth_hz=settings.bandwidth_hz,
        full_scale_dps=settings.full_scale_dps,
        batch=settings.batch,
        accel=settings.accel,
    )


def reconfigured(imu: ImuTruth, before: BoardSettings, after: BoardSettings) -> ImuTruth:
    """Return the same sensor under other settings: errors stay, rates and ranges change."""
    ratio = after.odr_hz / before.odr_hz
    return replace(
        imu,
        odr_hz=imu.odr_hz * ratio,
        tau_s=imu.tau_s / ratio,
        bandwidth_hz=after.bandwidth_hz,
        gyro_scale_rad_s=GYRO_MDPS[after.full_scale_dps] * 1e-3 * DEG,
        gyro_limit_rad_s=after.full_scale_dps * DEG,
    )


def _short(number: float) -> float:
    """Return a whole number as an int: HELLO has to fit into a frame."""
    return int(number) if number == int(number) else number
