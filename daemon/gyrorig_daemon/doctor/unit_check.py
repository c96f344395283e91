"""Checks of the pan-tilt unit: identity, settings, homing, supply. Queries only.

What to use when: `check_unit` for a port that can be opened. Everything that is sent is a query:
the unit neither moves nor changes a setting, and a unit that is moving continues to move.
"""

import time
from collections.abc import Sequence

from gyrorig_daemon.config import PtuPort
from gyrorig_daemon.doctor.finding import Finding, fault, from_error, note, ok, warning
from gyrorig_daemon.doctor.port_session import open_for_check
from gyrorig_daemon.doctor.text_unit_check import check_text_unit
from gyrorig_daemon.halt.direct_ptu_line import DirectPtuLine
from gyrorig_daemon.halt.standalone_halt import FIRST_ANSWER_S, OTHER_BAUD_ANSWER_S, USUAL_BAUDS
from gyrorig_daemon.links.ports.serial_port import PortRefusedError, configure_raw
from gyrorig_daemon.motion import find_driver
from gyrorig_daemon.motion.drivers import directed_perception
from gyrorig_protocol.errors import DeviceError
from gyrorig_protocol.ptu import (
    PROBE,
    Axis,
    Dialect,
    FirmwareVersion,
    PowerReading,
    PtuCommand,
    Quantity,
    Reading,
    Refusal,
    RefusalKind,
    dialect_features,
    dialect_from_version,
    query_quantity,
)
from gyrorig_protocol.ptu.ptu_commands import QUERY_MODEL, QUERY_POWER, QUERY_SERIAL, QUERY_VERSION

SUBJECT = "unit"
CHECK_TIMEOUT_S = 20.0  # for all queries; ten at 0.1 s each in the slowest dialect
# PTU-E46 data sheet: 12 to 30 VDC. A volt less indicates a wire that is too thin.
LOW_SUPPLY_V = 11.0
HIGH_MOTOR_TEMPERATURE_C = 80.0
_BOUNDS = (Quantity.MINIMUM, Quantity.MAXIMUM)


def check_unit(config: PtuPort) -> list[Finding]:
    """Return the findings about the unit on `config.port`; its driver decides what is asked."""
    if config.is_person:
        return []  # there is no device to ask
    language = find_driver(config.driver).language
    if language is not None:
        return check_text_unit(config, language(config))
    if config.driver != directed_perception.NAME:
        message = f"the driver {config.driver} has no queries that can be sent without the daemon"
        return [note(SUBJECT, "not_asked", message)]
    bauds = tuple(dict.fromkeys((config.baud, *USUAL_BAUDS)))
    try:
        with open_for_check(config.port, config.baud) as fd:
            line = DirectPtuLine(fd, config.port, time.monotonic() + CHECK_TIMEOUT_S)
            return _check_answers(line, config, bauds)
    except PortRefusedError as error:
        message = f"the port {config.port} of the pan-tilt unit cannot be opened ({error})"
        return [fault(SUBJECT, error.reason, message, "see the other findings about this port")]
    except DeviceError as device_error:
        return [from_error(SUBJECT, "hung_up", device_error)]


def _check_answers(line: DirectPtuLine, config: PtuPort, bauds: Sequence[int]) -> list[Finding]:
    version_and_baud = _find_unit(line, bauds)
    if version_and_baud is None:
        return [_report_no_unit(line, config, bauds)]
    version, baud = version_and_baud
    dialect = _detect_dialect(line, version)
    line.min_interval_s = dialect_features(dialect or Dialect.D46).min_command_interval_s
    identity, serial = _read_identity(line, version, dialect, baud)
    findings = [identity, *_compare_with_config(config, baud, dialect, serial)]
    return [*findings, *_check_bounds(line), *_check_power(line)]


def _find_unit(line: DirectPtuLine, bauds: Sequence[int]) -> tuple[FirmwareVersion, int] | None:
    """Return the unit's firmware version, and the baud rate at which it answers."""
    for baud in bauds:
        if baud != bauds[0]:
            try:
                configure_raw(line.fd, baud)
            except PortRefusedError:
                continue  # the port does not support this rate
        line.send(b"   ")  # ends an incomplete command
        line.drain()
        wait_s = FIRST_ANSWER_S if baud == bauds[0] else OTHER_BAUD_ANSWER_S
        for _ in range(2):
            version = line.ask(QUERY_VERSION, wait_s)
            if isinstance(version, FirmwareVersion):
                line.drain()
                return version, baud
    return None


def _report_no_unit(line: DirectPtuLine, config: PtuPort, bauds: Sequence[int]) -> Finding:
    received = bytes(line.received_bytes)
    tried_bauds = ", ".join(map(str, bauds))
    if not received:
        return fault(
            SUBJECT,
            "silent",
            f"no pan-tilt unit answers on {config.port} at {tried_bauds} baud",
            "check the power of the unit, its cable (RS-232, crossed or straight) and its port",
        )
    if set(received) <= set(b" V"):
        return fault(
            SUBJECT,
            "echo_only",
            f"the device on {config.port} only sends back the bytes that it receives",
            "if the pan-tilt unit is homing after power-up, wait until it stops. If nothing "
            "moves, check whether a loop-back plug is on the line, and remove it",
        )
    return fault(
        SUBJECT,
        "wrong_device",
        f"the device on {config.port} is not a pan-tilt unit, because it sent {received[:24]!r}",
        "check the cables, and ptu.port in the rig file",
    )


def _detect_dialect(line: DirectPtuLine, version: FirmwareVersion) -> Dialect | None:
    answer = _ask_twice(line, PROBE)
    if isinstance(answer, int) and answer > 0:
        return Dialect.E46
    if isinstance(answer, Refusal) and answer.kind is RefusalKind.ILLEGAL_COMMAND:
        return Dialect.D46
    return dialect_from_version(version.text)


def _read_identity(
    line: DirectPtuLine, version: FirmwareVersion, dialect: Dialect | None, baud: int
) -> tuple[Finding, str]:
    """Return the identity of the unit, and its serial number ("" if it reports none)."""
    model = serial = ""
    if dialect is not None and dialect_features(dialect).model_and_serial_queries:
        answers = [_ask_twice(line, command) for command in (QUERY_MODEL, QUERY_SERIAL)]
        model, serial = (answer if isinstance(answer, str) else "" for answer in answers)
    identity = model or version.controller or "a pan-tilt unit"
    identity += f", serial {serial}" if serial else ""
    dialect_text = "an unknown dialect" if dialect is None else f"the dialect {dialect.value}"
    message = f"{identity}, firmware {version.number}, {dialect_text}, at {baud} baud"
    return ok(SUBJECT, "identity", message), serial


def _compare_with_config(
    config: PtuPort, baud: int, dialect: Dialect | None, serial: str
) -> list[Finding]:
    findings = []
    if config.serial is not None and serial != config.serial:
        message = (
            f"the serial number of the pan-tilt unit is {serial or 'not reported'}, but the "
            f"rig file has {config.serial}"
        )
        remedy = "check which unit is connected to this port, or correct ptu.serial in the rig file"
        findings.append(fault(SUBJECT, "wrong_unit", message, remedy))
    if baud != config.baud:
        message = (
            f"the pan-tilt unit answers at {baud} baud, but the rig file has {config.baud} baud"
        )
        findings.append(
            fault(SUBJECT, "wrong_baud", message, f"set ptu.baud in the rig file to {baud}")
        )
    if config.dialect == "auto":
        if dialect is None:
            message = "the replies of the pan-tilt unit do not show which command dialect it uses"
            findings.append(
                fault(
                    SUBJECT, "no_dialect", message, "set ptu.dialect in the rig file to d46 or e46"
                )
            )
    elif dialect is not None and config.dialect != dialect.value:
        message = (
            f"the pan-tilt unit uses the command dialect {dialect.value}, but `dialect` under "
            f"`ptu` in the rig file is {config.dialect}"
        )
        findings.append(
            fault(SUBJECT, "wrong_dialect", message, "set ptu.dialect in the rig file to auto")
        )
    return findings


def _check_bounds(line: DirectPtuLine) -> list[Finding]:
    """Return whether the unit is homed, and its range of motion."""
    findings, ranges = [], []
    for axis in (Axis.PAN, Axis.TILT):
        low, high = (_ask_twice(line, query_quantity(axis, bound)) for bound in _BOUNDS)
        if not (isinstance(low, int) and isinstance(high, int)):
            message = f"the pan-tilt unit does not report the limits of its {axis.label} axis"
            findings.append(
                fault(
                    SUBJECT, "no_bounds", message, "check the cable and the baud rate of the unit"
                )
            )
        elif not (low or high):  # an axis that was never homed has both 0 (manual v3.00D)
            message = f"the {axis.label} axis of the pan-tilt unit is not homed"
            remedy = (
                "remove all objects from the unit's range of motion. Then run `gyrorigd record` "
                "with --home, or set ptu.home_without_asking: true"
            )
            findings.append(warning(SUBJECT, "not_homed", message, remedy))
        else:
            ranges.append(f"{axis.label} {low} to {high}")
    if ranges:
        findings.append(
            ok(
                SUBJECT,
                "bounds",
                f"the pan-tilt unit is homed; its limits in steps are {', '.join(ranges)}",
            )
        )
    return findings


def _check_power(line: DirectPtuLine) -> list[Finding]:
    power = _ask_twice(line, QUERY_POWER)
    if not isinstance(power, PowerReading):
        return [
            note(
                SUBJECT,
                "no_power",
                "the pan-tilt unit does not report its supply voltage and its temperatures",
            )
        ]
    hottest_c = max(power.temperatures_c, default=0.0)
    if power.supply_v < LOW_SUPPLY_V:
        remedy = (
            "use a power supply and wires that give 12 to 30 V at the plug of the unit, also "
            "while it moves"
        )
        message = (
            f"the supply voltage of the pan-tilt unit is only {power.supply_v:.1f} V. With such a "
            "low voltage the motors are weak, and the unit loses steps"
        )
        return [warning(SUBJECT, "low_supply", message, remedy)]
    if hottest_c > HIGH_MOTOR_TEMPERATURE_C:
        return [
            warning(
                SUBJECT,
                "hot",
                f"the highest temperature in the pan-tilt unit is {hottest_c:.0f} degC, but it "
                f"should stay below {HIGH_MOTOR_TEMPERATURE_C:.0f} degC",
                "reduce the holding current, or let the unit cool down",
            )
        ]
    summary = (
        f"the pan-tilt unit has a supply voltage of {power.supply_v:.1f} V and a highest "
        f"temperature of {hottest_c:.0f} degC"
    )
    return [ok(SUBJECT, "power", summary)]


def _ask_twice(line: DirectPtuLine, command: PtuCommand) -> Reading | None:
    """Return a reply that was received twice, or the last one; replies have no checksum."""
    previous: Reading | None = None
    for _ in range(3):
        answer = line.ask(command, FIRST_ANSWER_S)
        if (
            answer is not None
            and type(answer) is type(previous)
            and (answer == previous or not isinstance(answer, int))
        ):
            return answer
        previous = answer if answer is not None else previous
    return previous
