"""Checks of a unit of text lines: identity, baud rate, serial number, position. Queries only."""

import time

from gyrorig_daemon.config import PtuPort
from gyrorig_daemon.doctor.finding import Finding, fault, from_error, ok
from gyrorig_daemon.doctor.port_session import open_for_check
from gyrorig_daemon.halt.standalone_halt import FIRST_ANSWER_S
from gyrorig_daemon.halt.text_unit_halt import DirectTextLine
from gyrorig_daemon.links.ports.serial_port import PortRefusedError
from gyrorig_daemon.motion.text_language import TextLanguage
from gyrorig_protocol.errors import DeviceError

SUBJECT = "unit"
CHECK_TIMEOUT_S = 10.0
ATTEMPTS = 2


def check_text_unit(config: PtuPort, language: TextLanguage) -> list[Finding]:
    """Return the findings about the unit on `config.port`; nothing that moves it is sent."""
    try:
        with open_for_check(config.port, config.baud) as fd:
            line = DirectTextLine(fd, config.port, time.monotonic() + CHECK_TIMEOUT_S, language)
            line.drain()
            return _check_answers(line, config)
    except PortRefusedError as error:
        message = f"the port {config.port} of the pan-tilt unit cannot be opened ({error})"
        return [fault(SUBJECT, error.reason, message, "see the other findings about this port")]
    except DeviceError as device_error:
        return [from_error(SUBJECT, "hung_up", device_error)]


def _check_answers(line: DirectTextLine, config: PtuPort) -> list[Finding]:
    language = line.language
    identities = (line.find_identity(FIRST_ANSWER_S) for _ in range(ATTEMPTS))
    identity = next(filter(None, identities), None)
    if identity is None:
        received = bytes(line.received_bytes[:24])
        code, what = ("wrong_device", f"sent {received!r}") if received else ("silent", "is silent")
        message = (
            f"the device on {config.port} {what} at {config.baud} baud, unlike a unit of the "
            f"driver {language.name}"
        )
        remedy = "check the power and the cable of the unit, and ptu.port, ptu.baud and ptu.driver"
        return [fault(SUBJECT, code, message, remedy)]
    serial = identity.get("serial", "")
    name = identity.get("model") or language.name
    findings = [ok(SUBJECT, "identity", f"{name}, serial {serial or '-'}, at {config.baud} baud")]
    if config.serial is not None and serial != config.serial:
        message = f"the serial number of the unit is {serial!r}, but the rig file has " + repr(
            config.serial
        )
        remedy = "check which unit is connected to this port, or correct ptu.serial in the rig file"
        findings.append(fault(SUBJECT, "wrong_unit", message, remedy))
    for axis in language.axes:
        query = language.format(language.position, axis)
        steps, _ = language.read_positions(line.ask_line(query, FIRST_ANSWER_S) or "", axis)
        if axis not in steps:
            message = f"the unit does not answer {query!r} with its {axis.label} position"
            remedy = "correct `position` and `positions` under ptu.commands in the rig file"
            findings.append(fault(SUBJECT, "no_position", message, remedy))
    return findings
