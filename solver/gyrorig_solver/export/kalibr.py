"""Kalibr: imu.yaml, its noise figures, and the gyro's intrinsics in its own convention.

What to use when: `kalibr_imu` for the text. Kalibr's gyro, model `scale-misalignment`, is
read = M C_gyro_i true + A C_gyro_i accel + bias, M lower triangular and C a rotation: its M
is our S T and its C_gyro_i our M, number for number; A is against the gyro's axes.

Noise. Kalibr makes of its density sigma the standard deviation of a sample as
sigma_d = sigma / sqrt(1 / update_rate), so a sample's variance is sigma^2 rate: sigma^2 is the
two-sided density. Ours, N, is one-sided as data sheets have it: the same variance is
N^2 rate / 2 (estimate/noise.py). Hence sigma = N / sqrt(2), which is also what is read off an
Allan deviation at 1 s, as Kalibr's wiki has it. The random walk is the same number in both:
Kalibr's bias takes steps of sigma_b sqrt(dt), so its variance grows as sigma_b^2 t.

Sources: kalibr_common/ConfigReader.py, class ImuParameters (keys, what it refuses, and
getGyroStatistics for the equation above); kalibr_imu_camera_calibration/IccSensors.py, class
IccScaledMisalignedImu, addGyroscopeErrorTerms (the model); Kalibr's wiki, "IMU noise model".
"""

import math

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.export.numbers import AXES, Source
from gyrorig_solver.export.ros import yaml_list, yaml_number

_TWO_SIDED = math.sqrt(0.5)  # from the root of a one-sided density to that of a two-sided one
_ASK = "Kalibr refuses a file without it: take it from the accelerometer's data sheet"


def kalibr_imu(source: Source, name: str | None = None) -> str:
    """Return the file's text; `name` is the ROS topic.

    Raises:
        InputError: the noise, or the output rate, is not known.
    """
    density = source.worst_noise("angle_random_walk")
    rate_hz = source.found.board.config.odr_hz
    if density is None or rate_hz is None:
        lacks, remedy = (
            ("the noise of the gyro", "record the board at rest for a minute, and solve again")
            if density is None
            else ("the board's output rate", "give odr_hz among its facts, and record again")
        )
        raise InputError(
            f"the calibration of {source.found.board.id} does not know {lacks}, which Kalibr wants",
            remedy,
        )
    walk = source.worst_noise("rate_random_walk")
    lines = [f"# {line}" for line in source.head()]
    lines += [
        "#",
        "# Noise is that of the noisiest axis, in continuous time, two-sided as Kalibr takes it: a",
        "# sample's standard deviation is the density times sqrt(update_rate). A data sheet's is",
        "# one-sided, sqrt(2) times this. What was measured stands here, without the factor of 10",
        "# to 20 that some add for effects they do not model.",
        f"rostopic: {name or '/imu0'}",
        f"update_rate: {yaml_number(rate_hz)}  # Hz",
        f"gyroscope_noise_density: {yaml_number(density * _TWO_SIDED)}  # rad/s/sqrt(Hz)",
    ]
    if walk is None:
        lines.append(
            "# gyroscope_random_walk:  # rad/s^2/sqrt(Hz); too short a recording to see it:"
        )
        lines.append("#   record hours at rest, or take it from the data sheet; Kalibr wants one")
    else:
        lines.append(f"gyroscope_random_walk: {yaml_number(walk)}  # rad/s^2/sqrt(Hz)")
    lines += [
        f"# accelerometer_noise_density:  # m/s^2/sqrt(Hz). {_ASK}",
        f"# accelerometer_random_walk:  # m/s^3/sqrt(Hz). {_ASK}",
    ]
    return "\n".join([*lines, *_intrinsics(source)]) + "\n"


def _intrinsics(source: Source) -> list[str]:
    """Return the gyro's intrinsics, where all of them are known."""
    matrices = source.found.matrices
    low = np.array(matrices.S, np.float64) @ np.array(matrices.T, np.float64)
    turn = np.eye(3) if source.frame == "sensor" else np.array(matrices.M, np.float64)
    if source.gain is None or not np.all(np.isfinite(turn)):
        return ["# the gyro's intrinsics are not all known: see the calibration's document"]
    return [
        "#",
        "# Below: read = M C_gyro_i true + A C_gyro_i accel + bias, Kalibr's scale-misalignment;",
        "# Kalibr's command estimates these itself and does not read them, OpenVINS and others do.",
        f"# true: in rad/s, accel: specific force in m/s^2, both in {AXES[source.frame]}.",
        "# i is that frame; it is not the accelerometer's frame, which Kalibr itself calls i.",
        "# read: counts * nominal scale, rad/s, in the sensor's own axes.",
        "# M, C_gyro_i and A: rows first, columns in; A in rad/s/(m/s^2).",
        "model: scale-misalignment",
        "gyroscopes:",
        *_matrix("M", low),
        *_matrix("C_gyro_i", turn),
        *_matrix("A", source.whole.force),
        f"  bias: {yaml_list(source.bias_rad_s)}  # rad/s, in the sensor's axes",
        *(f"# {line}" for line in source.left_out(("g_sensitivity",))),
    ]


def _matrix(name: str, rows: FloatArray) -> list[str]:
    return [f"  {name}:", *(f"    - {yaml_list(row)}" for row in rows)]
