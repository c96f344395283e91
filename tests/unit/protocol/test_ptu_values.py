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
    Acknowledgement,
    AnswerKind,
    Axis,
    Dialect,
    FirmwareVersion,
    MotionReading,
    PowerReading,
    PtuCommand,
    Quantity,
    Refusal,
    RefusalKind,
    Reply,
    ValueFault,
    assign_quantity,
    dialect_features,
    dialect_from_probe,
    dialect_from_version,
    ptu_commands,
    query_quantity,
    read_value,
    require_done,
    require_integer,
    require_resolution_arcsec,
)

VECTORS = Path(__file__).resolve().parents[3] / "firmware_protocol" / "vectors"
CASES: list[dict[str, Any]] = json.loads((VECTORS / "ptu_replies.json").read_text())["vectors"]
VALUES = [case for case in CASES if "command" in case]
PP = query_quantity(Axis.PAN, Quantity.POSITION)


def answer(text: str, ok: bool = True) -> Reply:
    return Reply(ok, text, "", b"", 0, 0)


@pytest.mark.parametrize("case", VALUES, ids=lambda case: str(case["name"]))
def test_vectors(case: dict[str, Any]) -> None:
    (reply,) = [event for event in case["events"] if event["kind"] == "Reply"]
    command = PtuCommand(case["command"], AnswerKind[case["expects"]])
    reading = read_value(command, answer(reply["text"], reply["ok"]))
    expected = case["value"]
    match reading:
        case ValueFault():
            assert expected == {"fault": True}
        case Acknowledgement():
            assert expected == {"done": True}
        case Refusal():
            assert expected == {"refusal": reading.kind.name, "bound": reading.bound}
        case MotionReading() | FirmwareVersion() | PowerReading():
            for name, value in expected.items():
                assert getattr(reading, name) == pytest.approx(
                    tuple(value) if isinstance(value, list) else value
                )
        case _:
            assert reading == expected


@given(text=st.text(max_size=80) | st.from_regex(r"[-+0-9 PS(),.A-Za-z]{0,60}"), ok=st.booleans())
def test_reading_raises_nothing(text: str, ok: bool) -> None:
    for expects in AnswerKind:
        for name in ("PP", "TX", "CNF", "", "PP100"):
            read_value(PtuCommand(name, expects), answer(text, ok))


@given(
    steps=st.integers(-(2**31) + 1, 2**31 - 1),
    axis=st.sampled_from(Axis),
    words=st.sampled_from(["Current", "Target"]),
)
def test_positions_verbose_and_terse(steps: int, axis: Axis, words: str) -> None:
    command = query_quantity(axis, Quantity.POSITION)
    assert read_value(command, answer(str(steps))) == steps
    text = f"{words} {axis.label.title()} position is {steps}"
    assert read_value(command, answer(text)) == steps
    other = query_quantity(Axis.TILT if axis is Axis.PAN else Axis.PAN, Quantity.POSITION)
    assert isinstance(read_value(other, answer(text)), ValueFault)


@given(numbers=st.tuples(*[st.integers(-(10**6), 10**6)] * 4), counter=st.integers(0, 2**64 - 1))
def test_motion_round_trips(numbers: tuple[int, int, int, int], counter: int) -> None:
    pan, tilt, pan_speed, tilt_speed = numbers
    text = f"P({pan},{tilt}) S({pan_speed},{tilt_speed}) {counter}"
    expected = MotionReading(pan, tilt, pan_speed, tilt_speed, counter)
    assert read_value(ptu_commands.QUERY_MOTION_AND_COUNTER, answer(text)) == expected
    assert isinstance(read_value(PP, answer(text)), ValueFault)


@pytest.mark.parametrize(
    "text", ["P(99999999999,0) S(0,0) 1", "P(0,0) S(0,0) 99999999999999999999", "P(1) S(0,0) 1"]
)
def test_invalid_motion_answers_are_faults(text: str) -> None:
    assert isinstance(read_value(ptu_commands.QUERY_MOTION_AND_COUNTER, answer(text)), ValueFault)


@pytest.mark.parametrize("text", ["2147483648", "-99999999999", "9" * 20, "22.5", "1 2", "", "is"])
def test_invalid_position_answers_are_faults(text: str) -> None:
    assert isinstance(read_value(PP, answer(text)), ValueFault)


@pytest.mark.parametrize("text", ["0.0", "3600.1", "185", "-185.1", "185.1 185.1", "nan", "1e3"])
def test_invalid_resolution_answers_are_faults(text: str) -> None:
    assert isinstance(
        read_value(query_quantity(Axis.PAN, Quantity.RESOLUTION), answer(text)), ValueFault
    )


def test_invalid_power_and_version_answers_are_faults() -> None:
    assert isinstance(read_value(ptu_commands.QUERY_POWER, answer("22")), ValueFault)
    assert isinstance(read_value(ptu_commands.QUERY_VERSION, answer("PTU")), ValueFault)
    assert isinstance(read_value(ptu_commands.QUERY_MODEL, answer("")), ValueFault)


def test_required_values() -> None:
    require_done(ptu_commands.TERSE_FEEDBACK, answer(""))
    assert require_integer(PP, answer("22")) == 22
    resolution = query_quantity(Axis.TILT, Quantity.RESOLUTION)
    assert require_resolution_arcsec(resolution, answer("46.2857")) == 46.2857


@pytest.mark.parametrize(
    ("require", "command"),
    [
        (require_done, ptu_commands.TERSE_FEEDBACK),
        (require_integer, PP),
        (require_resolution_arcsec, query_quantity(Axis.PAN, Quantity.RESOLUTION)),
    ],
)
def test_missing_required_values_raise(require: Any, command: PtuCommand) -> None:
    with pytest.raises(DeviceError, match="refused"):
        require(command, answer("Illegal Command Entered", ok=False))
    with pytest.raises(DeviceError, match="invalid answer"):
        require(command, answer("never mind"))
    with pytest.raises(DeviceError, match="invalid answer"):
        require(ptu_commands.RESYNCHRONISE, answer("22"))


def test_required_values_of_another_kind() -> None:
    for require in (require_integer, require_resolution_arcsec):
        with pytest.raises(DeviceError):
            require(ptu_commands.TERSE_FEEDBACK, answer(""))
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
    assert dialect_features(Dialect.E46).motion_with_counter
    assert not dialect_features(Dialect.D46).motion_with_counter
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
        data = assign_quantity(axis, quantity, value).encode()
    except UsageError:
        return
    assert re.fullmatch(rb"[PT][POSDABUL]-?\d{1,10} ", data)
    assert int(data[2:]) == value
    assert abs(value) < 2**31


def test_no_command_writes_the_eeprom_or_silences_the_unit() -> None:
    built = [value for value in vars(ptu_commands).values() if isinstance(value, PtuCommand)]
    for axis in Axis:
        built += [query_quantity(axis, quantity) for quantity in Quantity]
        built += [ptu_commands.halt_axis(axis), ptu_commands.reset_axis(axis)]
        built += [ptu_commands.query_step_mode(axis), ptu_commands.query_hold_power(axis)]
        built += [ptu_commands.query_move_power(axis)]
    texts = [command.text for command in built]
    assert not [text for text in texts if re.match(r"D[SFR]|LD|LU|@|M|U|_", text)]
    assert len(set(texts)) == len(texts)
    for command in built:
        assert command.encode() == command.text.encode() + b" "
        assert command.timeout_s >= 1.0


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("Illegal Command Entered", RefusalKind.ILLEGAL_COMMAND),
        ("Pan acceleration cannot exceed 5000 positions/sec^2", RefusalKind.ACCELERATION),
        ("", RefusalKind.UNKNOWN),
    ],
)
def test_refusals(text: str, kind: RefusalKind) -> None:
    reading = read_value(PP, answer(text, ok=False))
    assert isinstance(reading, Refusal)
    assert reading.kind is kind
