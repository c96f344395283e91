"""Logs of phones, flights and sensors: imported by one command, solved, compared with the truth."""

import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.support.flight_log_writers import (
    blackbox_session,
    dataflash_head,
    dataflash_message,
    write_blackbox,
    write_dataflash,
    write_ulog,
)
from tests.support.handheld_session import (
    BIAS_RAD_S,
    GAIN,
    START_NS,
    HandheldSession,
    simulate_session,
    write_phyphox,
    write_sensor_logger,
    write_ximu3,
    write_xsens,
)

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.calibration.calibration_document import parse_calibration
from gyrorig_solver.data.samples import GyroSamples, load_samples
from gyrorig_solver.estimate import fit_gravity
from gyrorig_solver.importers import ImportOptions, import_files

Writer = Callable[[Path, HandheldSession], Path]
GRAVITY_M_S2 = 9.80665


@pytest.fixture(scope="module")
def session() -> HandheldSession:
    return simulate_session(7)


@pytest.fixture(scope="module")
def brief() -> HandheldSession:
    """A session that is long enough for tests that fit nothing."""
    return simulate_session(7, moves=10)


def imported(source: Path, out: Path, board: str | None = None) -> GyroSamples:
    """Import a file without the name of its format."""
    import_files([source], out)
    recording = read_recording(out)
    return load_samples(recording, board or recording.board_ids[0])


@pytest.mark.parametrize(
    ("write", "quantum_rad_s"),
    [
        (write_sensor_logger, 0.0),
        (write_phyphox, 0.0),
        (lambda folder, s: write_phyphox(folder, s, ";"), 0.0),
        (write_ximu3, 0.0),
        (write_xsens, 0.0),
        (lambda folder, s: write_xsens(folder, s, delta=True), 0.0),
        (lambda folder, s: write_xsens(folder, s, fine=False), 0.0),
        (write_ulog, 0.0),
        (write_dataflash, 0.0),
        (lambda folder, s: write_dataflash(folder, s, ["IMT", "ACC"]), 0.0),
        (write_blackbox, np.radians(0.1)),
    ],
    ids=[
        "sensor-logger", "phyphox", "phyphox-semicolon", "x-imu3", "xsens", "xsens-delta-q",
        "xsens-packet-counter", "ulog", "dataflash", "dataflash-delta-angle", "blackbox",
    ],
)  # fmt: skip
def test_each_format_gives_the_truth_that_was_put_in(
    tmp_path: Path, session: HandheldSession, write: Writer, quantum_rad_s: float
) -> None:
    samples = imported(write(tmp_path, session), tmp_path / "out.mcap")
    assert samples.time_s.size == session.time_s.size
    error = np.abs(samples.rate_rad_s - session.rate_rad_s).max()
    assert error <= 0.51 * quantum_rad_s + 2e-7
    fit = fit_gravity(samples, GRAVITY_M_S2)
    assert fit.observability.rank == 12
    assert np.abs((fit.gain - GAIN) / fit.gain_std).max() < 4.0
    np.testing.assert_allclose(fit.bias_rad_s, BIAS_RAD_S, atol=3e-4)


def test_a_phone_keeps_its_clock_and_the_time_of_day(
    tmp_path: Path, brief: HandheldSession
) -> None:
    samples = imported(write_sensor_logger(tmp_path, brief), tmp_path / "out.mcap")
    assert abs(samples.origin_ns - (START_NS - 13_700_000)) < 1_000_000
    assert np.abs(samples.time_s - brief.time_s).max() < 1e-6


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_a_pause_of_phyphox_is_counted(
    tmp_path: Path, brief: HandheldSession, delimiter: str
) -> None:
    """Before, the pause and the time of day were lost with a semicolon or a tab."""
    samples = imported(write_phyphox(tmp_path, brief, delimiter), tmp_path / "out.mcap")
    assert abs(samples.origin_ns - START_NS) < 1_000_000
    assert samples.metadata["model"] == "Pixel 6a"
    assert samples.time_s[699] == pytest.approx(6.99, abs=1e-6)
    assert samples.time_s[700] == pytest.approx(7.0 + 4.5 + 0.001, abs=2e-3)


def test_the_uncalibrated_gyroscope_is_preferred_and_a_topic_selects_the_other(
    tmp_path: Path, brief: HandheldSession
) -> None:
    source = write_sensor_logger(tmp_path, brief)
    import_files([source], tmp_path / "o.mcap", ImportOptions(topics=("Gyroscope",)))
    samples = load_samples(read_recording(tmp_path / "o.mcap"), "PHONE")
    wanted = brief.rate_rad_s - brief.bias_rad_s
    assert np.abs(samples.rate_rad_s - wanted).max() < 2e-7


@pytest.mark.parametrize(
    ("write", "topic"),
    [
        (write_ulog, "vehicle_attitude"),
        (write_dataflash, "XKQ"),
        (write_ximu3, "Quaternion"),
        (write_xsens, "Quat"),
    ],
    ids=["ulog", "dataflash", "x-imu3", "xsens"],
)
def test_an_attitude_of_the_same_gyro_is_a_reference_only_on_request(
    tmp_path: Path, brief: HandheldSession, write: Writer, topic: str
) -> None:
    source = write(tmp_path, brief)
    plain = import_files([source], tmp_path / "plain.mcap")
    assert plain.attitudes == 0
    (note,) = [note for note in plain.notes if "not used as a reference" in note]
    assert "same gyroscope" in note
    assert f"--topic {topic}" in note
    asked = import_files([source], tmp_path / "asked.mcap", ImportOptions(topics=(topic,)))
    assert asked.attitudes > 1000
    assert any("same gyroscope" in note for note in asked.notes)


def test_motion_capture_in_a_ulog_is_a_reference(tmp_path: Path, brief: HandheldSession) -> None:
    names = ("sensor_gyro", "vehicle_mocap_odometry", "vehicle_attitude")
    summary = import_files([write_ulog(tmp_path, brief, names)], tmp_path / "o.mcap")
    assert summary.attitudes == brief.time_s.size


def test_several_gyroscopes_are_several_boards(tmp_path: Path, brief: HandheldSession) -> None:
    names = ("sensor_gyro#0", "sensor_gyro#2", "battery_status")
    summary = import_files([write_ulog(tmp_path, brief, names)], tmp_path / "o.mcap")
    assert summary.board == "GYRO-0"
    assert summary.other_boards == {"GYRO-2": brief.time_s.size}
    log = write_dataflash(tmp_path, brief, ["GYR", "GYR2"])
    summary = import_files([log], tmp_path / "p.mcap", ImportOptions(board="QUAD"))
    assert (summary.board, list(summary.other_boards)) == ("QUAD-0", ["QUAD-1"])


def test_a_slow_topic_is_passed_over(tmp_path: Path, brief: HandheldSession) -> None:
    """PX4 logs sensor_gyro with 1 Hz by default, and sensor_combined fast."""
    names = ("sensor_gyro", "sensor_combined")
    log = write_ulog(tmp_path, brief, names, slow=["sensor_gyro"])
    summary = import_files([log], tmp_path / "o.mcap")
    assert summary.samples == brief.time_s.size
    assert any("sensor_gyro was logged with only 1 Hz" in note for note in summary.notes)


def test_delta_angles_of_vehicle_imu_are_rates(tmp_path: Path, brief: HandheldSession) -> None:
    samples = imported(write_ulog(tmp_path, brief, ["vehicle_imu"]), tmp_path / "o.mcap")
    assert np.abs(samples.rate_rad_s - brief.rate_rad_s).max() < 2e-6


def test_pyulog_writes_and_reads_the_same_log(tmp_path: Path, brief: HandheldSession) -> None:
    """The format's own library writes the log that is imported."""
    pyulog = pytest.importorskip("pyulog")
    source = write_ulog(tmp_path, brief)
    rewritten = tmp_path / "rewritten.ulg"
    pyulog.ULog(str(source)).write_ulog(str(rewritten))
    assert rewritten.read_bytes() != source.read_bytes()  # the rows are in the order of time
    samples = imported(rewritten, tmp_path / "o.mcap")
    assert np.abs(samples.rate_rad_s - brief.rate_rad_s).max() < 2e-7


def test_pymavlink_reads_the_same_values(tmp_path: Path, brief: HandheldSession) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        reader = pytest.importorskip("pymavlink.DFReader")
        source = write_dataflash(tmp_path, brief)
        log = reader.DFReader_binary(str(source))
        theirs = []
        while (message := log.recv_match(type="GYR")) is not None:
            theirs.append([message.SampleUS, message.GyrX, message.GyrY, message.GyrZ])
        log.data_map.close()
        log.filehandle.close()
    samples = imported(source, tmp_path / "o.mcap")
    values = np.array(theirs)
    assert np.abs(samples.rate_rad_s - values[:, 1:]).max() < 1e-7
    assert np.array_equal(np.rint(samples.time_s * 1e6), values[:, 0] - values[0, 0])


def test_temperatures_are_imported(tmp_path: Path, brief: HandheldSession) -> None:
    for write in (write_ulog, write_dataflash, write_ximu3, write_xsens):
        folder = tmp_path / write.__name__
        folder.mkdir()
        samples = imported(write(folder, brief), folder / "o.mcap")
        assert samples.temperature_degc is not None
        finite = np.isfinite(samples.temperature_degc)
        off = samples.temperature_degc[finite] - brief.temperature_degc[finite]
        assert finite.sum() >= brief.time_s.size // 100 - 1
        assert np.abs(off).max() < 0.02


def test_damage_in_a_flight_log_costs_only_what_it_hits(
    tmp_path: Path, brief: HandheldSession
) -> None:
    log = bytearray(write_dataflash(tmp_path, brief, ["GYR"]).read_bytes())
    log[20_000:20_100] = bytes(100)
    (tmp_path / "damaged.bin").write_bytes(log)
    summary = import_files([tmp_path / "damaged.bin"], tmp_path / "o.mcap")
    assert brief.time_s.size - 6 <= summary.samples < brief.time_s.size
    assert any("bytes of the log are damaged" in note for note in summary.notes)
    blackbox = bytearray(blackbox_session(brief))
    blackbox[60_000:60_040] = bytes(40)
    (tmp_path / "damaged.bbl").write_bytes(blackbox)
    summary = import_files([tmp_path / "damaged.bbl"], tmp_path / "p.mcap")
    assert brief.time_s.size - 100 <= summary.samples < brief.time_s.size
    samples = load_samples(read_recording(tmp_path / "p.mcap"), "BETAFLIGHT")
    index = np.rint(samples.time_s * 100.0).astype(int)
    off = np.abs(samples.rate_rad_s - brief.rate_rad_s[index]).max()
    assert off < np.radians(0.06)


def test_sessions_of_a_blackbox_log_can_be_selected(tmp_path: Path, brief: HandheldSession) -> None:
    source = write_blackbox(tmp_path, brief)
    longest = import_files([source], tmp_path / "o.mcap")
    assert any("2 sessions, and this is the longest, number 2" in note for note in longest.notes)
    first = import_files([source], tmp_path / "p.mcap", ImportOptions(topics=("1",)))
    assert first.samples == 500
    with pytest.raises(InputError, match="has 2 sessions, and none is '3'"):
        import_files([source], tmp_path / "q.mcap", ImportOptions(topics=("3",)))


def test_logs_without_a_gyroscope_are_refused(tmp_path: Path, brief: HandheldSession) -> None:
    with pytest.raises(InputError, match=r"no gyroscope .* but only vehicle_attitude"):
        import_files([write_ulog(tmp_path, brief, ["vehicle_attitude"])], tmp_path / "o.mcap")
    (tmp_path / "a.bin").write_bytes(
        dataflash_head(["BAT"]) + dataflash_message("BAT", 1000, 16.0, 250)
    )
    with pytest.raises(InputError, match=r"no messages of a gyroscope .* but only BAT"):
        import_files([tmp_path / "a.bin"], tmp_path / "o.mcap")


@pytest.mark.long
@pytest.mark.parametrize("write", [write_dataflash, write_sensor_logger, write_ximu3])
def test_one_command_imports_and_one_solves(
    tmp_path: Path, session: HandheldSession, write: Writer
) -> None:
    def run(*arguments: str) -> str:
        process = subprocess.run(
            [sys.executable, "-m", "gyrorig_solver", *arguments],
            cwd=tmp_path, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert process.returncode in (0, 4), process.stderr  # 4: not every parameter
        return process.stdout

    source = write(tmp_path, session)
    run("import", source.name, "--output", "log.mcap")
    run("solve", "log.mcap", "--extend", "none", "--out", "calibrations")
    (document,) = (tmp_path / "calibrations").rglob("v0001.yaml")
    calibration = parse_calibration(document.read_bytes(), document.name)
    assert np.abs(np.array(calibration.matrices.STM) - GAIN).max() < 2e-3
