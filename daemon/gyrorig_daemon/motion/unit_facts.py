"""Capabilities and settings of the pan-tilt unit, as the unit reports them.

Replies have no checksum: a lost byte makes another number, and a wrong resolution or speed
would spoil the whole recording. Therefore each value is requested until two consecutive replies
agree.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeVar

from gyrorig_daemon.motion.ptu_client import PtuClient
from gyrorig_protocol.errors import DeviceError
from gyrorig_protocol.ptu import (
    Axis,
    Dialect,
    FirmwareVersion,
    PtuCommand,
    Quantity,
    Reply,
    dialect_features,
    query_quantity,
    read_value,
    require_integer,
    require_resolution_arcsec,
)
from gyrorig_protocol.ptu.ptu_commands import QUERY_COUNTER_HZ, QUERY_MODEL, QUERY_SERIAL

T = TypeVar("T", int, float, str)

ARCSEC_PER_DEG = 3600.0
RAD_PER_ARCSEC = math.pi / 180.0 / ARCSEC_PER_DEG
MAX_READINGS = 6  # of one value, until two consecutive ones agree


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
    dialect: Dialect
    counter_hz: int | None
    pan: AxisFacts
    tilt: AxisFacts
    baud: int

    def axis(self, axis: Axis) -> AxisFacts:
        """Return the facts of one axis."""
        return self.pan if axis is Axis.PAN else self.tilt

    def metadata(self) -> dict[str, str]:
        """Return the record `gyrorig.ptu` of a recording; unknown values are left out."""
        record = {"model": self.model, "dialect": self.dialect.value, "firmware": self.firmware}
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
        if self.counter_hz is not None:
            record["counter_hz"] = str(self.counter_hz)
        return record


def read_facts(
    client: PtuClient, version: FirmwareVersion, dialect: Dialect, signs: Mapping[Axis, int]
) -> UnitFacts:
    """Read all values that a recording and a motion plan need, from a homed unit.

    Raises:
        DeviceError: it does not answer, or no two replies agree.
    """
    model = serial = ""
    counter_hz: int | None = None
    if dialect_features(dialect).model_and_serial_queries:
        model = read_text(client, QUERY_MODEL)
        serial = read_text(client, QUERY_SERIAL)
    if dialect_features(dialect).motion_with_counter:
        counter_hz = read_integer(client, QUERY_COUNTER_HZ)
    pan, tilt = (_axis_facts(client, axis, signs[axis]) for axis in (Axis.PAN, Axis.TILT))
    return UnitFacts(
        model=model or version.controller or "unknown",
        firmware=version.number,
        serial=serial,
        dialect=dialect,
        counter_hz=counter_hz,
        pan=pan,
        tilt=tilt,
        baud=client.baud,
    )


def read_integer(client: PtuClient, command: PtuCommand) -> int:
    """Return an integer that the unit has reported twice.

    Raises:
        DeviceError: it does not answer with an integer, or no two replies agree.
    """
    return _read_until_confirmed(client, command, require_integer)


def read_text(client: PtuClient, command: PtuCommand) -> str:
    """Return a text that the unit has reported twice, "" if the reply is not a text.

    Raises:
        DeviceError: it does not answer, or no two replies agree.
    """
    return _read_until_confirmed(client, command, _as_text)


def read_resolution_arcsec(client: PtuClient, axis: Axis) -> float:
    """Return the resolution of an axis, reported twice.

    Raises:
        DeviceError: as `read_integer`.
    """
    return _read_until_confirmed(
        client, query_quantity(axis, Quantity.RESOLUTION), require_resolution_arcsec
    )


def _axis_facts(client: PtuClient, axis: Axis, sign: int) -> AxisFacts:
    def integer(quantity: Quantity) -> int:
        return read_integer(client, query_quantity(axis, quantity))

    return AxisFacts(
        resolution_arcsec=read_resolution_arcsec(client, axis),
        min_steps=integer(Quantity.MINIMUM),
        max_steps=integer(Quantity.MAXIMUM),
        lower_speed=integer(Quantity.LOWER_SPEED),
        upper_speed=integer(Quantity.UPPER_SPEED),
        base_speed=integer(Quantity.BASE_SPEED),
        acceleration=integer(Quantity.ACCELERATION),
        sign=sign,
    )


def _read_until_confirmed(
    client: PtuClient, command: PtuCommand, convert: Callable[[PtuCommand, Reply], T]
) -> T:
    previous: T | None = None
    fault: DeviceError | None = None
    for _ in range(MAX_READINGS):
        try:
            value = convert(command, client.ask(command))
        except DeviceError as error:
            if client.is_port_gone:
                raise
            previous, fault = None, error
            continue
        if value == previous:
            return value
        previous = value
    raise fault or DeviceError(
        f"the pan-tilt unit on {client.location} gives a different answer each time to the "
        f"command {command.text!r}",
        "check the cable and the baud rate of the unit",
    )


def _as_text(command: PtuCommand, reply: Reply) -> str:
    answer = read_value(command, reply)
    return answer if isinstance(answer, str) else ""
