"""Logs of flight controllers, written as the descriptions of their formats define them.

What to use when: `write_ulog`, `write_dataflash` and `write_blackbox` for a session of
`handheld_session`. Nothing here is shared with the readers.
"""

import struct
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from tests.support.handheld_session import GRAVITY_M_S2, HandheldSession

ULOG_FORMATS = {
    "sensor_gyro": "uint64_t timestamp;uint64_t timestamp_sample;uint32_t device_id;float x;"
    "float y;float z;float temperature;uint32_t error_count;uint8_t[3] clip_counter;"
    "uint8_t samples;",
    "sensor_accel": "uint64_t timestamp;uint64_t timestamp_sample;uint32_t device_id;float x;"
    "float y;float z;float temperature;uint32_t error_count;uint8_t[3] clip_counter;"
    "uint8_t samples;",
    "sensor_combined": "uint64_t timestamp;float[3] gyro_rad;uint32_t gyro_integral_dt;"
    "int32_t accelerometer_timestamp_relative;float[3] accelerometer_m_s2;",
    "vehicle_imu": "uint64_t timestamp;uint64_t timestamp_sample;uint32_t accel_device_id;"
    "uint32_t gyro_device_id;float[3] delta_angle;float[3] delta_velocity;"
    "uint32_t delta_angle_dt;uint32_t delta_velocity_dt;",
    "vehicle_attitude": "uint64_t timestamp;uint64_t timestamp_sample;float[4] q;",
    "vehicle_mocap_odometry": "uint64_t timestamp;uint64_t timestamp_sample;float[3] position;"
    "float[4] q;",
    "battery_status": "uint64_t timestamp;float voltage_v;",
    "sensor_selection": "uint64_t timestamp;uint32_t accel_device_id;uint32_t gyro_device_id;",
}


def _ulog_message(kind: bytes, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), kind[0]) + body


def ulog_bytes(topics: Sequence[tuple[str, int, Callable[[int], bytes], int]]) -> bytes:
    """Return a ULog file: each topic has a name, an instance, a row's bytes, and a row count."""
    out = [b"\x55\x4c\x6f\x67\x01\x12\x35\x01" + struct.pack("<Q", 1000)]
    out.append(_ulog_message(b"B", bytes(40)))
    for name in dict.fromkeys(name for name, *_ in topics):
        out.append(_ulog_message(b"F", f"{name}:{ULOG_FORMATS[name]}".encode()))
    for number, (name, instance, _, _) in enumerate(topics):
        out.append(_ulog_message(b"A", struct.pack("<BH", instance, number) + name.encode()))
    for number, (_, _, row, count) in enumerate(topics):
        out += [_ulog_message(b"D", struct.pack("<H", number) + row(k)) for k in range(count)]
    return b"".join(out)


def _every_hundredth(row: Callable[[int], bytes]) -> Callable[[int], bytes]:
    return lambda k: row(100 * k)


def write_ulog(
    folder: Path,
    session: HandheldSession,
    names: Sequence[str] = ("sensor_gyro", "sensor_accel", "vehicle_attitude"),
    slow: Sequence[str] = (),
    device_ids: Sequence[int] = (2490378,),
    selected_ids: Sequence[int] = (2490378,),
) -> Path:
    """Write a log of PX4 with these topics; those in `slow` have only one row per second.

    Args:
        folder: of the log.
        session: the readings.
        names: the topics, "topic#2" for instance 2.
        slow: topics with one row per second.
        device_ids: of the instances of sensor_gyro, the last one also for later instances.
        selected_ids: of sensor_selection, in turn.
    """
    stamps = [5_000_000 + round(1e6 * value) for value in session.time_s.tolist()]
    rate, accel = session.rate_rad_s.tolist(), session.accel_m_s2.tolist()
    w = session.orientation_xyzw[:, [3, 0, 1, 2]].tolist()
    degc = session.temperature_degc.tolist()
    rows: dict[str, Callable[[int], bytes]] = {
        "sensor_accel": lambda k: struct.pack(
            "<QQI3ffI4B", stamps[k] + 310, stamps[k], 2490379, *accel[k], degc[k], 0, 0, 0, 0, 1
        ),
        "sensor_combined": lambda k: struct.pack(
            "<Q3fIi3f", stamps[k], *rate[k], 10_000, 0, *accel[k]
        ),
        "vehicle_imu": lambda k: struct.pack(
            "<QQII3f3fII", stamps[k] + 300, stamps[k], 1, 2, *(0.01 * value for value in rate[k]),
            *(0.01 * value for value in accel[k]), 10_000, 10_000,
        ),
        "vehicle_attitude": lambda k: struct.pack("<QQ4f", stamps[k], stamps[k], *w[k]),
        "vehicle_mocap_odometry": lambda k: struct.pack(
            "<QQ3f4f", stamps[k], stamps[k], 0.0, 0.0, 0.0, *w[k]
        ),
        "battery_status": lambda k: struct.pack("<Qf", stamps[k], 16.0),
        "sensor_selection": lambda k: struct.pack(
            "<QII", stamps[k], 2490379, selected_ids[k % len(selected_ids)]
        ),
    }  # fmt: skip

    def gyro_row(device_id: int) -> Callable[[int], bytes]:
        return lambda k: struct.pack(
            "<QQI3ffI4B", stamps[k] + 300, stamps[k], device_id, *rate[k], degc[k], 0, 0, 0, 0, 1
        )

    topics: list[tuple[str, int, Callable[[int], bytes], int]] = []
    for name in names:
        base, _, instance = name.partition("#")
        rows["sensor_gyro"] = gyro_row(device_ids[min(int(instance or 0), len(device_ids) - 1)])
        if base in slow:
            every = len(stamps) // 100
            topics.append((base, int(instance or 0), _every_hundredth(rows[base]), every))
        else:
            topics.append((base, int(instance or 0), rows[base], len(stamps)))
    path = folder / "log_12_2023-10-28.ulg"
    path.write_bytes(ulog_bytes(topics))
    return path


DATAFLASH_TYPES = {
    "GYR": (150, "QBQfff", "TimeUS,I,SampleUS,GyrX,GyrY,GyrZ", "<QBQfff"),
    "ACC": (151, "QBQfff", "TimeUS,I,SampleUS,AccX,AccY,AccZ", "<QBQfff"),
    "IMU": (
        152, "QBffffffIIfBBHH",
        "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH,GHz,AHz", "<QBffffffIIfBBHH",
    ),
    "IMT": (
        153, "QBfffffffff", "TimeUS,I,DelT,DelvT,DelaT,DelAX,DelAY,DelAZ,DelVX,DelVY,DelVZ",
        "<QBfffffffff",
    ),
    "XKQ": (154, "QBffff", "TimeUS,C,Q1,Q2,Q3,Q4", "<QBffff"),
    "BAT": (155, "Qfc", "TimeUS,Volt,Curr", "<Qfh"),
    "GYR2": (156, "QQfff", "TimeUS,SampleUS,GyrX,GyrY,GyrZ", "<QQfff"),
}  # fmt: skip


def dataflash_message(name: str, *values: float | int) -> bytes:
    """Return one message of a DataFlash log."""
    kind, _, _, layout = DATAFLASH_TYPES[name]
    return b"\xa3\x95" + bytes([kind]) + struct.pack(layout, *values)


def dataflash_head(names: Sequence[str]) -> bytes:
    """Return the FMT messages of these types, and of FMT itself."""
    out = [(128, 89, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")]
    for name in names:
        kind, text, columns, layout = DATAFLASH_TYPES[name]
        out.append((kind, 3 + struct.calcsize(layout), name, text, columns))
    return b"".join(
        b"\xa3\x95\x80"
        + struct.pack("<BB4s16s64s", kind, size, name.encode(), text.encode(), columns.encode())
        for kind, size, name, text, columns in out
    )


def write_dataflash(
    folder: Path, session: HandheldSession, names: Sequence[str] = ("GYR", "ACC", "IMU", "XKQ")
) -> Path:
    """Write a log of ArduPilot with these types; IMU has every fourth row only."""
    out = [dataflash_head(names)]
    rows = zip(
        session.time_s.tolist(), session.rate_rad_s.tolist(), session.accel_m_s2.tolist(),
        session.temperature_degc.tolist(), session.orientation_xyzw.tolist(), strict=True,
    )  # fmt: skip
    for k, (t, rate, accel, degc, w) in enumerate(rows):
        us = 5_000_000 + round(1e6 * t)
        if "GYR" in names:
            out.append(dataflash_message("GYR", us + 500, 0, us, *rate))
        if "GYR2" in names:
            out.append(dataflash_message("GYR2", us + 500, us, *rate))
        if "ACC" in names:
            out.append(dataflash_message("ACC", us + 510, 0, us, *accel))
        if "IMT" in names:
            delta = [0.01 * value for value in rate]
            out.append(dataflash_message("IMT", us, 0, 0.01, 0.01, 0.01, *delta, 0.0, 0.0, 0.0))
        if "IMU" in names and k % 4 == 0:
            rest = (0, 0, degc, 1, 1, 1000, 1000)
            out.append(dataflash_message("IMU", us, 0, *rate, *accel, *rest))
        if "XKQ" in names:
            out.append(dataflash_message("XKQ", us, 0, w[3], *w[:3]))
        if "BAT" in names:
            out.append(dataflash_message("BAT", us, 16.0, 250))
    path = folder / "00000012.BIN"
    path.write_bytes(b"".join(out))
    return path


def _zigzag(value: int) -> bytes:
    return _unsigned((value << 1) ^ (value >> 31) if value >= 0 else ((-value) << 1) - 1)


def _unsigned(value: int) -> bytes:
    out = bytearray()
    while value > 127:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def _tag2_3s32(values: Sequence[int]) -> bytes:
    if all(-2 <= value < 2 for value in values):
        return bytes(
            [sum((value & 3) << shift for value, shift in zip(values, (4, 2, 0), strict=True))]
        )
    if all(-8 <= value < 8 for value in values):
        return bytes([0x40 | values[0] & 15, (values[1] & 15) << 4 | values[2] & 15])
    if all(-32 <= value < 32 for value in values):
        return bytes([0x80 | values[0] & 63, values[1] & 63, values[2] & 63])
    lead, body = 0xC0, b""
    for index, value in enumerate(values):
        size = next(n for n in (1, 2, 3, 4) if -(1 << 8 * n - 1) <= value < 1 << 8 * n - 1)
        lead |= (size - 1) << 2 * index
        body += (value & (1 << 8 * size) - 1).to_bytes(size, "little")
    return bytes([lead]) + body


def _tag8_8svb(values: Sequence[int]) -> bytes:
    tag = sum(1 << index for index, value in enumerate(values) if value)
    return bytes([tag]) + b"".join(_zigzag(value) for value in values if value)


BLACKBOX_NAMES = (
    "loopIteration", "time", "axisP[0]", "axisP[1]", "axisP[2]", "gyroADC[0]", "gyroADC[1]",
    "gyroADC[2]", "accSmooth[0]", "accSmooth[1]", "accSmooth[2]", "motor[0]", "motor[1]",
)  # fmt: skip
BLACKBOX_SCALE_DPS = 0.1


def blackbox_session(session: HandheldSession, high_resolution: bool = True) -> bytes:
    """Return one session of Betaflight's blackbox with an I frame every 32 frames."""
    names = ",".join(BLACKBOX_NAMES)
    head = [
        "H Product:Blackbox flight data recorder by Nicholas Sherwood",
        "H Data version:2",
        "H I interval:32",
        "H P interval:1/1",
        "H Firmware type:Cleanflight",
        "H Firmware revision:Betaflight 4.4.0 (abc) STM32F7X2",
        "H Board information:MAMB MAMBAF722_I2C",
        f"H Field I name:{names}",
        "H Field I signed:0,0,1,1,1,1,1,1,1,1,1,0,0",
        "H Field I predictor:0,0,0,0,0,0,0,0,0,0,0,4,5",
        "H Field I encoding:1,1,0,0,0,0,0,0,0,0,0,1,0",
        "H Field P predictor:6,2,1,1,1,1,1,1,3,3,3,3,3",
        "H Field P encoding:9,0,7,7,7,0,0,0,6,6,6,6,6",
        "H Field S name:flightModeFlags,stateFlags",
        "H Field S signed:0,0",
        "H Field S predictor:0,0",
        "H Field S encoding:1,1",
        "H minthrottle:1070",
        "H gyro_scale:0x3f800000",
        "H acc_1G:2048",
        f"H blackbox_high_resolution:{int(high_resolution)}",
    ]
    scale = 10.0 if high_resolution else 1.0
    gyro = np.rint(np.degrees(session.rate_rad_s) * scale).astype(int)
    accel = np.rint(session.accel_m_s2 / GRAVITY_M_S2 * 2048).astype(int)
    rng = np.random.default_rng(5)
    terms = rng.integers(-40_000, 40_000, size=gyro.shape) // rng.integers(1, 3000, gyro.shape)
    motor = rng.integers(1100, 1900, size=(len(gyro), 2))
    frames: list[list[int]] = [
        [k, 7_000_000 + round(1e6 * t), *terms[k].tolist(), *gyro[k].tolist(), *accel[k].tolist(),
         *motor[k].tolist()]
        for k, t in enumerate(session.time_s.tolist())
    ]  # fmt: skip
    out = ["\n".join([*head, ""]).encode(), b"S" + _unsigned(5) + _unsigned(2)]
    before: list[int] = []
    last: list[int] = []
    for k, row in enumerate(frames):
        if k % 32 == 0:
            body = _unsigned(row[0]) + _unsigned(row[1]) + b"".join(map(_zigzag, row[2:11]))
            out.append(b"I" + body + _unsigned(row[11] - 1070) + _zigzag(row[12] - row[11]))
            before = last = row
            continue
        steps = [value - previous for value, previous in zip(row, last, strict=True)]
        means = [int((a + b) / 2) for a, b in zip(last, before, strict=True)]
        out.append(
            b"P" + _zigzag(row[1] - 2 * last[1] + before[1]) + _tag2_3s32(steps[2:5])
            + b"".join(map(_zigzag, steps[5:8]))
            + _tag8_8svb([value - mean for value, mean in zip(row[8:], means[8:], strict=True)])
        )  # fmt: skip
        before, last = last, row
    return b"".join([*out, b"E\xffEnd of log\0"])


def write_blackbox(folder: Path, session: HandheldSession) -> Path:
    """Write a log with a short first session and the whole second one."""
    arrays = (
        "time_s", "rate_rad_s", "accel_m_s2", "orientation_xyzw", "temperature_degc"
    )  # fmt: skip
    short = replace(session, **{name: getattr(session, name)[:500] for name in arrays})
    path = folder / "btfl_001.bbl"
    path.write_bytes(blackbox_session(short) + blackbox_session(session))
    return path
