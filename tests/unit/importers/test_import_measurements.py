"""Imports of files made here, sound and hostile; every recording passes an independent reader."""

import contextlib
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from gyrorig_protocol.documents import convert_document, parse_yaml
from gyrorig_protocol.errors import InputError, MachineError, UsageError
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.writer import RecordingWriter
from gyrorig_solver.data.samples import load_samples
from gyrorig_solver.importers import ImportMap, check_import_map, import_measurements
from gyrorig_solver.importers.measurement_columns import open_columns
from gyrorig_solver.reference import read_turns

BASE = """
schema: gyrorig/import/1
board: "B1"
sensor: "X"
time: {key: t, unit: s}
gyro: {keys: [g], unit: rad/s}
"""


def mapped(text: str = BASE) -> ImportMap:
    return check_import_map(convert_document(parse_yaml(text, "map"), ImportMap, "map"), "map")


def archive(path: Path, **arrays: object) -> Path:
    np.savez(path, **arrays)  # type: ignore[arg-type] # the stub takes arrays only
    return path


def sound(n: int = 200) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(1)
    return {"t": 1.0 + np.arange(n) * 0.01, "g": rng.normal(size=(n, 3))}


def messages(path: Path, topic: str) -> list[Any]:
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [m.decoded_message for m in reader.iter_decoded_messages(topics=[topic])]


def test_rates_survive_to_the_last_digit_kept(tmp_path: Path) -> None:
    data = sound()
    source = archive(tmp_path / "in.npz", **data)
    summary = import_measurements(source, mapped(), tmp_path / "out.mcap")
    result = messages(summary.path, "/board/B1/imu_raw")
    counts = np.array([m.gyro for m in result])
    assert np.abs(counts * 1e-7 - data["g"]).max() <= 0.5e-7 * 1.0001
    first = result[0]
    assert first.host_time.sec * 10**9 + first.host_time.nanosec == 10**9
    assert first.device_time == 10**9
    assert summary.samples == 200
    assert summary.duration_s == pytest.approx(1.99)


def test_table_and_archive_give_the_same_recording(tmp_path: Path) -> None:
    data = sound(50)
    rows = [
        "t,gx,gy,gz",
        *(",".join(map(repr, map(float, (t, *g)))) for t, g in zip(*data.values(), strict=True)),
    ]
    (tmp_path / "in.csv").write_text("\n".join(rows))
    first = import_measurements(archive(tmp_path / "in.npz", **data), mapped(), tmp_path / "a.mcap")
    three = mapped(BASE.replace("[g]", "[gx, gy, gz]"))
    two = import_measurements(tmp_path / "in.csv", three, tmp_path / "b.mcap")
    a, b = (messages(s.path, "/board/B1/imu_raw") for s in (first, two))
    assert [m.gyro for m in a] == [m.gyro for m in b]


def test_counts_stay_counts_and_offset_binary_becomes_signed(tmp_path: Path) -> None:
    data = {"t": np.arange(10) * 0.01, "g": np.full((10, 3), 32770, dtype=np.uint16)}
    text = BASE.replace("unit: rad/s}", "unit: counts, scale_rad_s: 1.0e-4, offset_counts: 32768}")
    summary = import_measurements(
        archive(tmp_path / "in.npz", **data), mapped(text), tmp_path / "o.mcap"
    )
    assert list(messages(summary.path, "/board/B1/imu_raw")[0].gyro) == [2, 2, 2]


def test_arrivals_keep_the_sample_count_as_the_clock(tmp_path: Path) -> None:
    data = {"t": np.repeat(np.arange(10) * 0.05, 5), "g": np.zeros((50, 3))}
    text = BASE.replace("unit: s}", "unit: s, stamp: arrival, rate_hz: 100.0}")
    summary = import_measurements(
        archive(tmp_path / "in.npz", **data), mapped(text), tmp_path / "o.mcap"
    )
    result = messages(summary.path, "/board/B1/imu_raw")
    assert [m.device_time for m in result] == list(range(50))


@pytest.mark.parametrize(("first_s", "later_s"), [(0.0, 1.0), (7.0, 0.0)])
def test_a_turn_of_samples_in_bursts_holds_every_sample(
    tmp_path: Path, first_s: float, later_s: float
) -> None:
    """The first samples of a burst were taken before any of them arrived."""
    arrival_s = first_s + np.repeat(np.arange(10) * 0.05, 5)
    text = BASE.replace("unit: s}", "unit: s, stamp: arrival, rate_hz: 100.0}")
    text += "turns: [{axis: [1.0, 0.0, 0.0], angle_deg: 360.0, std_deg: 1.0}]\n"
    source = archive(tmp_path / "in.npz", t=arrival_s, g=np.zeros((50, 3)))
    summary = import_measurements(source, mapped(text), tmp_path / "o.mcap")
    recording = read_recording(summary.path)
    samples = load_samples(recording, "B1")
    (turn,) = read_turns(recording.events(), samples.origin_ns).turns
    assert samples.time_s[0] == pytest.approx(-0.04, abs=1e-6)
    assert turn.interval.begin_s == pytest.approx(samples.time_s[0], abs=1e-6)
    assert turn.interval.end_s == pytest.approx(samples.time_s[-1], abs=1e-6)
    first = messages(summary.path, "/board/B1/imu_raw")[0].host_time
    assert first.sec + first.nanosec * 1e-9 == pytest.approx(first_s + later_s)


def test_lost_attitudes_and_rates_are_left_out_and_counted(tmp_path: Path) -> None:
    data = sound()
    data["g"][5] = np.nan
    data["q"] = np.tile([1.0, 0.0, 0.0, 0.0], (200, 1))
    data["q"][10:20] = np.nan
    text = BASE + "attitude: {keys: [q], order: wxyz, std_deg: 0.1}\n"
    summary = import_measurements(
        archive(tmp_path / "in.npz", **data), mapped(text), tmp_path / "o.mcap"
    )
    assert (summary.samples, summary.attitudes, summary.attitudes_lost) == (199, 190, 10)
    assert "1 rows without a gyro value" in summary.notes[0]
    sequence = [m.sequence for m in messages(summary.path, "/board/B1/imu_raw")]
    assert 5 not in sequence
    assert sequence[5] == 6
    attitude = messages(summary.path, "/reference/attitude")[0]
    assert list(attitude.orientation) == [0.0, 0.0, 0.0, 1.0]
    assert attitude.standard_deviation == pytest.approx(np.radians(0.1))


def test_accel_with_other_times_is_taken_from_the_nearest(tmp_path: Path) -> None:
    data = sound(100)
    data["ta"] = data["t"][::2] + 0.001
    data["a"] = np.full((50, 3), 9.81)
    text = BASE + "accel: {keys: [a], unit: m/s2, time: {key: ta}}\n"
    summary = import_measurements(
        archive(tmp_path / "in.npz", **data), mapped(text), tmp_path / "o.mcap"
    )
    result = messages(summary.path, "/board/B1/imu_raw")
    valid = [bool(m.status & 1 << 8) for m in result]
    assert valid == [i % 2 == 0 for i in range(100)]
    assert result[0].accel[0] == 9810000
    assert "difference is 1.000 ms, and 50 samples have no value nearby" in summary.notes[0]


def test_temperatures_that_a_recording_cannot_hold_are_reported(tmp_path: Path) -> None:
    data = sound(100)
    data["w"] = np.full(100, 25.0)
    data["w"][:60] = 298.0  # K
    data["w"][60:70] = np.nan
    text = BASE + "temperature: {key: w}\n"
    summary = import_measurements(
        archive(tmp_path / "in.npz", **data), mapped(text), tmp_path / "o.mcap"
    )
    (note,) = summary.notes
    assert "60 samples have no temperature in the recording" in note
    assert "outside -40.5 to 90.5 degC" in note


@pytest.mark.parametrize("rows", [199, 400])
def test_a_mask_of_rests_has_the_rows_of_the_gyro(rows: int, tmp_path: Path) -> None:
    text = BASE + "static_mask: {key: m, value: 1}\n"
    source = archive(tmp_path / "in.npz", **sound(), m=np.ones(rows))
    with pytest.raises(InputError, match=rf"has {rows} rows, but the gyro columns have 200"):
        import_measurements(source, mapped(text), tmp_path / "o.mcap")
    source = archive(tmp_path / "in.npz", **sound(), m=np.ones(200))
    assert import_measurements(source, mapped(text), tmp_path / "o.mcap").rests == 1


def test_turns_and_rests_become_phases(tmp_path: Path) -> None:
    (tmp_path / "list.json").write_text(
        '{"rest": {"start": 0, "end": 50}, "spin": {"start": 60, "end": 90}}'
    )
    text = BASE + (
        "sections: {name: list.json, static: [rest], "
        "turns: {spin: {axis: [0.0, 0.0, 1.0], angle_deg: -360.0, std_deg: 1.0}}}\n"
        "static: [{begin_s: 2.0}]\n"
    )
    summary = import_measurements(
        archive(tmp_path / "in.npz", **sound()), mapped(text), tmp_path / "o.mcap"
    )
    assert (summary.rests, summary.turns) == (2, 1)
    events = messages(summary.path, "/session/event")
    turn = next(e for e in events if e.phase == "turn")
    assert json.loads(turn.text) == {
        "axis": [0.0, 0.0, 1.0],
        "angle_rad": pytest.approx(-2 * np.pi),
        "std_rad": pytest.approx(np.radians(1.0)),
    }


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda d: d["t"].__setitem__(7, d["t"][6]), "do not increase at row 8. Sort"),
        (lambda d: d["t"].__setitem__(7, np.nan), "the time nan s of the gyro columns in row 8"),
        (
            lambda d: d["t"].__setitem__(slice(None), d["t"] * 1e12),
            "Correct `unit` under `time` in the import map",
        ),
        (
            lambda d: d["g"].__setitem__((3, 1), 1e30),
            "gyro value of sample 4 is too large for any sensor",
        ),
        (lambda d: d["g"].__setitem__((3, 1), np.inf), None),
        (lambda d: d["g"].fill(np.nan), "contain fewer than two rows of numbers"),
        (lambda d: d.__setitem__("g", d["g"][:, :2]), "has 2 columns, but 3 columns are needed"),
        (lambda d: d.__setitem__("t", d["t"][:-1]), "200 rows, but their time column has 199"),
        (lambda d: d.pop("g"), "contains no array 'g'"),
        (lambda d: d.__setitem__("g", np.array([object()] * 9)), "array g contains objects"),
        (
            lambda d: d.__setitem__("g", d["g"] * 1j),
            "array g contains complex128 values instead of real numbers. Save the",
        ),
        (lambda d: d.__setitem__("g", d["g"][None]), "have different lengths"),
        (lambda d: d.__setitem__("t", np.array(["x"] * 200)), "t contains <U1"),
    ],
)
def test_hostile_archives_are_rejected_in_one_line(
    tmp_path: Path, change: Callable[[dict[str, np.ndarray]], object], says: str | None
) -> None:
    data = sound()
    change(data)
    source, out = archive(tmp_path / "in.npz", **data), tmp_path / "o.mcap"
    if says is None:
        assert import_measurements(source, mapped(), out).samples == 199
        return
    with pytest.raises(InputError, match=says) as caught:
        import_measurements(source, mapped(), out)
    assert "\n" not in str(caught.value)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["in.npz"]


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "is empty"),
        (b"t,gx,gy,gz\n", "header, but no rows"),
        (b"t,gx,gy\n1,2,3\n", "no column 'gz'"),
        (
            b"t,gx,gy,gz\n0,2,3,4\n\n1,2,3,x\n",
            r"row 3 of the table in.csv has 'x' in the column gz, which is not a number. Correct",
        ),
        (b"t,gx,gy,gz\n1,2,3\n", "row 1 of the table in.csv has only 3 columns. Correct or remove"),
        (b"\xff\xfe\x00\x01" * 30, "is a binary file, not a text table"),
    ],
)
def test_hostile_tables_are_refused(tmp_path: Path, content: bytes, says: str) -> None:
    source = tmp_path / "in.csv"
    source.write_bytes(content)
    three = mapped(BASE.replace("[g]", "[gx, gy, gz]"))
    with pytest.raises(InputError, match=says):
        import_measurements(source, three, tmp_path / "o.mcap")
    assert not (tmp_path / "o.mcap").exists()
    assert not (tmp_path / "o.mcap.part").exists()


@settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
    max_examples=60,
)
@given(content=st.binary(max_size=300), suffix=st.sampled_from([".csv", ".npz"]))
def test_bytes_never_raise_anything_else(tmp_path: Path, content: bytes, suffix: str) -> None:
    source = tmp_path / f"in{suffix}"
    source.write_bytes(content)
    with contextlib.suppress(InputError):
        open_columns(source, ["a"])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (BASE + "colour: red\n", "map has the unknown key 'colour'"),
        (BASE.replace("rad/s", "rpm"), "gyro: unit is the text 'rpm'. Give one of"),
        (BASE.replace("unit: rad/s", "unit: counts"), "not its scale factor `scale_rad_s`"),
        (BASE.replace("{key: t, unit: s}", "{unit: s}"), "must contain one of the keys"),
        (
            BASE.replace("{key: t, unit: s}", "{key: t, stamp: arrival}"),
            "needs both the key `key` and the key `rate_hz`",
        ),
        (BASE.replace("[g]", "[gx, gy]"), "2 entries instead of 1 or 3"),
        (
            BASE + "turns: [{axis: [0.0, 0.0, 2.0], angle_deg: 1.0, std_deg: 1.0}]\n",
            "turn does not",
        ),
        (BASE + "sections: {name: ../x.json}\n", "sections: name is the text"),
    ],
)
def test_inconsistent_maps_are_rejected(text: str, says: str) -> None:
    with pytest.raises(UsageError, match=says):
        mapped(text)


def test_an_existing_recording_is_never_overwritten(tmp_path: Path) -> None:
    source = archive(tmp_path / "in.npz", **sound())
    (tmp_path / "o.mcap").write_bytes(b"precious")
    with pytest.raises(UsageError, match="exists"):
        import_measurements(source, mapped(), tmp_path / "o.mcap")
    assert (tmp_path / "o.mcap").read_bytes() == b"precious"


def test_a_recording_ends_in_mcap(tmp_path: Path) -> None:
    source = archive(tmp_path / "in.npz", **sound())
    with pytest.raises(UsageError, match=r"ends in \.mcap"):
        import_measurements(source, mapped(), tmp_path / "o.bag")


def test_no_file_remains_on_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise MachineError("no space left")

    monkeypatch.setattr(RecordingWriter, "write_imu_array", refuse)
    source = archive(tmp_path / "in.npz", **sound())
    with pytest.raises(MachineError):
        import_measurements(source, mapped(), tmp_path / "o.mcap")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["in.npz"]


def test_the_contract_judge_agrees(tmp_path: Path, contract_judge: Path) -> None:
    source = archive(tmp_path / "in.npz", **sound())
    summary = import_measurements(source, mapped(), tmp_path / "o.mcap", board="Other-1")
    assert summary.board == "Other-1"
    subprocess.run([sys.executable, contract_judge, summary.path], check=True)
