"""Who is on the port, what it can do, and what it is set to: known before it moves.

Nothing moves an unknown device: first a version that a pan-tilt unit would answer, then
a halt, then the modes, one at a time. Resolution and limits are read after homing,
because an E46 does not know its gear before its first reset (reference: ptu-e46.md).
"""

from dataclasses import dataclass

from gyrorig_daemon.config import PtuPort
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
    require_integer,
    require_resolution_arcsec,
)
from gyrorig_protocol.ptu.commands import (
    ECHO_OFF,
    IMMEDIATE,
    INDEPENDENT_SPEED,
    QUERY_COUNTER_HZ,
    QUERY_LIMITS,
    QUERY_MODEL,
    QUERY_POWER,
    QUERY_SERIAL,
    QUERY_VERSION,
    RESET,
    TERSE,
    query_hold_power,
    query_move_power,
    query_step_mode,
)

ARCSEC_PER_DEG = 3600.0
BOTH = (Axis.PAN, Axis.TILT)


@dataclass(frozen=True, slots=True)
class AxisFacts:
    """One axis as the unit describes it; steps, steps/s and steps/s^2."""

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
        """Counted steps for a degree in the rig's sense of rotation."""
        return self.sign * ARCSEC_PER_DEG / self.resolution_arcsec

    def to_steps(self, angle_deg: float) -> int:
        """Return the position nearest to an angle."""
        return round(angle_deg * self.steps_per_deg)

    def to_speed(self, speed_deg_s: float) -> int:
        """Return the speed in steps/s nearest to one in deg/s."""
        return round(speed_deg_s * abs(self.steps_per_deg))


@dataclass(frozen=True, slots=True)
class UnitFacts:
    """One unit as it introduced itself."""

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
        """Return the recording's `gyrorig.ptu` record; unknown values are left out."""
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


@dataclass(frozen=True, slots=True)
class Unit:
    """An identified unit that is homed and at rest."""

    client: PtuClient
    facts: UnitFacts


def open_unit(client: PtuClient, config: PtuPort, settings: UnitSettings, may_home: bool) -> Unit:
    """Identify the unit, home it if need be and allowed, apply settings, read its facts.

    Args:
        client: the line to it.
        config: dialect and signs.
        settings: what the program wants it set to.
        may_home: the operator agrees to a sweep of both axes over their whole range.

    Raises:
        DeviceError: silent, not a pan-tilt unit, or it refuses what it must do.
        UsageError: it needs homing and may not, or cannot do the settings.
    """
    version = _identify(client)
    client.halt()  # what was here before may have left it turning
    for command in (ECHO_OFF, TERSE, INDEPENDENT_SPEED, IMMEDIATE):
        require_done(command, client.ask(command))
    dialect = _dialect(client, config, version)
    client.min_interval_s = offers(dialect).min_command_interval_s
    _home_if_needed(client, may_home)
    client.expects_banner = False
    _apply(client, config, settings)
    facts = _read_facts(client, config, version, dialect)
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
    raise DeviceError(
        f"what is on {client.where} is no pan-tilt unit: to V it says {heard[:40]!r}",
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


def _home_if_needed(client: PtuClient, may_home: bool) -> None:
    bounds = [_integer(client, query(axis, bound)) for axis in BOTH for bound in _BOUNDS]
    if any(bounds[:2]) and any(bounds[2:]):
        return  # an axis that was never homed has both limits 0 (manual v3.00D)
    if not may_home:
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
    bounds = [_integer(client, query(axis, bound)) for axis in BOTH for bound in _BOUNDS]
    if not (any(bounds[:2]) and any(bounds[2:])):
        raise DeviceError("the unit was homed and still has no limits", "switch it off and on")


def _apply(client: PtuClient, config: PtuPort, settings: UnitSettings) -> None:
    """Set speeds and acceleration, at rest; the unit recomputes its tables for seconds."""
    wanted = (
        (Quantity.UPPER_SPEED, settings.upper_speed_deg_s),
        (Quantity.BASE_SPEED, settings.base_speed_deg_s),
        (Quantity.ACCELERATION, settings.acceleration_deg_s2),
    )
    for axis in BOTH:
        command = query(axis, Quantity.RESOLUTION)
        arcsec = require_resolution_arcsec(command, client.ask(command))
        for quantity, value_deg in wanted:
            if value_deg is None:
                continue
            steps = round(value_deg * ARCSEC_PER_DEG / arcsec)
            if _integer(client, query(axis, quantity)) == steps:
                continue
            client.order(assign(axis, quantity, steps))
            answered = _integer(client, query(axis, quantity))
            if answered != steps:
                name = quantity.name.lower().replace("_", " ")
                raise DeviceError(
                    f"the unit took a {axis.word} {name} of {answered} instead of {steps}",
                    "choose one that it can do in the program's settings",
                )


def _read_facts(
    client: PtuClient, config: PtuPort, version: Version, dialect: Dialect
) -> UnitFacts:
    model = serial = ""
    counter_hz: int | None = None
    if offers(dialect).short_identity:
        model = _text(client, QUERY_MODEL)
        serial = _text(client, QUERY_SERIAL)
    if offers(dialect).motion_with_counter:
        counter_hz = _integer(client, QUERY_COUNTER_HZ)
    return UnitFacts(
        model=model or version.controller or "unknown",
        firmware=version.number,
        serial=serial,
        dialect=dialect,
        counter_hz=counter_hz,
        pan=_axis_facts(client, Axis.PAN, config.pan_sign),
        tilt=_axis_facts(client, Axis.TILT, config.tilt_sign),
        baud=client.baud,
    )


def _axis_facts(client: PtuClient, axis: Axis, sign: int) -> AxisFacts:
    command = query(axis, Quantity.RESOLUTION)
    return AxisFacts(
        resolution_arcsec=require_resolution_arcsec(command, client.ask(command)),
        min_steps=_integer(client, query(axis, Quantity.MINIMUM)),
        max_steps=_integer(client, query(axis, Quantity.MAXIMUM)),
        lower_speed=_integer(client, query(axis, Quantity.LOWER_SPEED)),
        upper_speed=_integer(client, query(axis, Quantity.UPPER_SPEED)),
        base_speed=_integer(client, query(axis, Quantity.BASE_SPEED)),
        acceleration=_integer(client, query(axis, Quantity.ACCELERATION)),
        sign=sign,
    )


def _for_the_record() -> tuple[PtuCommand, ...]:
    """Return questions whose answers are only recorded; a refusal is an answer too."""
    modes = [
        f(axis) for axis in BOTH for f in (query_step_mode, query_hold_power, query_move_power)
    ]
    return (QUERY_LIMITS, *modes, QUERY_POWER)


def _integer(client: PtuClient, command: PtuCommand) -> int:
    return require_integer(command, client.ask(command))


def _text(client: PtuClient, command: PtuCommand) -> str:
    answer = read(command, client.ask(command))
    return answer if isinstance(answer, str) else ""


_BOUNDS = (Quantity.MINIMUM, Quantity.MAXIMUM)
