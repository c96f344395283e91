"""The protocols of boards: found by name, JSON lines of any quality, emulated ends."""

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from gyrorig_daemon.config import BoardPort, parse_rig
from gyrorig_daemon.emulator.board.emulated_protocol import find_emulated_protocol
from gyrorig_daemon.emulator.emulator_settings import BoardSettings
from gyrorig_protocol.board import ColumnMap, FaultCause, FrameEvent, FrameFault, Sample
from gyrorig_protocol.board_protocols import (
    SerialProtocol,
    find_protocol,
    find_serial_protocol,
    protocol_names,
)
from gyrorig_protocol.errors import UsageError

GOOD = b'{"t": 1000, "n": 7, "gyro": [1, -2, 3], "accel": [0, 0, 256], "temp": 251}\n'
SAMPLE = Sample(0, 7, 1000, (1, -2, 3), (0, 0, 256), 251)
MDPS = math.pi / 180e3


def json_board(**options: str) -> BoardPort:
    return BoardPort("B-1", port="/dev/x", format="json", options=dict(options))


def samples_of(board: BoardPort, data: bytes) -> list[Sample]:
    parser = find_serial_protocol(board.format).make_parser(board)
    events = parser.feed(b"half of a li\n" + data, 5)
    return [e.frame for e in events if isinstance(e, FrameEvent) and isinstance(e.frame, Sample)]


def test_protocols_are_found_by_name_and_place() -> None:
    assert set(protocol_names(on_bus=False)) == {"gcb1", "json", "text"}
    assert set(protocol_names(on_bus=True)) == {"gcb1", "signals"}
    with pytest.raises(UsageError, match="Did you mean text"):
        find_protocol("txt")
    with pytest.raises(UsageError, match="which a CAN bus does not support"):
        find_protocol("json", on_bus=True)


def test_every_serial_protocol_has_an_emulated_end() -> None:
    for name in protocol_names(on_bus=False):
        assert find_emulated_protocol(name).name == name
    with pytest.raises(UsageError, match="gcb1"):
        find_emulated_protocol("nothing")


def test_a_json_line_is_a_sample() -> None:
    assert samples_of(json_board(), GOOD) == [SAMPLE]


def test_a_json_line_without_its_time_is_a_gap() -> None:
    """Its time would be recorded as 0; a board that never sends a time is accepted."""
    untimed = GOOD.replace(b'"t": 1000, ', b"")
    assert samples_of(json_board(), GOOD + untimed + GOOD) == [SAMPLE, SAMPLE]
    assert [sample.device_time for sample in samples_of(json_board(), untimed * 2)] == [None, None]


def test_the_first_line_after_opening_is_dropped() -> None:
    parser = find_serial_protocol("json").make_parser(json_board())
    assert parser.feed(b', "gyro": [1, 2, 3]}\n', 0) == []
    parser.feed(GOOD[:20], 0)
    parser.reset()
    (event,) = parser.feed(GOOD[20:] + GOOD, 0)
    assert isinstance(event, FrameEvent)
    assert event.frame == SAMPLE


def test_options_rename_keys_and_give_units() -> None:
    board = json_board(
        gyro_key="w", gyro_unit="dps", time_unit="s", time_key="stamp", sequence_key=""
    )
    line = b'{"stamp": 1.25, "w": [0.5, 0, -0.25], "other": null}\n'
    (sample,) = samples_of(board, line)
    assert sample.device_time == 1_250_000_000
    scale = find_protocol("json").scales(board)["gyro_scale_rad_s"]
    assert isinstance(scale, float)
    assert sample.gyro[0] * scale == pytest.approx(math.radians(0.5), abs=scale)
    assert find_protocol("json").scales(board)["tick_hz"] == 1e9


@pytest.mark.parametrize(
    "line",
    [
        b"[1, 2, 3]\n",
        b'{"gyro": [1, 2]}\n',
        b'{"gyro": [1, 2, "3"]}\n',
        b'{"gyro": [1, 2, true]}\n',
        b'{"gyro": [1, 2, 1e99]}\n',
        b'{"gyro": [1, 2, 0.5]}\n',
        b'{"gyro": [1, 2, 3], "t": "now"}\n',
        b'{"gyro": [1, 2, 3], "t": -1}\n',
        b'{"gyro": [1, 2, 3], "\xf6": 1}\n',
        b'{"gyro": [1, 2, 1%s]}\n' % (b"0" * 330),
        b'{"gyro": [1, 2, 3], "n": -1}\n',
        b'{"gyro": [1, 2, 3], "temp": 99999}\n',
        b"[" * 400 + b"\n",
        b'{"gyro": [1, 2, 3]' + b" " * 600 + b"}\n",
    ],
)
def test_a_bad_line_is_one_fault(line: bytes) -> None:
    parser = find_serial_protocol("json").make_parser(json_board())
    events = parser.feed(b"\n" + line + GOOD, 0)
    assert [type(event) for event in events] == [FrameFault, FrameEvent]
    assert sum(parser.faults.values()) == 1
    assert set(parser.faults) == set(FaultCause)


@given(st.lists(st.binary(max_size=60) | st.just(GOOD), max_size=12), st.integers(1, 50))
def test_no_bytes_raise_and_cuts_do_not_matter(pieces: list[bytes], step: int) -> None:
    data = b"".join(pieces)
    whole = find_serial_protocol("json").make_parser(json_board()).feed(data, 0)
    parser = find_serial_protocol("json").make_parser(json_board())
    cut = [e for k in range(0, len(data), step) for e in parser.feed(data[k : k + step], 0)]
    assert [replace(event, offset=0) for event in cut] == [replace(e, offset=0) for e in whole]


COLUMNS = ColumnMap(
    gyro=(2, 3, 4), time=0, sequence=1, accel=(5, 6, 7), temperature=8, gyro_unit="mdps",
    accel_unit="g", time_unit="s", temperature_unit="degC",
)  # fmt: skip


@pytest.mark.parametrize("unit", ["counts", "dps", "mdps", "rad/s"])
def test_the_emulated_ends_and_the_parsers_agree(unit: str) -> None:
    frame = Sample(0, 40_000, 123_456_789, (32_767, -32_768, 1), (256, -1, 0), -55)
    columns = ColumnMap(gyro=(1, 2, 3), time=0, gyro_unit=unit)  # type: ignore[arg-type]
    options = {"gyro_unit": unit}
    for name, settings in (
        ("text", BoardSettings(format="text", columns=columns)),
        ("json", BoardSettings(format="json", options=options)),
    ):
        board = BoardPort("B-1", port="x", format=name, columns=settings.columns)
        if name == "json":
            board = json_board(**options)
        line = find_emulated_protocol(name).encode(frame, settings)
        (sample,) = samples_of(board, line)
        assert sample.device_time == frame.device_time
        scale = find_protocol(name).scales(board)["gyro_scale_rad_s"]
        expected = [n if scale is None else round(n * 8.75 * MDPS / 1e-7) for n in frame.gyro]
        assert list(sample.gyro) == pytest.approx(expected, abs=0 if scale is None else 6)


def test_an_emulated_line_has_the_columns_of_the_rig_file() -> None:
    frame = Sample(0, 40_000, 1_500_000, (1000, 0, -1000), (256, -256, 0), 251)
    settings = BoardSettings(format="text", columns=COLUMNS)
    line = find_emulated_protocol("text").encode(frame, settings)
    board = BoardPort("B-1", port="x", format="text", columns=COLUMNS)
    (sample,) = samples_of(board, line)
    assert (sample.device_time, sample.sequence) == (1_500_000_000, 40_000)
    assert sample.accel == (9_806_650, -9_806_650, 0)
    assert sample.temperature == 2510


def test_a_protocol_says_what_a_rig_file_must_have() -> None:
    rig = "rig: r\nptu: {port: emulated}\nboards:\n- {id: A, port: /dev/x, format: json"
    with pytest.raises(UsageError, match="`facts` of board A are incomplete"):
        parse_rig(f"{rig}, facts: {{uid: u, sensor: s}}}}\n", "rig.yaml")
    parse_rig(f"{rig}, facts: {{uid: u, sensor: s}}, options: {{gyro_unit: dps}}}}\n", "rig.yaml")
    text = json.dumps({"gyro_unit": "dps", "speed": 3})
    with pytest.raises(UsageError, match="speed"):
        parse_rig(f"{rig}, facts: {{uid: u, sensor: s}}, options: {text}}}\n", "rig.yaml")


def test_requests_are_those_of_the_protocol() -> None:
    gcb1 = find_protocol("gcb1")
    assert isinstance(gcb1, SerialProtocol)
    assert gcb1.hello_request() != gcb1.time_request(1, 2)
    assert not find_protocol("json").identifies_itself
