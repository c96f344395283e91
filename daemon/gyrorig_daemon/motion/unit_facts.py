"""Capabilities and settings of a motion unit, in the steps of its driver."""

import math
from dataclasses import dataclass, field
from enum import Enum

from gyrorig_protocol.ptu import Axis

ARCSEC_PER_DEG = 3600.0
RAD_PER_ARCSEC = math.pi / 180.0 / ARCSEC_PER_DEG


class Homing(Enum):
    """Whether the unit may, or must, sweep its axes to find its zero."""

    NEVER = "never"
    IF_NEEDED = "if needed"
    ALWAYS = "always"  # after lost steps a unit does not know that homing is needed


@dataclass(frozen=True, slots=True)
class AxisFacts:
    """Capabilities and settings of one axis; in steps, steps/s and steps/s^2."""

    resolution_arcsec: float
    min_steps: int
    max_steps: int
    lower_speed: int
    upper_speed: int
    base_speed: int
    acceleration: int
    sign: int

    @property
    def steps_per_deg(self) -> float:
        """Counted steps per degree, in the rig's sense of rotation."""
        return self.sign * ARCSEC_PER_DEG / self.resolution_arcsec

    def to_steps(self, angle_deg: float) -> int:
        """Return the position nearest to an angle."""
        return round(angle_deg * self.steps_per_deg)

    def to_rad(self, steps: int) -> float:
        """Return the angle at a position, in the rig's sense of rotation."""
        return self.sign * steps * self.resolution_arcsec * RAD_PER_ARCSEC

    def to_speed(self, speed_deg_s: float) -> int:
        """Return the speed in steps/s nearest to one in deg/s."""
        return round(speed_deg_s * abs(self.steps_per_deg))


@dataclass(frozen=True, slots=True)
class UnitFacts:
    """Capabilities and settings of one unit."""

    model: str
    firmware: str
    serial: str
    dialect: str  # of the driver's commands, "" if it has only one
    counter_hz: int | None
    pan: AxisFacts
    tilt: AxisFacts
    baud: int
    driver: str = "directed_perception"
    poll_bytes: int = 3  # of a position request, with its line end
    axes: tuple[Axis, ...] = field(default=(Axis.PAN, Axis.TILT))

    def axis(self, axis: Axis) -> AxisFacts:
        """Return the facts of one axis."""
        return self.pan if axis is Axis.PAN else self.tilt

    def metadata(self) -> dict[str, str]:
        """Return the record `gyrorig.ptu` of a recording; unknown values are left out."""
        record = {"model": self.model, "driver": self.driver, "firmware": self.firmware}
        if self.dialect:
            record["dialect"] = str(self.dialect)
        record["axes"] = " ".join(axis.label for axis in self.axes)
        if self.serial:
            record["serial"] = self.serial
        for name, axis in (("pan", self.pan), ("tilt", self.tilt)):
            record[f"{name}_resolution_arcsec"] = repr(axis.resolution_arcsec)
            record[f"{name}_min_steps"] = str(axis.min_steps)
            record[f"{name}_max_steps"] = str(axis.max_steps)
            record[f"{name}_base_speed"] = str(axis.base_speed)
            record[f"{name}_upper_speed"] = str(axis.upper_speed)
            record[f"{name}_acceleration"] = str(axis.acceleration)
        record["baud"] = str(self.baud)
        record["poll_bytes"] = str(self.poll_bytes)
        if self.counter_hz is not None:
            record["counter_hz"] = str(self.counter_hz)
        return record


def fixed_axis() -> AxisFacts:
    """Return the facts of an axis that the unit does not have: it stays at 0."""
    return AxisFacts(ARCSEC_PER_DEG, 0, 0, 0, 0, 0, 0, 1)
