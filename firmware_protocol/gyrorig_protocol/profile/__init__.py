"""Sensor profiles as data: what a part's data sheet says, in SI units where it matters."""

from gyrorig_protocol.profile.document import SensorProfile, parse_profile

__all__ = ["SensorProfile", "parse_profile"]
