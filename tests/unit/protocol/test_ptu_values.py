"""Replies as values: vectors, stale answers, hostile texts, and what may be sent at all."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrorig_protocol.errors import DeviceError, UsageError
from gyrorig_protocol.ptu import (
    PROBE,
    Axis,
    Dialect,
    Done,
    Expects,
    Motion,
    Power,
    PowerState,
    PtuCommand,
    Quantity,
    Refusal,
    RefusalKind,
    Reply,
    StepMode,
    ValueFault,
    Version,
    assign,
    commands,
    dialect_from_probe,
    dialect_from_version,
    offers,
    query,
    read,
    require_done,
    require_integer,
    require_motion,
    require_resolution_arcsec,
    require_text,
)

VECTORS = Path(__file__).resolve().parents[3] / "firmware_protocol" / "vectors"
CASES: list[dict[str, Any]] = json.loads((VECTORS / "ptu_replies.json").read_text())["vectors"]
VALUES = [case for case in CASES if "command" in case]
PP = query(Axis.PAN, Quantity.POSITION)


def answer(text: str, ok: bool = True) -> Reply:
    return Reply(ok, text, "", b"", 0, 0)


@pytest.mark.parametrize("case", VALUES, ids=lambda case: str(case["name"]))
def test_vectors(case: dict[str, Any]) -> None:
    (reply,) = [event for event in case["events"] if event["kind"] == "Reply"]
    command = PtuCommand(case["command"], Expects[case["expects"]])
    reading = read(command, answer(reply["text"], reply["ok"]))
    wanted = case["value"]
    match reading:
        case ValueFault():
            assert wanted == {"fault": True}
        case Done():
            assert wanted == {"done": True}
        case Refusal():
            assert wanted == {"refusal": reading.kind.name, "bound": reading.bound}
        case Motion() | Version() | PowerState():
            for name, value in wanted.items():
                assert getattr(reading, name) == pytest.approx(
                    tuple(value) if isinstance(value, list) else value
                )
        case _:
            assert reading == wanted


@given(text=st.text(max_size=80) | st.from_regex(r"[-+0-9 PS(),.A-Za-z]{0,60}"), ok=st.booleans())
def test_reading_raises_nothing(text: str, ok: bool) -> None:
    for expects in Expects:
        for name in ("PP", "TX", "CNF", "", "PP100"):
            read(PtuCommand(name, expects), answer(text, ok))


@given(
    steps=st.integers(-(2**31) + 1, 2**31 - 1),
    axis=st.sampled_from(Axis),
    words=st.sampled_from(["Current", "Target"]),
)
def test_positions_verbose_and_terse(steps: int, axis: Axis, words: str) -> None:
    command = query(axis, Quantity.POSITION)
    assert read(command, answer(str(steps))) == steps
    text = f"{words} {axis.word.title()} position is {steps}"
    assert read(command, answer(text)) == steps
    other = query(Axis.TILT if axis is Axis.PAN else Axis.PAN, Quantity.POSITION)
    assert isinstance(read(other, answer(text)), ValueFault)


@given(numbers=st.tuples(*[st.integers(-(10**6), 10**6)] * 4), counter=st.integers(0, 2**64 - 1))
def test_motion_round_trips(numbers: tuple[int, int, int, int], counter: int) -> None:
    pan, tilt, pan_speed, tilt_speed = numbers
    text = f"P({pan},{tilt}) S({pan_speed},{tilt_speed}) {counter}"
    wanted = Motion(pan, tilt, pan_speed, tilt_speed, counter)
    assert read(commands.QUERY_MOTION_AND_COUNTER, answer(text)) == wanted
    assert isinstance(read(PP, answer(text)), ValueFault)


@pytest.mark.parametrize(
    "text", ["P(99999999999,0) S(0,0) 1", "P(0,0) S(0,0) 99999999999999999999", "P(1) S(0,0) 1"]
)
def test_what_is_no_motion(text: str) -> None:
    assert isinstance(read(commands.QUERY_MOTION_AND_COUNTER, answer(text)), ValueFault)


@pytest.mark.parametrize("text", ["2147483648", "-99999999999", "9" * 20, "22.5", "1 2", "", "is"])
def test_what_is_no_position(text: str) -> None:
    assert isinstance(read(PP, answer(text)), ValueFault)


@pytest.mark.parametrize("text", ["0.0", "3600.1", "185", "-185.1", "185.1 185.1", "nan", "1e3"])
def test_what_is_no_resolution(text: str) -> None:
    assert isinstance(read(query(Axis.PAN, Quantity.RESOLUTION), answer(text)), ValueFault)


def test_what_is_no_power_and_no_version() -> None:
    assert isinstance(read(commands.QUERY_POWER, answer("22")), ValueFault)
    assert isinstance(read(commands.QUERY_VERSION, answer("PTU")), ValueFault)
    assert isinstance(read(commands.QUERY_MODEL, answer("")), ValueFault)


def test_required_values() -> None:
    require_done(commands.TERSE, answer(""))
    assert require_integer(PP, answer("22")) == 22
    resolution = query(Axis.TILT, Quantity.RESOLUTION)
    assert require_resolution_arcsec(resolution, answer("46.2857")) == 46.2857
    motion = require_motion(commands.QUERY_MOTION, answer("P(1,2) S(3,4)"))
    assert motion.counter is None
    assert require_text(commands.QUERY_MODEL, answer("PTU-E46")) == "PTU-E46"
    assert require_text(commands.QUERY_VERSION, answer("v3.1.2, ...")) == "v3.1.2, ..."


@pytest.mark.parametrize(
    ("require", "command"),
    [
        (require_done, commands.TERSE),
        (require_integer, PP),
        (require_resolution_arcsec, query(Axis.PAN, Quantity.RESOLUTION)),
        (require_motion, commands.QUERY_MOTION),
        (require_text, commands.QUERY_MODEL),
    ],
)
def test_required_values_that_are_not_there(require: Any, command: PtuCommand) -> None:
    with pytest.raises(DeviceError, match="refused"):
        require(command, answer("Illegal Command Entered", ok=False))
    if command is not commands.QUERY_MODEL:
        with pytest.raises(DeviceError, match="answered"):
            require(command, answer("never mind"))
    with pytest.raises(DeviceError, match="answered"):
        require(commands.RESYNC, answer("22"))


def test_required_values_of_another_kind() -> None:
    for require in (require_integer, require_resolution_arcsec, require_motion, require_text):
        with pytest.raises(DeviceError):
            require(commands.TERSE, answer(""))
    with pytest.raises(DeviceError):
        require_done(PP, answer("22"))


def test_dialects() -> None:
    assert dialect_from_probe(answer("90000000")) is Dialect.E46
    assert dialect_from_probe(answer("Illegal Command Entered", ok=False)) is Dialect.D46
    assert dialect_from_probe(answer("what", ok=False)) is None
    assert dialect_from_probe(answer("0")) is None
    assert dialect_from_version("Pan-Tilt Controller v1.90.0r0(D46 C14/E), (C)") is Dialect.D46
    assert dialect_from_version("FLIR Pan-Tilt Controller v3.1.2(E46), ...") is Dialect.E46
    assert dialect_from_version("Pan-Tilt Controller v3.2.0(D48E)") is Dialect.E46
    assert dialect_from_version("v3.2.0") is None
    assert dialect_from_version("") is None
    assert offers(Dialect.E46).motion_with_counter
    assert not offers(Dialect.D46).motion_with_counter
    assert PROBE.encode() == b"CNF "


@given(
    axis=st.sampled_from(Axis),
    quantity=st.sampled_from(Quantity),
    value=st.integers(-(2**33), 2**33),
)
def test_assignments_are_commands_or_usage_errors(
    axis: Axis, quantity: Quantity, value: int
) -> None:
    try:
        data = assign(axis, quantity, value).encode()
    except UsageError:
        return
    assert re.fullmatch(rb"[PT][POSDABUL]-?\d{1,10} ", data)
    assert int(data[2:]) == value
    assert abs(value) < 2**31


def test_no_command_writes_the_eeprom_or_silences_the_unit() -> None:
    built = [value for value in vars(commands).values() if isinstance(value, PtuCommand)]
    for axis in Axis:
        built += [query(axis, quantity) for quantity in Quantity]
        built += [commands.halt(axis), commands.reset(axis)]
        built += [commands.query_step_mode(axis), commands.query_hold_power(axis)]
        built += [commands.query_move_power(axis)]
        built += [commands.set_step_mode(axis, mode) for mode in StepMode]
        built += [commands.set_hold_power(axis, p) for p in Power if p is not Power.HIGH]
        built += [commands.set_move_power(axis, p) for p in Power if p is not Power.OFF]
    texts = [command.text for command in built]
    assert not [text for text in texts if re.match(r"D[SFR]|LD|LU|@|M|U|_", text)]
    assert len(set(texts)) == len(texts)
    for command in built:
        assert command.encode() == command.text.encode() + b" "
        assert command.patience_s >= 1.0


def test_powers_that_make_no_sense() -> None:
    with pytest.raises(UsageError):
        commands.set_hold_power(Axis.PAN, Power.HIGH)
    with pytest.raises(UsageError):
        commands.set_move_power(Axis.PAN, Power.OFF)


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("Illegal Command Entered", RefusalKind.ILLEGAL_COMMAND),
        ("Pan acceleration cannot exceed 5000 positions/sec^2", RefusalKind.ACCELERATION),
        ("", RefusalKind.UNKNOWN),
    ],
)
def test_refusals(text: str, kind: RefusalKind) -> None:
    reading = read(PP, answer(text, ok=False))
    assert isinstance(reading, Refusal)
    assert reading.kind is kind
