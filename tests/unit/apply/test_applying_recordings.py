"""Recordings: the topic as other readers see it, and the rest of the file as it was."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording import recording_copy
from gyrorig_protocol.recording.messages import EventKind, ImuStatus, SessionEvent
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.salvage import read_strictly
from gyrorig_protocol.recording.writer import Attachment, RecordingWriter
from gyrorig_solver import Calibration, cli
from gyrorig_solver.apply.corrected_recording import apply_to_recording
from gyrorig_solver.calibration import calibration_document as documents
from gyrorig_solver.data.samples import load_samples

Captured = pytest.CaptureFixture[str]
DocumentFactory = Callable[..., documents.CalibrationDocument]
BOARD = BoardId("GY80-0007")
START_NS = 1_790_000_000_000_000_000
COUNT, RATE_HZ = 500, 100.0
SCALE = 0.00015271630954950384  # the golden calibration's
FORCE = 0.01


@pytest.fixture
def counts() -> np.ndarray:
    return np.random.default_rng(3).integers(-3000, 3000, size=(COUNT, 3))


@pytest.fixture
def source(tmp_path: Path, counts: np.ndarray) -> Path:
    """Write 5 s of a board: samples arrive in time but for 1 ms, two of them are not good."""
    board = {
        **{
            "uid": "0123456789abcdef",
            "odr_hz": "100",
            "sensor": "L3G4200D",
            "link": "serial",
            "tick_hz": "1000000.0",
        },
        **{"gyro_scale_rad_s": repr(SCALE), "accel_scale_m_s2": repr(FORCE)},
        **{"counter_bits": "32", "bandwidth_hz": "25.0", "config_hash": "c0ffee"},
    }
    metadata = {"session": "s", "anchor_utc_ns": "0", "anchor_monotonic_raw_ns": "0", "rig": "r"}
    taken_ns = np.rint(np.arange(COUNT) * 1e9 / RATE_HZ).astype(np.int64)
    status = np.full(COUNT, int(ImuStatus.ACCEL_VALID))
    status[100] |= int(ImuStatus.SATURATED)
    status[200] |= int(ImuStatus.REPEATED)
    writer = RecordingWriter(
        tmp_path / "in.mcap",
        {"gyrorig": metadata, f"gyrorig.board.{BOARD}": board},
        [Attachment("note.txt", "text/plain", b"hello")],
    )
    for first in range(0, COUNT, 50):
        rows = slice(first, first + 50)
        writer.write_imu_array(
            BOARD,
            host_time_ns=START_NS + taken_ns[rows] + 1_000_000,
            publish_time_ns=None,
            device_time=taken_ns[rows] // 1000,
            sequence=np.arange(COUNT)[rows],
            status=status[rows],
            temperature=np.zeros(COUNT, dtype=int)[rows],
            gyro=counts[rows],
            accel=np.tile([0, 0, 981], (COUNT, 1))[rows],
        )
        now_ns = int(START_NS + taken_ns[rows][-1] + 1_000_000)
        writer.write("/session/event", SessionEvent(now_ns, EventKind.NOTE, "program", f"{first}"))
        writer.flush()
    return writer.close()


def messages(path: Path) -> list[tuple[int, int, Any]]:
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        return [
            (m.message.log_time, m.message.publish_time, m.decoded_message)
            for m in reader.iter_decoded_messages(topics=[f"/board/{BOARD}/imu"])
        ]


def xyz(vector: Any) -> list[float]:
    return [vector.x, vector.y, vector.z]


def test_an_independent_reader_finds_the_true_rates(
    golden: Path, source: Path, tmp_path: Path, counts: np.ndarray
) -> None:
    out = tmp_path / "out.mcap"
    result_summary = apply_to_recording(Calibration.load(golden), source, out)
    result = messages(out)
    good = np.ones(COUNT, dtype=bool)
    good[[100, 200]] = False
    assert (result_summary.messages, result_summary.left_out, len(result)) == (498, 2, 498)
    plain = json.loads(
        json.dumps(documents.calibration_as_mapping(Calibration.load(golden).document))
    )
    gain, bias = plain["matrices"]["STM"], plain["parameters"]["bias"]["value"]
    wanted = np.linalg.solve(np.array(gain), (counts[good] * SCALE - bias).T).T
    output = np.array([xyz(m.angular_velocity) for _, _, m in result])
    np.testing.assert_allclose(output, wanted, atol=1e-12)
    turn = np.array(plain["matrices"]["M"])
    force = np.array([xyz(m.linear_acceleration) for _, _, m in result])
    np.testing.assert_allclose(force, np.tile(turn.T @ [0.0, 0.0, 9.81], (498, 1)), atol=1e-12)
    first_message = result[0][2]
    assert first_message.header.frame_id == f"{BOARD}/stage"
    assert first_message.orientation_covariance[0] == -1.0
    assert first_message.linear_acceleration_covariance[0] == 0.0
    covariance = np.array(first_message.angular_velocity_covariance).reshape(3, 3)
    undone = np.array(gain) @ covariance @ np.array(gain).T
    np.testing.assert_allclose(
        undone, np.diag(np.array([0.0005, 0.0005, 0.00075]) ** 2 * 25.0), atol=1e-18
    )


def test_timestamps_are_the_times_of_the_motion(golden: Path, source: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    apply_to_recording(Calibration.load(golden), source, out)
    samples = load_samples(read_recording(source), BOARD)
    wanted = samples.origin_ns + (samples.time_s[samples.usable] - 0.0125) * 1e9
    result = messages(out)
    stamp = np.array([m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for _, _, m in result])
    assert np.abs(stamp - wanted).max() < 300  # ns, of a double of 1.8e18
    assert [p for _, p, _ in result] == stamp.tolist()
    arrival = read_recording(source).imu(BOARD)["log_time"][samples.usable]
    assert [a for a, _, _ in result] == arrival.tolist()


def test_the_copy_contains_the_recording_unchanged(
    golden: Path, source: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out.mcap"
    apply_to_recording(Calibration.load(golden), source, out)
    old, new = read_recording(source), read_recording(out)
    assert new.is_complete
    for topic in old.topics:
        assert old.timed_messages(topic) == new.timed_messages(topic)
    assert [(a.name, a.data) for a in new.attachments] == [
        (a.name, a.data) for a in old.attachments
    ]
    about = new.metadata[f"gyrorig.applied.{BOARD}"]
    assert about["version"] == "1"
    assert about["calibration"].startswith("sha256:")
    assert {n: r for n, r in new.metadata.items() if "applied" not in n} == old.metadata
    counted = read_strictly(out)  # mcap's own reader, every checksum on
    assert counted[f"/board/{BOARD}/imu"] == 498
    with AnyReader([out], default_typestore=get_typestore(Stores.EMPTY)) as reader:
        topics = {c.topic: c.msgcount for c in reader.connections}
    assert topics[f"/board/{BOARD}/imu"] == 498


def test_messages_are_near_others_of_the_same_time(
    golden: Path, source: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out.mcap"
    apply_to_recording(Calibration.load(golden), source, out)
    with out.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    starts = [chunk_index.message_start_time for chunk_index in summary.chunk_indexes]
    assert starts == sorted(starts)
    assert len(starts) == 20


def test_batches_and_chunks_do_not_change_the_messages(
    golden: Path, source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = Calibration.load(golden)
    apply_to_recording(result, source, tmp_path / "one.mcap")
    monkeypatch.setattr(recording_copy, "MESSAGES_PER_CHUNK", 13)
    monkeypatch.setattr("gyrorig_solver.apply.corrected_recording.SAMPLES_PER_BATCH", 37)
    apply_to_recording(result, source, tmp_path / "two.mcap")
    first, two = messages(tmp_path / "one.mcap"), messages(tmp_path / "two.mcap")
    assert [(a, p) for a, p, _ in first] == [(a, p) for a, p, _ in two]
    rates = [np.array([xyz(m.angular_velocity) for _, _, m in result]) for result in (first, two)]
    np.testing.assert_allclose(rates[0], rates[1], rtol=1e-13)


def test_an_unfinished_recording_is_accepted(golden: Path, source: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap.part"
    cut.write_bytes(source.read_bytes()[:-9000])
    summary = apply_to_recording(Calibration.load(golden), cut, tmp_path / "out.mcap")
    assert 0 < summary.messages < 498
    assert summary.losses
    assert read_recording(tmp_path / "out.mcap").is_complete


def test_a_board_with_another_setting_is_rejected(
    document: DocumentFactory, source: Path, tmp_path: Path
) -> None:
    other = Calibration(document(config={"bandwidth_hz": 110.0}))
    with pytest.raises(
        InputError, match=r"bandwidth_hz = 110.*, but in .* has bandwidth_hz = 25\.0"
    ):
        apply_to_recording(other, source, tmp_path / "out.mcap")
    with pytest.raises(InputError, match="--board"):
        apply_to_recording(Calibration(document(board="B-9")), source, tmp_path / "out.mcap")
    summary = apply_to_recording(
        Calibration(document(board="B-9")), source, tmp_path / "out.mcap", str(BOARD)
    )
    assert summary.board == BOARD


def test_a_board_with_another_output_rate_is_rejected(
    document: DocumentFactory, source: Path, tmp_path: Path
) -> None:
    other = Calibration(document(config={"odr_hz": 200.0, "config_hash": None}))
    with pytest.raises(InputError, match=r"odr_hz = 200\.0, but in .* has odr_hz = 100"):
        apply_to_recording(other, source, tmp_path / "out.mcap")


def test_a_board_with_another_uid_is_rejected_or_remarked(
    document: DocumentFactory, source: Path, tmp_path: Path, capsys: Captured
) -> None:
    made = document()
    other = msgspec.structs.replace(made, board=msgspec.structs.replace(made.board, uid="OTHER"))
    path = tmp_path / "other.yaml"
    path.write_text(documents.calibration_as_yaml(other))
    command = ["apply", str(path), str(source), "-o", str(tmp_path / "out.mcap")]
    assert cli.run(command) == 3
    assert "this board has the uid '0123456789abcdef'" in capsys.readouterr().err
    assert cli.run([*command, "--board", str(BOARD)]) == 0
    assert "the calibration is of the uid 'OTHER'" in capsys.readouterr().out
    unknown = msgspec.structs.replace(
        made, board=msgspec.structs.replace(made.board, uid="unknown")
    )
    summary = apply_to_recording(Calibration(unknown), source, tmp_path / "two.mcap")
    assert summary.other_uid is None


def test_an_existing_copy_is_not_overwritten(golden: Path, source: Path, tmp_path: Path) -> None:
    result = Calibration.load(golden)
    apply_to_recording(result, source, tmp_path / "out.mcap")
    with pytest.raises(UsageError, match="never overwritten"):
        apply_to_recording(result, source, tmp_path / "out.mcap")
    with pytest.raises(InputError, match="already"):
        apply_to_recording(result, tmp_path / "out.mcap", tmp_path / "more.mcap")
    assert not list(tmp_path.glob("*.part"))


@pytest.mark.parametrize("lag_s", [0.0, 5.0])
def test_temperatures_are_taken_from_the_recording(
    document: DocumentFactory, tmp_path: Path, lag_s: float
) -> None:
    """A ramp of 1 K a second; a thermometer that is late by 5 s reads 5 K less than the die."""
    count = 800
    board = {"uid": "unknown", "sensor": "X", "link": "file", "gyro_scale_rad_s": repr(SCALE)}
    board |= {"tick_hz": "1e6", "temperature_scale_c": "0.01", "temperature_offset_c": "25.0"}
    metadata = {"session": "s", "anchor_utc_ns": "0", "anchor_monotonic_raw_ns": "0"}
    writer = RecordingWriter(
        tmp_path / "in.mcap", {"gyrorig": metadata, f"gyrorig.board.{BOARD}": board}
    )
    taken_ns = np.arange(count) * 50_000_000
    writer.write_imu_array(
        BOARD,
        host_time_ns=START_NS + taken_ns,
        publish_time_ns=None,
        device_time=taken_ns // 1000,
        sequence=np.arange(count),
        status=np.where(np.arange(count) % 2, 0, int(ImuStatus.TEMPERATURE_VALID)),
        temperature=5 * np.arange(count),
        gyro=np.zeros((count, 3), dtype=int),
    )
    source = writer.close()
    slope = {"value": [1e-3, 0.0, 0.0], "std": [0.0] * 3, "unit": "rad/s/K"}
    reference = {"value": [30.0], "std": [0.0], "unit": "degC"}
    lag = {"value": [lag_s], "std": [None], "unit": "s"}
    result = Calibration(
        document(
            parameters={
                **{"thermal_bias": slope, "thermal_bias.reference": reference},
                **({"thermal_bias.lag": lag} if lag_s else {}),
            },
            validity={"rate_rad_s": [-4.0, 4.0], "temperature_degc": [20.0, 70.0]},
        )
    )
    assert bool(result.not_applied) == bool(lag_s)
    summary = apply_to_recording(result, source, tmp_path / "out.mcap")
    assert (summary.messages, summary.outside_temperature) == (count, 0)
    made = [m for _, _, m in messages(tmp_path / "out.mcap")]
    output = np.array([xyz(m.angular_velocity) for m in made])
    degc = 25.0 + 0.05 * np.arange(count) + lag_s
    bias = np.array([0.0078125, -0.015625, 0.03125])
    read = -bias - np.outer(degc - 30.0, [1e-3, 0.0, 0.0])
    wanted = read @ result.correction.inverse.T
    inside = slice(100, -100)  # the ends of a smooth course rest on half of its readings
    np.testing.assert_allclose(output[inside], wanted[inside], atol=1e-4)  # 0.1 K
    assert {m.linear_acceleration_covariance[0] for m in made} == {-1.0}
    cold = result.document.validity.__class__(rate_rad_s=[-1.0, 1.0], temperature_degc=[20.0, 45.0])
    part = Calibration(msgspec.structs.replace(result.document, validity=cold))
    summary = apply_to_recording(part, source, tmp_path / "part.mcap")
    assert summary.messages == pytest.approx(410, abs=4)  # half a kelvin beyond 45 degC
    assert summary.messages + summary.outside_temperature == count
    hot = result.document.validity.__class__(rate_rad_s=[-1.0, 1.0], temperature_degc=[80.0, 90.0])
    with pytest.raises(InputError, match=r"valid from 80.0 to 90.0 degC"):
        apply_to_recording(
            Calibration(msgspec.structs.replace(result.document, validity=hot)),
            source,
            tmp_path / "no.mcap",
        )


def test_the_command_reports_its_result(
    golden: Path, source: Path, tmp_path: Path, capsys: Captured
) -> None:
    out = tmp_path / "out.mcap"
    assert cli.run(["apply", str(golden), str(source), "-o", str(out), "--json"]) == 0
    output = json.loads(capsys.readouterr().out)
    assert output["topic"] == f"/board/{BOARD}/imu"
    assert output["messages"] == 498
    assert math.isclose(output["left_out"], 2)
    args = ["apply", str(golden), str(source), "-o", str(tmp_path / "b.mcap"), "--columns", "a,b,c"]
    assert cli.run(args) == 2
    assert (
        "--unit, --temperature and --time are only for tables, but in.mcap is a recording"
        in capsys.readouterr().err
    )
    assert cli.run(["apply", str(golden), str(source), "-o", str(tmp_path / "b.bag")]) == 2
    assert ".mcap" in capsys.readouterr().err


def test_samples_without_an_acceleration(
    document: DocumentFactory, source: Path, tmp_path: Path
) -> None:
    """Their messages state that it was not measured; a correction that needs it leaves them out."""
    recording = read_recording(source)
    raw = recording.imu_columns(BOARD)
    status = raw.status.astype(np.int64)
    status[300:310] = 0
    writer = RecordingWriter(tmp_path / "part.mcap", recording.metadata)
    writer.write_imu_array(
        BOARD,
        host_time_ns=raw.host_time_ns,
        publish_time_ns=None,
        device_time=raw.device_time,
        sequence=raw.sequence,
        status=status,
        temperature=raw.temperature,
        gyro=raw.gyro,
        accel=np.where(status[:, None] == 0, 0, [0, 0, 981]),
    )
    part = writer.close()
    summary = apply_to_recording(Calibration(document()), part, tmp_path / "a.mcap")
    assert (summary.messages, summary.without_force) == (498, 0)
    made = [m for _, _, m in messages(tmp_path / "a.mcap")]
    is_unknown = [m.linear_acceleration_covariance[0] == -1.0 for m in made]
    assert np.flatnonzero(is_unknown).tolist() == list(range(298, 308))
    assert {xyz(m.linear_acceleration)[2] for m in made[298:308]} == {0.0}
    force = {"g_sensitivity": {"value": [1e-4] * 9, "std": [0.0] * 9, "unit": "rad/s/(m/s^2)"}}
    needs_force = Calibration(document(parameters=force))
    summary = apply_to_recording(needs_force, part, tmp_path / "b.mcap")
    assert (summary.messages, summary.without_force, summary.left_out) == (488, 10, 2)
