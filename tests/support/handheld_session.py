"""A board turned by hand between rests, as the loggers of phones, flights and sensors write it.

What to use when: `simulate_session` for the true motion and the readings; the functions
`write_...` for a file of each phone or sensor (`flight_log_writers` has flight controllers). Each
writer follows the published description of its format and shares nothing with the reader.
"""

import json
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from gyrorig_solver.data import FloatArray

GAIN = np.array([[1.021, 0.013, -0.006], [-0.009, 0.984, 0.017], [0.004, -0.011, 1.008]])
BIAS_RAD_S = np.array([0.011, -0.024, 0.006])
GRAVITY_M_S2 = 9.80665
START_NS = 1_698_501_144_401_773_000  # Unix time of a phone


@dataclass(frozen=True, slots=True, eq=False)
class HandheldSession:
    """The readings of one board, and the truth."""

    time_s: FloatArray  # (n,), from 0
    rate_rad_s: FloatArray  # (n, 3), measured
    accel_m_s2: FloatArray  # (n, 3)
    orientation_xyzw: FloatArray  # (n, 4), true attitude, body to world
    temperature_degc: FloatArray  # (n,)
    gain: FloatArray
    bias_rad_s: FloatArray


def simulate_session(seed: int, moves: int = 24, gain: FloatArray = GAIN) -> HandheldSession:
    """Return rests of 3 s with smooth turns of 2 s by about a radian between them, at 100 Hz."""
    rng = np.random.default_rng(seed)
    attitude = Rotation.random(rng=rng)
    rates, attitudes = [np.zeros((1200, 3))], [np.tile(attitude.as_quat(), (1200, 1))]
    phase = np.arange(200) / 200.0
    for _ in range(moves):
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        size = rng.uniform(0.7, 1.6) * rng.choice([-1.0, 1.0])
        angle = size * (phase - np.sin(2 * np.pi * phase) / (2 * np.pi))
        rates.append((size / 2.0 * (1.0 - np.cos(2 * np.pi * phase)))[:, None] * axis)
        attitudes.append((attitude * Rotation.from_rotvec(angle[:, None] * axis)).as_quat())
        attitude = attitude * Rotation.from_rotvec(size * axis)
        rates.append(np.zeros((300, 3)))
        attitudes.append(np.tile(attitude.as_quat(), (300, 1)))
    rate, orientation = np.concatenate(rates), np.concatenate(attitudes)
    force = GRAVITY_M_S2 * Rotation.from_quat(orientation).inv().apply([0.0, 0.0, 1.0])
    shake = np.where(np.linalg.norm(rate, axis=1) > 0.0, 0.4, 0.01)[:, None]
    return HandheldSession(
        time_s=np.arange(len(rate)) / 100.0,
        rate_rad_s=rate @ gain.T + BIAS_RAD_S + rng.normal(size=rate.shape) * 3e-3,
        accel_m_s2=force + rng.normal(size=force.shape) * shake,
        orientation_xyzw=orientation,
        temperature_degc=np.asarray(25.0 + 1e-4 * np.arange(len(rate)), dtype=np.float64),
        gain=gain,
        bias_rad_s=BIAS_RAD_S,
    )


def table(header: str, columns: Sequence[FloatArray | list[str]], delimiter: str = ",") -> str:
    """Return a text table; numbers with the digits that give them back."""
    texts = [part if isinstance(part, list) else map(repr, part.tolist()) for part in columns]
    rows = zip(*texts, strict=True)
    return "\n".join([header, *(delimiter.join(row) for row in rows), ""])


def write_sensor_logger(folder: Path, session: HandheldSession) -> Path:
    """Write the zip of Sensor Logger on Android, with all tables that matter here."""
    first_s = -0.0137  # the first samples are from before the start
    elapsed = session.time_s + first_s
    time = [str(START_NS + round(1e9 * value)) for value in elapsed.tolist()]

    def sensor(values: FloatArray) -> str:
        x, y, z = values.T
        return table("time,seconds_elapsed,z,y,x", [time, elapsed, z, y, x])

    corrected = session.rate_rad_s - session.bias_rad_s
    w = session.orientation_xyzw
    zeros = np.zeros(len(w))
    orientation: list[FloatArray | list[str]] = [
        time,
        elapsed,
        zeros,
        w[:, 0],
        w[:, 2],
        zeros,
        w[:, 3],
        zeros,
        w[:, 1],
    ]
    path = folder / "2023-10-28_13-52-24.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as out:
        out.writestr("GyroscopeUncalibrated.csv", sensor(session.rate_rad_s))
        out.writestr("Gyroscope.csv", sensor(corrected))
        out.writestr("TotalAcceleration.csv", sensor(session.accel_m_s2))
        out.writestr("Accelerometer.csv", sensor(np.zeros_like(session.accel_m_s2)))
        out.writestr(
            "Orientation.csv",
            table("time,seconds_elapsed,yaw,qx,qz,roll,qw,pitch,qy", orientation),
        )
        out.writestr(
            "Metadata.csv",
            "version,device name,recording epoch time,recording time,recording timezone,platform,"
            "appVersion,device id,sensors,sampleRateMs,standardisation,platform version\n"
            f"3,Pixel 6a,{START_NS // 1_000_000},2023-10-28_13-52-24,Europe/London,android,1.30,"
            'x,"GyroscopeUncalibrated|Gyroscope",10,false,14\n',
        )
    return path


def write_phyphox(folder: Path, session: HandheldSession, delimiter: str = ",") -> Path:
    """Write phyphox's zip, with a pause in a rest, in which the experiment's time stands still.

    With the delimiter ";" or a tab the numbers have decimal commas, in all tables.
    """
    cut = 700  # in the first rest: 7 s
    pause_s = 4.5
    time_s = session.time_s
    shift_s = np.where(time_s < time_s[cut], 0.0, 0.001)

    def sensor(name: str, unit: str, values: FloatArray) -> str:
        labels = ["Time (s)", *(f"{name} {axis} ({unit})" for axis in "xyz")]
        header = delimiter.join(f'"{label}"' for label in labels)
        text = table(header, [time_s + shift_s, *values.T], delimiter)
        return text.replace(".", ",") if delimiter != "," else text

    def cells(*values: str | float) -> str:
        texts = [f'"{v}"' if isinstance(v, str) else f"{v:.3f}" for v in values]
        return delimiter.join(t if delimiter == "," else t.replace(".", ",") for t in texts) + "\n"

    first_s = START_NS * 1e-9
    end_s = float(time_s[-1]) + 0.01
    paused_s = float(time_s[cut])
    path = folder / "Gyroscope and acceleration 2023-10-28 13-52-24.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as out:
        out.writestr("Gyroscope.csv", sensor("Gyroscope", "rad/s", session.rate_rad_s))
        out.writestr("Accelerometer.csv", sensor("Acceleration", "m/s^2", session.accel_m_s2))
        out.writestr(
            "meta/device.csv", cells("property", "value") + cells("deviceModel", "Pixel 6a")
        )
        out.writestr(
            "meta/time.csv",
            cells("event", "experiment time", "system time", "system time text")
            + cells("START", 0.0, first_s, "2023-10-28 13:52:24.402 UTC+01:00")
            + cells("PAUSE", paused_s, first_s + paused_s, "-")
            + cells("START", paused_s, first_s + paused_s + pause_s, "-")
            + cells("PAUSE", end_s, first_s + end_s + pause_s, "-"),
        )
    return path


def write_ximu3(folder: Path, session: HandheldSession) -> Path:
    """Write the folder of an x-IMU3, with six digits as its software writes."""
    path = folder / "x-IMU3 - F7E4-5410-EC7B-D7E7 (USB)"
    path.mkdir()
    stamps = [str(34_298_397 + round(1e6 * value)) for value in session.time_s.tolist()]

    def six(values: FloatArray) -> list[list[str]]:
        return [[f"{value:.6f}" for value in column] for column in values.T.tolist()]

    axes = "XYZ"
    gyro = ",".join(f"Gyroscope {axis} (deg/s)" for axis in axes)
    accel = ",".join(f"Accelerometer {axis} (g)" for axis in axes)
    inertial = [
        stamps, *six(np.degrees(session.rate_rad_s)), *six(session.accel_m_s2 / GRAVITY_M_S2)
    ]  # fmt: skip
    (path / "Inertial.csv").write_text(table(f"Timestamp (us),{gyro},{accel}", inertial))
    slow = slice(None, None, 100)
    temperature = [stamps[slow], *six(session.temperature_degc[slow, None])]
    (path / "Temperature.csv").write_text(table("Timestamp (us),Temperature (degC)", temperature))
    quaternion = six(session.orientation_xyzw[:, [3, 0, 1, 2]])
    (path / "Quaternion.csv").write_text(table("Timestamp (us),W,X,Y,Z", [stamps, *quaternion]))
    ping = {"deviceName": "x-IMU3", "interface": "USB", "serialNumber": "F7E4-5410-EC7B-D7E7"}
    (path / "Command.json").write_text(json.dumps([{"ping": ping}]))
    return path


XSENS_HEAD = """// General information:
//  MT Manager version: 2022.2.0
// Device information:
//  DeviceId: 037003F8
//  ProductCode: MTi-300-2A5G4
// Update Rate: 100.0Hz
// Coordinate system: ENU
"""


def write_xsens(
    folder: Path, session: HandheldSession, *, delta: bool = False, fine: bool = True
) -> Path:
    """Write MT Manager's text export, with rates or with delta_q, which is rotated in a step."""
    counter = [str((65_000 + k) % 65_536) for k in range(session.time_s.size)]
    ticks = [str(2**32 - 5_000 + round(1e4 * t)) for t in session.time_s.tolist()]
    ticks = [str(int(text) % 2**32) for text in ticks] if fine else ["NaN"] * len(ticks)
    names = ["PacketCounter", "SampleTimeFine", "Acc_X", "Acc_Y", "Acc_Z"]
    columns: list[FloatArray | list[str]] = [counter, ticks, *session.accel_m_s2.T]
    if delta:
        turned = Rotation.from_rotvec(session.rate_rad_s * 0.01).as_quat()
        names += ["OriInc_q0", "OriInc_q1", "OriInc_q2", "OriInc_q3"]
        columns += list(turned[:, [3, 0, 1, 2]].T)
    else:
        names += ["Gyr_X", "Gyr_Y", "Gyr_Z"]
        columns += list(session.rate_rad_s.T)
    names += ["Quat_q0", "Quat_q1", "Quat_q2", "Quat_q3", "Temperature"]
    columns += [*session.orientation_xyzw[:, [3, 0, 1, 2]].T, session.temperature_degc]
    path = folder / "MT_037003F8-000.txt"
    path.write_text(XSENS_HEAD + table("\t".join(names), columns, "\t"))
    return path
