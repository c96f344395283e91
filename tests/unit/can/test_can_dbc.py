"""DBC files and signals, against cantools: an independent reader and encoder."""

import contextlib
import math
import struct
from pathlib import Path

import pytest
from cantools.database.can import Database
from hypothesis import given, settings
from hypothesis import strategies as st

from gyrorig_protocol.can import (
    accel_frame,
    board_dbc,
    gyro_frame,
    health_frame,
    latch_frame,
    parse_dbc,
    status_frame,
    sync_frame,
)
from gyrorig_protocol.can.imu_presets import PRESETS
from gyrorig_protocol.errors import UsageError


def read_by_cantools(text: str) -> Database:
    database = Database()
    database.add_dbc_string(text)
    return database


def decoded(database: Database, identifier: int, data: bytes) -> dict[str, float]:
    values = database.decode_message(identifier, data, decode_choices=False)
    assert isinstance(values, dict)
    return {name: float(value) for name, value in values.items() if isinstance(value, int | float)}


SHIPPED = Path(__file__).resolve().parents[3] / "config" / "can" / "gyrorig-boards.dbc"


def test_the_shipped_dbc_file_is_current_and_readable_by_cantools() -> None:
    text = SHIPPED.read_text(encoding="utf-8")
    assert text == board_dbc(range(1, 17))
    theirs = read_by_cantools(text)
    assert len(theirs.messages) == 1 + 17 + 16 * 6


i16 = st.integers(-(2**15), 2**15 - 1)


@settings(max_examples=30, deadline=None)
@given(
    counts=st.tuples(i16, i16, i16),
    time=st.integers(0, 2**48 - 1),
    node=st.integers(1, 16),
    small=st.tuples(*[st.integers(0, 255)] * 4),
)
def test_cantools_decodes_our_frames(
    counts: tuple[int, int, int], time: int, node: int, small: tuple[int, int, int, int]
) -> None:
    theirs = _SHIPPED_DATABASE
    x, y, z = counts
    gyro, accel = gyro_frame(node, counts, time), accel_frame(node, counts, time)
    stamp = time & ~3 & (1 << 18) - 1
    assert decoded(theirs, gyro.identifier, gyro.data) == {
        "GyroX": x, "GyroY": y, "GyroZ": z, "Time": stamp,
    }  # fmt: skip
    assert decoded(theirs, accel.identifier, accel.data)["AccelZ"] == z
    latch = latch_frame(node, small[0], small[1], time)
    assert decoded(theirs, latch.identifier, latch.data) == {
        "Counter": small[0], "Boot": small[1], "Clock": time,
    }  # fmt: skip
    status = status_frame(node, time, time >> 3, small[1])
    assert decoded(theirs, status.identifier, status.data) == {
        "Time": time & 0xFFFF_FFFF, "Number": time >> 3 & 0xFFFF, "Boot": small[1],
    }  # fmt: skip
    health = health_frame(node, x, y if y != -32768 else 0, small)
    values = decoded(theirs, health.identifier, health.data)
    assert [values["Overruns"], values["Saturations"]] == [small[0], small[3]]
    sync = sync_frame(small[0])
    assert decoded(theirs, sync.identifier, sync.data) == {"Counter": small[0]}


_SHIPPED_DATABASE = read_by_cantools(SHIPPED.read_text(encoding="utf-8"))


@st.composite
def dbc_signals(draw: st.DrawFn) -> tuple[str, bool]:
    """A random DBC text with one signal in an 8-byte message."""
    length = draw(st.integers(1, 64))
    intel = draw(st.booleans())
    top = draw(st.integers(0, 64 - length))
    start = top if intel else top // 8 * 8 + 7 - top % 8
    is_float = length in (32, 64) and draw(st.booleans())
    signed = draw(st.booleans())
    factor = draw(st.sampled_from(["1", "0.5", "-0.01", "7.8125E-03", "3"]))
    offset = draw(st.sampled_from(["0", "-250", "1.5e2", "0.5"]))
    text = (
        'VERSION ""\nBS_:\nBU_: A\nBO_ 291 M: 8 A\n'
        f" SG_ S : {start}|{length}@{int(intel)}{'-' if signed else '+'} "
        f'({factor},{offset}) [0|0] "x" A\n'
    )
    if is_float:
        text += f"SIG_VALTYPE_ 291 S : {1 if length == 32 else 2};\n"
    return text, is_float


@settings(deadline=None)
@given(made=dbc_signals(), data=st.binary(min_size=8, max_size=8))
def test_signals_are_read_as_cantools_reads_them(made: tuple[str, bool], data: bytes) -> None:
    text, _ = made
    signal = parse_dbc(text, "x")["M"].signals["S"]
    value = decoded(read_by_cantools(text), 291, data)["S"]
    ours = signal.raw_value(data) * signal.factor + signal.offset
    if math.isnan(value):
        assert math.isnan(ours)
    else:
        assert ours == pytest.approx(value, rel=1e-12, abs=1e-300)


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_presets_are_read_as_cantools_reads_them(name: str) -> None:
    text = PRESETS[name].dbc
    theirs = read_by_cantools(text)
    data = struct.pack("<4H", 41000, 25000, 64255, 3)
    for message in parse_dbc(text, name).values():
        values = decoded(theirs, message.identifier, data)
        assert {s.name for s in message.signals.values()} == values.keys()
        for signal in message.signals.values():
            ours = signal.raw_value(data) * signal.factor + signal.offset
            assert ours == pytest.approx(values[signal.name], rel=1e-9, nan_ok=True)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "no CAN message"),
        ("BO_ x M: 8 A\n", "not a valid definition of a message"),
        (
            'BO_ 1 M: 8 A\n SG_ S : 60|16@1+ (1,0) [0|0] "" A\n',
            "ends in byte 10, but its message M",
        ),
        ('BO_ 1 M: 8 A\n SG_ S : 0|16@1+ (0,0) [0|0] "" A\n', "invalid factor .0."),
        ("BO_ 1 M: 8 A\n SG_ S : what\n", "not a valid definition of a signal"),
        ("BO_ 1 M: 8 A\nBO_ 1 M: 8 A\n", "defines the message M, but its name or its identifier"),
        (
            'BO_ 1 M: 8 A\n SG_ S : 0|16@1+ (1,0) [0|0] "" A\nSIG_VALTYPE_ 1 S : 1;\n',
            "the floating-point type 1, but the signal has 16 bits",
        ),
    ],
)
def test_the_error_names_the_fault_of_a_file(text: str, problem: str) -> None:
    with pytest.raises(UsageError, match=problem):
        parse_dbc(text, "imu.dbc")


@settings(max_examples=200, deadline=None)
@given(
    text=st.text(st.sampled_from(list('BO_SG VALTYPE0123456789|@+-(),.[]":; \nmM')), max_size=300)
)
def test_no_text_raises_anything_else(text: str) -> None:
    with contextlib.suppress(UsageError):
        parse_dbc("BO_ 1 M: 8 A\n SG_ " + text, "imu.dbc")


def test_multiplexed_signals_are_skipped() -> None:
    text = 'BO_ 1 M: 8 A\n SG_ S m0 : 0|8@1+ (1,0) [0|0] "" A\n SG_ T : 8|8@1+ (1,0) [0|0] "" A\n'
    assert list(parse_dbc(text, "x")["M"].signals) == ["T"]
