"""ROS 2: a parameter file that any node can load, and what it multiplies with what.

What to use when: `ros_parameters` for the text. There is no one message or node of ROS for
a gyro's calibration: names are those of sensor_msgs/msg/Imu where it has them. Arrays of
one type, rows first, for ROS parameters know no nested lists and no null.
"""

from collections.abc import Iterable

import numpy as np

from gyrorig_solver.export.numbers import AXES, Source, quoted


def ros_parameters(source: Source, name: str | None = None) -> str:
    """Return the parameter file's text; `name` is the node's, all nodes without it.

    Raises:
        InputError: the calibration leaves open what is needed.
    """
    correction = source.whole
    config = source.found.board.config
    lines = [f"# {line}" for line in source.head()]
    lines += [
        "#",
        "# true = correction * (read - bias), all rad/s; correction rows first, columns in.",
        f"# true: in {AXES[source.frame]}.",
        "# read: counts * nominal_scale, in the sensor's own axes, or what its driver publishes",
        "#   if that is rad/s at the data sheet's scale in the sensor's axes, not turned.",
        "# stamp of the motion = stamp of the sample - time_offset.",
        *(f"# {line}" for line in source.left_out()),
        f"{quoted(name) if name else '/**'}:",
        "  ros__parameters:",
        "    gyro_calibration:",
        f"      board_id: {quoted(source.found.board.id)}",
        f"      version: {source.found.version}",
        f"      verdict: {quoted(source.found.trust.verdict)}",
        f"      frame: {quoted(source.frame)}",
        f"      angular_velocity_bias: {yaml_list(source.bias_rad_s)}  # rad/s",
        f"      angular_velocity_correction: {yaml_list(correction.inverse.ravel())}",
    ]
    if config.gyro_scale_rad_s is not None:
        lines.append(
            f"      nominal_scale: {yaml_number(config.gyro_scale_rad_s)}  # rad/s of a count"
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


def yaml_list(values: Iterable[float]) -> str:
    """Return numbers as a list of YAML on one line."""
    return "[" + ", ".join(yaml_number(v) for v in values) + "]"


def yaml_number(value: float) -> str:
    """Return a number that YAML 1.1 reads as one of floating point."""
    text = repr(float(value))
    mantissa, mark, exponent = text.partition("e")
    return f"{mantissa if '.' in mantissa else mantissa + '.0'}{mark}{exponent}"
