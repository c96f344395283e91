"""Limits, speeds and reply times of a pan-tilt unit that is not connected yet.

The values are those of a PTU-E46 or D46 with a 17.5:1 gear in half steps (sources at each
constant). The daemon reads the unit's own values and rejects commands beyond them.
"""

import math
from dataclasses import dataclass, replace

from gyrorig_protocol.ptu import Dialect, dialect_features

ARCSEC_PER_DEG = 3600.0
BITS_PER_BYTE = 10  # 8N1
RESOLUTION_ARCSEC = 185.142857  # D46 user's manual v2.14, half step
PAN_STEPS = (-3090, 3090)  # command reference manual v3.00D
TILT_STEPS = (-903, 601)  # the narrower range of the two units that we know
SPEED_STEPS_S = (31, 2902)
BASE_SPEED_STEPS_S, ACCELERATION_STEPS_S2 = 1000.0, 2000.0  # as delivered
# Bytes of an order, of its reply, of the terse replies to BT and to PP, and of a query.
COMMAND_BYTES, ANSWER_BYTES, MOTION_BYTES, POSITION_BYTES, QUERY_BYTES = 7, 3, 44, 9, 3


@dataclass(frozen=True, slots=True)
class AxisModel:
    """The limits of one axis in the frame of the rig, within those of the rig file."""

    resolution_arcsec: float
    low_deg: float
    high_deg: float
    slowest_deg_s: float
    fastest_deg_s: float
    sign: int = 1  # -1: the unit counts in the other direction

    @property
    def step_rad(self) -> float:
        """The angle of one step, signed."""
        return self.sign * math.radians(self.resolution_arcsec / ARCSEC_PER_DEG)

    def to_steps(self, angle_deg: float) -> int:
        """Return the nearest count of an angle."""
        return self.sign * self.to_step_rate(angle_deg)

    def to_step_rate(self, speed_deg_s: float) -> int:
        """Return a speed in steps/s, or an acceleration in deg/s^2 in steps/s^2; not signed."""
        return round(speed_deg_s * ARCSEC_PER_DEG / self.resolution_arcsec)

    def with_sign(self, sign: int) -> "AxisModel":
        """Return the axis for a sign of its counts; `self` has the sign 1."""
        if sign > 0:
            return self
        return replace(self, low_deg=-self.high_deg, high_deg=-self.low_deg, sign=-1)


@dataclass(frozen=True, slots=True)
class UnitModel:
    """A pan-tilt unit and its serial line, as far as they affect a recording."""

    pan: AxisModel
    tilt: AxisModel
    command_interval_s: float  # from one order to the next
    poll_interval_s: float  # from one position query to the next
    window_s: float  # the unit takes the count at an unknown time in this window
    both_at_once: bool  # one reply contains both axes and the controller's counter
    base_speed_steps_s: float = BASE_SPEED_STEPS_S
    acceleration_steps_s2: float = ACCELERATION_STEPS_S2

    @property
    def axes(self) -> tuple[AxisModel, AxisModel]:
        """Pan and tilt."""
        return self.pan, self.tilt


def build_unit_model(
    dialect: Dialect,
    baud: int,
    command_s: float | None = None,
    poll_rate_hz: float | None = None,
) -> UnitModel:
    """Return the model of a unit with a dialect and a serial line.

    Args:
        dialect: of the unit's commands.
        baud: of the serial line.
        command_s: processing time of the controller per command; None: the vendor's minimum
            interval between two commands.
        poll_rate_hz: commands per second; None: the vendor's limit.
    """
    features = dialect_features(dialect)
    byte_s = BITS_PER_BYTE / baud
    processing_s = features.min_command_interval_s if command_s is None else command_s
    min_interval_s = 1.0 / poll_rate_hz if poll_rate_hz else features.min_command_interval_s
    answer_bytes = MOTION_BYTES if features.motion_with_counter else POSITION_BYTES
    resolution = RESOLUTION_ARCSEC
    slowest, fastest = (s * resolution / ARCSEC_PER_DEG for s in SPEED_STEPS_S)

    def axis(steps: tuple[int, int]) -> AxisModel:
        low, high = (s * resolution / ARCSEC_PER_DEG for s in steps)
        return AxisModel(resolution, low, high, slowest, fastest)

    return UnitModel(
        pan=axis(PAN_STEPS),
        tilt=axis(TILT_STEPS),
        command_interval_s=max(
            min_interval_s, processing_s + (COMMAND_BYTES + ANSWER_BYTES) * byte_s
        ),
        poll_interval_s=max(min_interval_s, processing_s + (QUERY_BYTES + answer_bytes) * byte_s),
        window_s=processing_s,
        both_at_once=features.motion_with_counter,
    )
