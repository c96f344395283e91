"""Kalibr: imu.yaml, its noise figures, and the gyro's intrinsics in its own convention.

What to use when: `kalibr_imu` for the text. Kalibr's gyro, model `scale-misalignment`, is
read = M C_gyro_i true + A accel + bias, M lower triangular and C a rotation: its M is our
S T and its C_gyro_i our M, number for number.

Source: kalibr_common/ConfigReader.py, class ImuParameters (keys and what it refuses), and
Kalibr's wiki, "IMU noise model": continuous densities, rad/s/sqrt(Hz) and rad/s^2/sqrt(Hz).
"""

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.export.numbers import Source
from gyrorig_solver.export.ros import yaml_list, yaml_number

_ASK = "Kalibr refuses a file without it: take it from the accelerometer's data sheet"


def kalibr_imu(source: Source, name: str | None = None) -> str:
    """Return the file's text; `name` is the ROS topic.

    Raises:
        InputError: the noise, or the output rate, is not known.
    """
    density = source.worst_noise("angle_random_walk")
    rate_hz = source.found.board.config.odr_hz
    if density is None or rate_hz is None:
        lacks = "the noise of the gyro" if density is None else "the board's output rate"
        raise InputError(
            f"the calibration of {source.found.board.id} does not know {lacks}",
            "record the board at rest, with odr_hz in its metadata",
        )
    walk = source.worst_noise("rate_random_walk")
    lines = [f"# {line}" for line in source.head()]
    lines += [
        "#",
        "# Noise is that of the noisiest axis, in continuous time, as Kalibr takes it; what was",
        "# measured, without the factor of 10 to 20 that some add for effects they do not model.",
        f"rostopic: {name or '/imu0'}",
        f"update_rate: {yaml_number(rate_hz)}  # Hz",
        f"gyroscope_noise_density: {yaml_number(density)}  # rad/s/sqrt(Hz)",
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
    force = source.whole.force @ np.array(matrices.M, np.float64) @ turn.T
    return [
        "# Below: read = M C_gyro_i true + A accel + bias, Kalibr's model scale-misalignment;",
        "# Kalibr's command estimates these itself and does not read them, OpenVINS and others do.",
        "model: scale-misalignment",
        "gyroscopes:",
        *_matrix("M", low),
        *_matrix("C_gyro_i", turn),
        *_matrix("A", force),
        f"  bias: {yaml_list(source.bias_rad_s)}  # rad/s, in the sensor's axes",
        *(f"# {line}" for line in source.left_out(("g_sensitivity",))),
    ]


def _matrix(name: str, rows: FloatArray) -> list[str]:
    return [f"  {name}:", *(f"    - {yaml_list(row)}" for row in rows)]
