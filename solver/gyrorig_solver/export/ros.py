"""ROS 2 parameter file with the correction of a calibration.

What to use when: `ros_parameters` for the text. ROS has no standard message or node for a
gyro calibration; the names are those of sensor_msgs/msg/Imu where possible. Matrices are flat
lists, rows first, because ROS parameters have no nested lists and no null.
"""

import re
from collections.abc import Iterable

import numpy as np

from gyrorig_protocol.errors import UsageError
from gyrorig_solver.export.export_source import ExportSource, comment_lines, quoted

# https://design.ros2.org/articles/topic_and_service_names.html; `*` is a wildcard of nodes.
_ROS_NAME = re.compile(r"[A-Za-z_/~*][A-Za-z0-9_/*]{0,255}")


def ros_parameters(source: ExportSource, name: str | None = None) -> str:
    """Return the text of the parameter file; `name` is the node, by default all nodes.

    Raises:
        InputError: a needed parameter is not known.
        UsageError: `name` is not the name of a node.
    """
    check_ros_name(name, "node")
    correction = source.correction
    config = source.document.board.config
    lines = comment_lines("# ", source.header_lines())
    lines += [
        "#",
        "# true = correction * (read - bias), all rad/s; correction rows first, columns in.",
        f"# true: in {source.axes_text}.",
        "# read: counts * nominal_scale, in the sensor's own axes, or the output of its driver",
        "#   if the driver publishes rad/s at the data sheet's scale in the sensor's own axes.",
        "# time of the motion = timestamp of the sample - time_offset.",
        *comment_lines("# ", source.omission_lines()),
        f"{quoted(name) if name else '/**'}:",
        "  ros__parameters:",
        "    gyro_calibration:",
        f"      board_id: {quoted(source.document.board.id)}",
        f"      version: {source.document.version}",
        f"      verdict: {quoted(source.document.trust.verdict)}",
        f"      frame: {quoted(source.frame)}",
        f"      angular_velocity_bias: {yaml_list(source.bias_rad_s)}  # rad/s",
        f"      angular_velocity_correction: {yaml_list(correction.inverse.ravel())}",
    ]
    if config.gyro_scale_rad_s is not None:
        lines.append(
            f"      nominal_scale: {yaml_number(config.gyro_scale_rad_s)}  # rad/s per count"
        )
    if source.time_offset_s is not None:
        lines.append(f"      time_offset: {yaml_number(source.time_offset_s)}  # s")
    for key, title, unit in (
        ("angle_random_walk", "noise_density", "rad/s/sqrt(Hz), one-sided"),
        ("rate_random_walk", "bias_random_walk", "rad/s^2/sqrt(Hz)"),
    ):
        values = source.noise(key)
        known = [v for v in values if v is not None]
        if known and len(known) == len(values):
            lines.append(f"      {title}: {yaml_list(known)}  # {unit}")
    band_hz = config.bandwidth_hz or (config.odr_hz and config.odr_hz / 2.0)
    density = [v for v in source.noise("angle_random_walk") if v is not None]
    if band_hz and len(density) == 3:
        inverse = correction.inverse
        covariance = inverse @ np.diag(np.square(density) * band_hz) @ inverse.T
        lines.append(
            f"      angular_velocity_covariance: {yaml_list(covariance.ravel())}"
            "  # (rad/s)^2, rows first"
        )
    return "\n".join(lines) + "\n"


def check_ros_name(name: str | None, kind: str) -> None:
    """Check a name for a ROS file: letters, digits, underscores, slashes and wildcards.

    Raises:
        UsageError: it is not such a name.
    """
    if name is not None and not _ROS_NAME.fullmatch(name):
        raise UsageError(
            f"the name {name[:40]!r} is not the name of a ROS {kind}",
            "choose another name with --name, with letters, digits, underscores and slashes",
        )


def yaml_list(values: Iterable[float]) -> str:
    """Return numbers as a YAML list on one line."""
    return "[" + ", ".join(yaml_number(v) for v in values) + "]"


def yaml_number(value: float) -> str:
    """Return a number that YAML 1.1 reads as floating point."""
    text = repr(float(value))
    mantissa, mark, exponent = text.partition("e")
    return f"{mantissa if '.' in mantissa else mantissa + '.0'}{mark}{exponent}"
