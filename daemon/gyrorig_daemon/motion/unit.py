"""Who is on the port, and how it is made ready: known before it moves.

Nothing moves an unknown device: first a version that a pan-tilt unit would answer, then
a halt, then the modes, one at a time. Resolution and limits are read after homing,
because an E46 does not know its gear before its first reset (reference: ptu-e46.md).
"""

from dataclasses import dataclass
from enum import Enum

from gyrorig_daemon.config import PtuPort
from gyrorig_daemon.motion.facts import (
    ARCSEC_PER_DEG,
    UnitFacts,
    read_facts,
    read_integer,
    read_resolution_arcsec,
    read_text,
)
from gyrorig_daemon.motion.ptu_client import DRAIN_S, PtuClient
from gyrorig_protocol.errors import DeviceError, UsageError
from gyrorig_protocol.program import UnitSettings
from gyrorig_protocol.ptu import (
    PROBE,
    Axis,
    Dialect,
    PtuCommand,
    Quantity,
    Version,
    assign,
    dialect_from_probe,
    dialect_from_version,
    offers,
    query,
    read,
    require_done,
)
from gyrorig_protocol.ptu.commands import (
    ECHO_OFF,
    IMMEDIATE,
    INDEPENDENT_SPEED,
    QUERY_LIMITS,
    QUERY_POWER,
    QUERY_SERIAL,
    QUERY_VERSION,
    RESET,
    TERSE,
    query_hold_power,
    query_move_power,
    query_step_mode,
)

BOTH = (Axis.PAN, Axis.TILT)
_BOUNDS = (Quantity.MINIMUM, Quantity.MAXIMUM)
_IN_DEG = {
    Quantity.UPPER_SPEED: "deg/s",
    Quantity.BASE_SPEED: "deg/s",
    Quantity.ACCELERATION: "deg/s^2",
}


class Homing(Enum):
    """Whether the unit may, or shall, sweep both axes to find its zero."""

    NEVER = "never"
    IF_NEEDED = "if needed"
    ALWAYS = "always"  # after lost steps a unit does not know that it needs it


@dataclass(frozen=True, slots=True)
class Unit:
    """An identified unit that is homed and at rest."""

    client: PtuClient
    facts: UnitFacts


def identify_unit(client: PtuClient) -> Version:
    """Make sure that a pan-tilt unit is on the port, and halt it.

    Whoever was here before may have left it turning.

    Raises:
        DeviceError: silent, not a pan-tilt unit, or it does not halt.
    """
    version = _identify(client)
    client.halt()
    return version


def open_unit(
    client: PtuClient, config: PtuPort, settings: UnitSettings, version: Version, homing: Homing
) -> Unit:
    """Home the unit if need be and allowed, apply settings, read its facts.

    Args:
        client: the line to it.
        config: dialect and signs.
        settings: what the program wants it set to.
        version: what `identify_unit` returned.
        homing: whether the operator agrees to a sweep of both axes over their whole range.

    Raises:
        DeviceError: it refuses what it must do, or is another unit than the rig names.
        UsageError: it needs homing and may not, or cannot do the settings.
    """
    for command in (ECHO_OFF, TERSE, INDEPENDENT_SPEED, IMMEDIATE):
        require_done(command, client.ask(command))
    dialect = _dialect(client, config, version)
    client.min_interval_s = offers(dialect).min_command_interval_s
    if config.serial is not None:
        _check_serial(client, config.serial, dialect)
    _home(client, homing)
    client.expects_banner = False
    _apply(client, settings)
    signs = {Axis.PAN: config.pan_sign, Axis.TILT: config.tilt_sign}
    facts = read_facts(client, version, dialect, signs)
    for command in _for_the_record():
        client.ask(command)
    return Unit(client, facts)


def _identify(client: PtuClient) -> Version:
    client.send_spaces(3)
    client.drain(DRAIN_S)
    heard = b""
    for _ in range(3):
        exchange = client.exchange(QUERY_VERSION)
        heard = heard or exchange.raw
        if exchange.reply is None:
            continue
        version = read(QUERY_VERSION, exchange.reply)
        if isinstance(version, Version):
            client.identified = True
            return version
        break
    if not heard:
        raise DeviceError(
            f"no pan-tilt unit answers on {client.where} at {client.baud} baud",
            "check its power, the cable, the port and the baud rate",
        )
    if set(heard.decode("latin-1")) <= set(QUERY_VERSION.encode().decode("ascii")):
        raise DeviceError(
            f"what is on {client.where} only sends back what it is sent",
            "if it is a pan-tilt unit that homes after power-up, wait until it stands; "
            "otherwise check the ports in the rig's configuration",
        )
    raise DeviceError(
        f"what is on {client.where} is no pan-tilt unit: asked who it is, it says {heard[:32]!r}",
        "check the ports in the rig's configuration; it was not moved",
    )


def _dialect(client: PtuClient, config: PtuPort, version: Version) -> Dialect:
    if config.dialect != "auto":
        return Dialect(config.dialect)
    found = dialect_from_probe(client.ask(PROBE)) or dialect_from_version(version.text)
    if found is None:
        raise DeviceError(
            f"the unit on {client.where} is of an unknown dialect", "set ptu.dialect to d46 or e46"
        )
    return found


def _check_serial(client: PtuClient, wanted: str, dialect: Dialect) -> None:
    """Make sure that it is the very unit that the rig names: another one has other limits.

    Raises:
        DeviceError: it is another one.
        UsageError: its dialect has no word for its serial number.
    """
    if not offers(dialect).short_identity:
        raise UsageError(
            f"the unit on {client.where} cannot say its serial number", "leave out ptu.serial"
        )
    found = read_text(client, QUERY_SERIAL)
    if found != wanted:
        raise DeviceError(
            f"the pan-tilt unit on {client.where} is {found!r} instead of {wanted!r}",
            "check the ports, or give its serial number in ptu.serial; it was not moved",
        )


def _home(client: PtuClient, homing: Homing) -> None:
    bounds = [read_integer(client, query(axis, bound)) for axis in BOTH for bound in _BOUNDS]
    # an axis that was never homed has both limits 0 (manual v3.00D)
    if any(bounds[:2]) and any(bounds[2:]) and homing is not Homing.ALWAYS:
        return
    if homing is Homing.NEVER:
        raise UsageError(
            "the unit is not homed, and homing sweeps both axes over their whole range",
            "clear the rig and give --home",
        )
    client.resetting = True
    try:
        # once: a second reset would sweep again, and the first may only have been slow
        reply = client.exchange(RESET).reply
        if reply is None:
            raise client.silence(RESET)
        require_done(RESET, reply)
    finally:
        client.resetting = False
    bounds = [read_integer(client, query(axis, bound)) for axis in BOTH for bound in _BOUNDS]
    if not (any(bounds[:2]) and any(bounds[2:])):
        raise DeviceError("the unit was homed and still has no limits", "switch it off and on")


def _apply(client: PtuClient, settings: UnitSettings) -> None:
    """Set speeds and acceleration, at rest; the unit recomputes its tables for seconds."""
    wanted = (
        (Quantity.UPPER_SPEED, settings.upper_speed_deg_s),
        (Quantity.BASE_SPEED, settings.base_speed_deg_s),
        (Quantity.ACCELERATION, settings.acceleration_deg_s2),
    )
    for axis in BOTH:
        arcsec = read_resolution_arcsec(client, axis)
        for quantity, value_deg in wanted:
            if value_deg is None:
                continue
            steps = round(value_deg * ARCSEC_PER_DEG / arcsec)
            if read_integer(client, query(axis, quantity)) != steps:
                _set(client, axis, quantity, steps, value_deg)


def _set(client: PtuClient, axis: Axis, quantity: Quantity, steps: int, value_deg: float) -> None:
    name = f"{axis.word} {quantity.name.lower().replace('_', ' ')}"
    reply = client.ask(assign(axis, quantity, steps))
    if not reply.ok:
        raise UsageError(
            f"the unit refuses a {name} of {value_deg:g} {_IN_DEG[quantity]}: {reply.text}",
            "choose another in the program's settings",
        )
    answered = read_integer(client, query(axis, quantity))
    if answered != steps:
        raise UsageError(
            f"asked for a {name} of {value_deg:g} {_IN_DEG[quantity]}, {steps} in its steps, the "
            f"unit took {answered}",
            "choose one that it can do in the program's settings",
        )


def _for_the_record() -> tuple[PtuCommand, ...]:
    """Return questions whose answers are only recorded; a refusal is an answer too."""
    modes = [
        f(axis) for axis in BOTH for f in (query_step_mode, query_hold_power, query_move_power)
    ]
    return (QUERY_LIMITS, *modes, QUERY_POWER)
