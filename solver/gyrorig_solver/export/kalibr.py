"""Kalibr's imu.yaml: noise densities and gyro intrinsics in Kalibr's convention.

What to use when: `kalibr_imu` for the text. Kalibr's gyro, model `scale-misalignment`, is
read = M C_gyro_i true + A C_gyro_i accel + bias, with M lower triangular and C a rotation.
Its M is our S T, and its C_gyro_i is our M; A is in the axes of the gyro.

Noise: Kalibr computes the standard deviation of a sample from its density sigma as
sigma_d = sigma / sqrt(1 / update_rate). The variance of a sample is therefore sigma^2 rate, and
sigma^2 is the two-sided density. Our N is one-sided, as in data sheets: the same variance is
N^2 rate / 2. Therefore sigma = N / sqrt(2), which is also the Allan deviation at 1 s, as
Kalibr's wiki describes. The random walk is the same number in both: Kalibr's bias takes steps
of sigma_b sqrt(dt), and its variance grows as sigma_b^2 t.

Sources: kalibr_common/ConfigReader.py, class ImuParameters (keys, checks, and
getGyroStatistics for the equation above); kalibr_imu_camera_calibration/IccSensors.py, class
IccScaledMisalignedImu, addGyroscopeErrorTerms (the model); Kalibr's wiki, "IMU noise model".
"""

import math

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray
from gyrorig_solver.export.export_source import ExportSource, comment_lines
from gyrorig_solver.export.ros import check_ros_name, yaml_list, yaml_number

_TWO_SIDED = math.sqrt(0.5)  # root of a one-sided density to root of a two-sided density
_MISSING_NOISE_REMEDY = "Kalibr requires it: take it from the accelerometer's data sheet"


def kalibr_imu(source: ExportSource, name: str | None = None) -> str:
    """Return the text of the file; `name` is the ROS topic.

    Raises:
        InputError: the noise, or the output rate, is not known.
        UsageError: `name` is not the name of a topic.
    """
    check_ros_name(name, "topic")
    density = source.worst_noise("angle_random_walk")
    rate_hz = source.document.board.config.odr_hz
    if density is None or rate_hz is None:
        missing, remedy = (
            ("noise of the gyro", "record the board at rest for a minute, and solve again")
            if density is None
            else (
                "output rate of the board",
                "add `odr_hz` under `facts` of the board in the rig file and record again, or add "
                "`rate_hz` under `time` in the import map and import again",
            )
        )
        raise InputError(
            f"Kalibr requires the {missing}, but the calibration of "
            f"{source.document.board.id} does not contain it",
            remedy,
        )
    walk = source.worst_noise("rate_random_walk")
    lines = comment_lines("# ", source.header_lines())
    lines += [
        "#",
        "# Noise of the noisiest axis, continuous-time and two-sided, as Kalibr requires. The",
        "# standard deviation of a sample is the density times sqrt(update_rate). Data sheets give",
        "# the one-sided density, which is sqrt(2) times larger. These are measured values; some",
        "# users multiply them by 10 to 20 to allow for unmodelled effects.",
        f"rostopic: {'/imu0' if name is None else name}",
        f"update_rate: {yaml_number(rate_hz)}  # Hz",
        f"gyroscope_noise_density: {yaml_number(density * _TWO_SIDED)}  # rad/s/sqrt(Hz)",
    ]
    if walk is None:
        lines.append(
            "# gyroscope_random_walk:  # rad/s^2/sqrt(Hz); the recording is too short for it:"
        )
        lines.append(
            "#   record hours at rest, or take it from the data sheet; Kalibr requires a value"
        )
    else:
        lines.append(f"gyroscope_random_walk: {yaml_number(walk)}  # rad/s^2/sqrt(Hz)")
    lines += [
        f"# accelerometer_noise_density:  # m/s^2/sqrt(Hz). {_MISSING_NOISE_REMEDY}",
        f"# accelerometer_random_walk:  # m/s^3/sqrt(Hz). {_MISSING_NOISE_REMEDY}",
    ]
    return "\n".join([*lines, *_intrinsics(source)]) + "\n"


def _intrinsics(source: ExportSource) -> list[str]:
    """Return the lines of the gyro intrinsics, if all of them are known."""
    matrices = source.document.matrices
    scale_matrix = np.array(matrices.S, np.float64) @ np.array(matrices.T, np.float64)
    misalignment = np.eye(3) if source.frame == "sensor" else np.array(matrices.M, np.float64)
    if source.calibration is None or not np.all(np.isfinite(misalignment)):
        return ["# The gyro intrinsics are not all known; see the calibration document."]
    return [
        "#",
        "# The parameters below are those of Kalibr's model scale-misalignment:",
        "#   measured = M C_gyro_i true + A C_gyro_i accel + bias",
        "# measured: counts * nominal scale, in rad/s, in the sensor's own axes.",
        "# true: the rate in rad/s; accel: the specific force in m/s^2.",
        f"# Both are in {source.axes_text}.",
        "# i is that frame. It is not the accelerometer's frame, which Kalibr calls i.",
        "# M, C_gyro_i and A: rows first, columns in; A is in rad/s/(m/s^2).",
        "# Kalibr estimates these parameters itself and does not read them. OpenVINS and other",
        "# programs read them.",
        "model: scale-misalignment",
        "gyroscopes:",
        *_matrix("M", scale_matrix),
        *_matrix("C_gyro_i", misalignment),
        *_matrix("A", source.correction.force),
        f"  bias: {yaml_list(source.bias_rad_s)}  # rad/s, in the sensor's axes",
        *comment_lines("# ", source.omission_lines(("g_sensitivity",))),
    ]


def _matrix(name: str, rows: FloatArray) -> list[str]:
    return [f"  {name}:", *(f"    - {yaml_list(row)}" for row in rows)]
