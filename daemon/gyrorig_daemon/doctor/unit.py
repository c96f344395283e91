"""The pan-tilt unit: whether it answers, what it is, and what it is set to. Only asked.

What to use when: `examine_unit`, for a port that can be opened. Every word that is sent
is a question: the unit neither moves nor changes a setting, and one that turns goes on.
"""

import time
from collections.abc import Sequence

from gyrorig_daemon.config import PtuPort
from gyrorig_daemon.doctor.finding import Finding, fault, from_error, note, ok, warning
from gyrorig_daemon.doctor.line import opened
from gyrorig_daemon.halt import FIRST_ANSWER_S, OTHER_ANSWER_S, USUAL_BAUDS
from gyrorig_daemon.halt_line import HaltLine
from gyrorig_daemon.links.serial_port import RefusedError, make_raw
from gyrorig_protocol.errors import DeviceError
from gyrorig_protocol.ptu import (
    PROBE,
    Axis,
    Dialect,
    PowerState,
    PtuCommand,
    Quantity,
    Reading,
    Refusal,
    RefusalKind,
    Version,
    dialect_from_version,
    offers,
    query,
)
from gyrorig_protocol.ptu.commands import QUERY_MODEL, QUERY_POWER, QUERY_SERIAL, QUERY_VERSION

SUBJECT = "unit"
PATIENCE_S = 20.0  # for everything; ten questions at 0.1 s each in the slowest dialect
# PTU-E46 data sheet: 12 to 30 VDC. A volt less is a wire that is too thin.
LOW_SUPPLY_V = 11.0
HOT_MOTOR_C = 80.0
_BOUNDS = (Quantity.MINIMUM, Quantity.MAXIMUM)


def examine_unit(config: PtuPort) -> list[Finding]:
    """Return what the unit on `config.port` says of itself."""
    bauds = tuple(dict.fromkeys((config.baud, *USUAL_BAUDS)))
    try:
        with opened(config.port, config.baud) as fd:
            line = HaltLine(fd, config.port, time.monotonic() + PATIENCE_S)
            return _examine(line, config, bauds)
    except RefusedError as refused:
        what = f"{config.port} cannot be opened: {refused}"
        return [fault(SUBJECT, refused.reason, what, "see the findings on its port")]
    except DeviceError as hung_up:
        return [from_error(SUBJECT, "hung_up", hung_up)]


def _examine(line: HaltLine, config: PtuPort, bauds: Sequence[int]) -> list[Finding]:
    found = _find(line, bauds)
    if found is None:
        return [_nobody(line, config, bauds)]
    version, baud = found
    spoken = _dialect(line, version)
    line.interval_s = offers(spoken or Dialect.D46).min_command_interval_s
    identity, serial = _identity(line, version, spoken, baud)
    findings = [identity, *_as_configured(config, baud, spoken, serial)]
    return [*findings, *_bounds(line), *_power(line)]


def _find(line: HaltLine, bauds: Sequence[int]) -> tuple[Version, int] | None:
    """Return what the unit says to `V`, and the rate at which it does."""
    for baud in bauds:
        if baud != bauds[0]:
            try:
                make_raw(line.fd, baud)
            except RefusedError:
                continue  # this port has no such rate
        line.send(b"   ")  # ends what was cut short
        line.drain()
        wait_s = FIRST_ANSWER_S if baud == bauds[0] else OTHER_ANSWER_S
        for _ in range(2):
            version = line.ask(QUERY_VERSION, wait_s)
            if isinstance(version, Version):
                line.drain()
                return version, baud
    return None


def _nobody(line: HaltLine, config: PtuPort, bauds: Sequence[int]) -> Finding:
    heard = bytes(line.heard)
    tried = ", ".join(map(str, bauds))
    if not heard:
        return fault(
            SUBJECT,
            "silent",
            f"nothing answers on {config.port} at {tried} baud",
            "check its power and the cable (RS-232, crossed or not), and the port",
        )
    if set(heard) <= set(b" V"):
        return fault(
            SUBJECT,
            "echo_only",
            f"what is on {config.port} only sends back what it is sent",
            "wait if the unit homes after power-up; if nothing turns, look for a loop-back plug",
        )
    return fault(
        SUBJECT,
        "wrong_device",
        f"what is on {config.port} is no pan-tilt unit: it says {heard[:24]!r}",
        "check which cable is which: ptu.port in the rig's configuration",
    )


def _dialect(line: HaltLine, version: Version) -> Dialect | None:
    answer = _ask(line, PROBE)
    if isinstance(answer, int) and answer > 0:
        return Dialect.E46
    if isinstance(answer, Refusal) and answer.kind is RefusalKind.ILLEGAL_COMMAND:
        return Dialect.D46
    return dialect_from_version(version.text)


def _identity(
    line: HaltLine, version: Version, spoken: Dialect | None, baud: int
) -> tuple[Finding, str]:
    """Return who it is, and its serial number, "" where it has none."""
    model = serial = ""
    if spoken is not None and offers(spoken).short_identity:
        words = [_ask(line, command) for command in (QUERY_MODEL, QUERY_SERIAL)]
        model, serial = (word if isinstance(word, str) else "" for word in words)
    who = model or version.controller or "a pan-tilt unit"
    who += f", serial {serial}" if serial else ""
    says = "an unknown dialect" if spoken is None else f"the dialect {spoken.value}"
    what = f"{who}, firmware {version.number}, {says}, at {baud} baud"
    return ok(SUBJECT, "identity", what), serial


def _as_configured(
    config: PtuPort, baud: int, spoken: Dialect | None, serial: str
) -> list[Finding]:
    findings = []
    if config.serial is not None and serial != config.serial:
        what = f"its serial number is {serial or 'not told'}, and the rig's is {config.serial}"
        remedy = "check which unit is on this port, or change ptu.serial"
        findings.append(fault(SUBJECT, "wrong_unit", what, remedy))
    if baud != config.baud:
        what = f"it answers at {baud} baud, and the configuration says {config.baud}"
        findings.append(fault(SUBJECT, "wrong_baud", what, f"set ptu.baud to {baud}"))
    if config.dialect == "auto":
        if spoken is None:
            what = "its dialect is not to be told by its answers"
            findings.append(fault(SUBJECT, "no_dialect", what, "set ptu.dialect to d46 or e46"))
    elif spoken is not None and config.dialect != spoken.value:
        what = f"it speaks {spoken.value}, and the configuration says {config.dialect}"
        findings.append(fault(SUBJECT, "wrong_dialect", what, "set ptu.dialect to auto"))
    return findings


def _bounds(line: HaltLine) -> list[Finding]:
    """Return whether it is homed, and how far it goes."""
    findings, ranges = [], []
    for axis in (Axis.PAN, Axis.TILT):
        low, high = (_ask(line, query(axis, bound)) for bound in _BOUNDS)
        if not (isinstance(low, int) and isinstance(high, int)):
            what = f"it does not tell the bounds of its {axis.word} axis"
            findings.append(fault(SUBJECT, "no_bounds", what, "check the cable and the baud rate"))
        elif not (low or high):  # an axis that was never homed has both 0 (manual v3.00D)
            what = f"its {axis.word} axis is not homed: it has forgotten where it is"
            remedy = "clear the rig, then gyrorigd record --home, or ptu.home_without_asking: true"
            findings.append(warning(SUBJECT, "not_homed", what, remedy))
        else:
            ranges.append(f"{axis.word} {low} to {high}")
    if ranges:
        findings.append(ok(SUBJECT, "bounds", f"homed; in steps: {', '.join(ranges)}"))
    return findings


def _power(line: HaltLine) -> list[Finding]:
    power = _ask(line, QUERY_POWER)
    if not isinstance(power, PowerState):
        return [note(SUBJECT, "no_power", "it does not tell its supply and its temperatures")]
    hottest_c = max(power.temperatures_c, default=0.0)
    says = f"supply {power.supply_v:.1f} V, {hottest_c:.0f} degC at the hottest"
    if power.supply_v < LOW_SUPPLY_V:
        remedy = "give it 12 to 30 V at its plug while it moves: thicker or shorter wires"
        return [warning(SUBJECT, "low_supply", f"{says}: it will lose steps", remedy)]
    if hottest_c > HOT_MOTOR_C:
        return [warning(SUBJECT, "hot", says, "lower the holding current, or let it rest")]
    return [ok(SUBJECT, "power", says)]


def _ask(line: HaltLine, command: PtuCommand) -> Reading | None:
    """Return an answer that came twice the same, or the last one: no answer has a check."""
    before: Reading | None = None
    for _ in range(3):
        answer = line.ask(command, FIRST_ANSWER_S)
        if (
            answer is not None
            and type(answer) is type(before)
            and (answer == before or not isinstance(answer, int))
        ):
            return answer
        before = answer if answer is not None else before
    return before
