"""Identification and setup of the pan-tilt unit: it is known before it moves.

An unknown device is not moved. First the version is requested, which only a pan-tilt unit
answers, then it is halted, then the modes are set one at a time. Resolution and limits are read
after homing, because an E46 does not know its gear ratio before its first reset.
"""

from gyrorig_daemon.config import PtuPort
from gyrorig_daemon.motion.directed_perception.ptu_client import DRAIN_S, PtuClient
from gyrorig_daemon.motion.directed_perception.unit_readings import (
    read_facts,
    read_integer,
    read_resolution_arcsec,
    read_text,
)
from gyrorig_daemon.motion.unit_facts import ARCSEC_PER_DEG, Homing, UnitFacts
from gyrorig_protocol.errors import DeviceError, UsageError
from gyrorig_protocol.program import PtuSettings
from gyrorig_protocol.ptu import (
    PROBE,
    Axis,
    Dialect,
    FirmwareVersion,
    PtuCommand,
    Quantity,
    assign_quantity,
    dialect_features,
    dialect_from_probe,
    dialect_from_version,
    query_quantity,
    read_value,
    require_done,
)
from gyrorig_protocol.ptu.ptu_commands import (
    DISABLE_ECHO,
    IMMEDIATE_EXECUTION,
    INDEPENDENT_SPEED,
    QUERY_LIMITS,
    QUERY_POWER,
    QUERY_SERIAL,
    QUERY_VERSION,
    RESET_BOTH_AXES,
    TERSE_FEEDBACK,
    query_hold_power,
    query_move_power,
    query_step_mode,
)

BOTH_AXES = (Axis.PAN, Axis.TILT)
_BOUNDS = (Quantity.MINIMUM, Quantity.MAXIMUM)
_UNITS = {
    Quantity.UPPER_SPEED: "deg/s",
    Quantity.BASE_SPEED: "deg/s",
    Quantity.ACCELERATION: "deg/s^2",
}


def identify_unit(client: PtuClient) -> FirmwareVersion:
    """Check that a pan-tilt unit is on the port, and halt it.

    An earlier program may have left it turning.

    Raises:
        DeviceError: the device is silent, is not a pan-tilt unit, or does not halt.
    """
    version = _wait_for_version(client)
    client.halt()
    return version


def set_up_unit(
    client: PtuClient,
    config: PtuPort,
    settings: PtuSettings,
    version: FirmwareVersion,
    homing: Homing,
) -> UnitFacts:
    """Home the unit if needed and allowed, apply settings, read its capabilities.

    Args:
        client: the line to the unit.
        config: dialect and signs.
        settings: settings of the motion program.
        version: the result of `identify_unit`.
        homing: whether the operator agrees to a sweep of both axes over their whole range.

    Raises:
        DeviceError: it refuses a command, or is not the unit that the configuration names.
        UsageError: it needs homing, which is not allowed, or does not support the settings.
    """
    for command in (DISABLE_ECHO, TERSE_FEEDBACK, INDEPENDENT_SPEED, IMMEDIATE_EXECUTION):
        require_done(command, client.ask(command))
    dialect = _detect_dialect(client, config, version)
    client.min_interval_s = dialect_features(dialect).min_command_interval_s
    if config.serial is not None:
        _check_serial(client, config.serial, dialect)
    _home_if_needed(client, homing)
    client.expects_banner = False
    _apply_settings(client, settings)
    signs = {Axis.PAN: config.pan_sign, Axis.TILT: config.tilt_sign}
    facts = read_facts(client, version, dialect, signs)
    for command in _queries_to_record():
        client.ask(command)
    return facts


def _wait_for_version(client: PtuClient) -> FirmwareVersion:
    client.send_spaces(3)
    client.drain(DRAIN_S)
    received = b""
    for _ in range(3):
        exchange = client.exchange(QUERY_VERSION)
        received = received or exchange.raw
        if exchange.reply is None:
            continue
        version = read_value(QUERY_VERSION, exchange.reply)
        if isinstance(version, FirmwareVersion):
            client.is_identified = True
            return version
        break
    if not received:
        raise DeviceError(
            f"no pan-tilt unit answers on {client.location} at {client.baud} baud",
            "check the power of the unit, its cable, its port and its baud rate",
        )
    if set(received.decode("latin-1")) <= set(QUERY_VERSION.encode().decode("ascii")):
        raise DeviceError(
            f"the device on {client.location} only sends back the bytes that it receives",
            "if the device is a pan-tilt unit that is homing after power-up, wait until it "
            "stops. Otherwise check the ports in the rig file",
        )
    raise DeviceError(
        f"the device on {client.location} is not a pan-tilt unit, because it answers "
        f"{received[:32]!r}",
        "check the ports in the rig file. The daemon did not move the device",
    )


def _detect_dialect(client: PtuClient, config: PtuPort, version: FirmwareVersion) -> Dialect:
    if config.dialect != "auto":
        return Dialect(config.dialect)
    dialect = dialect_from_probe(client.ask(PROBE)) or dialect_from_version(version.text)
    if dialect is None:
        raise DeviceError(
            f"the daemon does not recognise the command set (dialect) of the pan-tilt unit on "
            f"{client.location}",
            "set ptu.dialect in the rig file to d46 or e46, the series of the unit",
        )
    return dialect


def _check_serial(client: PtuClient, expected_serial: str, dialect: Dialect) -> None:
    """Check the serial number, because another unit has other limits.

    Raises:
        DeviceError: it is another unit.
        UsageError: its dialect cannot report a serial number.
    """
    if not dialect_features(dialect).model_and_serial_queries:
        raise UsageError(
            f"the pan-tilt unit on {client.location} cannot report its serial number, so "
            "ptu.serial cannot be checked",
            "remove ptu.serial from the rig file",
        )
    serial = read_text(client, QUERY_SERIAL)
    if serial != expected_serial:
        raise DeviceError(
            f"the pan-tilt unit on {client.location} has the serial number {serial!r} instead of "
            f"{expected_serial!r}",
            "check the ports, or correct ptu.serial in the rig file. The daemon did not "
            "move the unit",
        )


def _home_if_needed(client: PtuClient, homing: Homing) -> None:
    bounds = [
        read_integer(client, query_quantity(axis, bound)) for axis in BOTH_AXES for bound in _BOUNDS
    ]
    # both limits of an axis that was never homed are 0 (manual v3.00D)
    if any(bounds[:2]) and any(bounds[2:]) and homing is not Homing.ALWAYS:
        return
    if homing is Homing.NEVER:
        raise UsageError(
            "the pan-tilt unit must be homed first, and homing moves both axes over their "
            "whole range",
            "remove all objects from the unit's range of motion, and add the option --home",
        )
    client.is_resetting = True
    try:
        # once: a second reset would sweep again, and the first may only be slow
        reply = client.exchange(RESET_BOTH_AXES).reply
        if reply is None:
            raise client.no_answer_error(RESET_BOTH_AXES)
        require_done(RESET_BOTH_AXES, reply)
    finally:
        client.is_resetting = False
    bounds = [
        read_integer(client, query_quantity(axis, bound)) for axis in BOTH_AXES for bound in _BOUNDS
    ]
    if not (any(bounds[:2]) and any(bounds[2:])):
        raise DeviceError(
            "the pan-tilt unit reports no limits of its axes, although it was homed",
            "switch the unit off and on again",
        )


def _apply_settings(client: PtuClient, settings: PtuSettings) -> None:
    """Set speeds and acceleration at rest; the unit recomputes its tables for seconds."""
    values_deg = (
        (Quantity.UPPER_SPEED, settings.upper_speed_deg_s),
        (Quantity.BASE_SPEED, settings.base_speed_deg_s),
        (Quantity.ACCELERATION, settings.acceleration_deg_s2),
    )
    for axis in BOTH_AXES:
        arcsec = read_resolution_arcsec(client, axis)
        for quantity, value_deg in values_deg:
            if value_deg is None:
                continue
            steps = round(value_deg * ARCSEC_PER_DEG / arcsec)
            if read_integer(client, query_quantity(axis, quantity)) != steps:
                _set_axis_value(client, axis, quantity, steps, value_deg)


def _set_axis_value(
    client: PtuClient, axis: Axis, quantity: Quantity, steps: int, value_deg: float
) -> None:
    name = f"{axis.label} {quantity.name.lower().replace('_', ' ')}"
    reply = client.ask(assign_quantity(axis, quantity, steps))
    if not reply.ok:
        raise UsageError(
            f"the pan-tilt unit refuses the {name} {value_deg:g} {_UNITS[quantity]}: {reply.text}",
            "choose another value under `settings` in the motion program",
        )
    readback = read_integer(client, query_quantity(axis, quantity))
    if readback != steps:
        raise UsageError(
            f"the pan-tilt unit set the {name} to {readback} steps instead of {steps} steps "
            f"({value_deg:g} {_UNITS[quantity]})",
            "choose a value that the unit supports under `settings` in the motion program",
        )


def _queries_to_record() -> tuple[PtuCommand, ...]:
    """Return queries whose replies are only recorded; a refusal is recorded, too."""
    mode_queries = [
        make_query(axis)
        for axis in BOTH_AXES
        for make_query in (query_step_mode, query_hold_power, query_move_power)
    ]
    return (QUERY_LIMITS, *mode_queries, QUERY_POWER)
