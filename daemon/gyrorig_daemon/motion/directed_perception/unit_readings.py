"""Values that a Directed Perception unit reports about itself.

Replies have no checksum: a lost byte makes another number, and a wrong resolution or speed
would spoil the whole recording. Therefore each value is requested until two consecutive replies
agree.
"""

from collections.abc import Callable, Mapping
from typing import TypeVar

from gyrorig_daemon.motion.directed_perception.ptu_client import PtuClient
from gyrorig_daemon.motion.unit_facts import AxisFacts, UnitFacts
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

MAX_READINGS = 6  # of one value, until two consecutive ones agree


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
