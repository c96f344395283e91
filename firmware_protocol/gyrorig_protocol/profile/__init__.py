"""Sensor profiles: the data sheet of a gyroscope part as data.

What to use when: `parse_profile` for the YAML document; the result is a `SensorProfile`.
"""

from gyrorig_protocol.profile.sensor_profile import SensorProfile, parse_profile

__all__ = ["SensorProfile", "parse_profile"]
