"""Logs of phones: the loggers' shapes, stamps that are no time of day, a clock from the motion."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.support.emulated_recordings import record_once
from tests.support.made_once import shared_folder

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver import cli
from gyrorig_solver.calibration import parse_calibration
from gyrorig_solver.check import compare_with_truth
from gyrorig_solver.data.samples import load_samples
from gyrorig_solver.importers import ImportOptions, ImportSummary, import_files
from gyrorig_solver.importers.phone_clock import GRID_S, find_phone_clock
from gyrorig_solver.importers.phone_log import read_phone_log


def import_phone(
    log: Path, out: Path, board: str, sensor: str, unit_recording: Path | None = None
) -> ImportSummary:
    options = ImportOptions(board=board, sensor=sensor)
    return import_files([log], out, options, format_name="android", unit_recording=unit_recording)


RATE = np.array([[0.1, -0.2, 0.3], [0.11, -0.21, 0.31], [0.12, -0.22, 0.32], [0.13, 0.0, -1.0]])
STAMPS = 8_902_708_000_000 + np.array([0, 5_000_000, 10_100_000, 15_000_000])

SENSOR_LOGGER = "time,seconds_elapsed,z,y,x\n" + "".join(
    f"{1_665_000_000_000_000_000 + s},{s * 1e-9:.6f},{r[2]},{r[1]},{r[0]}\n"
    for s, r in zip(STAMPS.tolist(), RATE.tolist(), strict=True)
)
PHYPHOX = (
    '"Time (s)","Gyroscope x (rad/s)","Gyroscope y (rad/s)","Gyroscope z (rad/s)"\n'
    + "".join(
        f"{s * 1e-9:.6f},{r[0]},{r[1]},{r[2]}\n"
        for s, r in zip(STAMPS.tolist(), RATE.tolist(), strict=True)
    )
)
MARS = (
    "Timestamp[nanosec], gx[rad/s], gy[rad/s], gz[rad/s], ax[m/s^2], ay[m/s^2], az[m/s^2], "
    "Unix time[nanosec]\n"
) + "".join(
    f"{s}, {r[0]}, {r[1]}, {r[2]}, 0.1, 0.2, 9.8, {1_665_000_000_000_000_000 + s}\n"
    for s, r in zip(STAMPS.tolist(), RATE.tolist(), strict=True)
)
GET_SENSOR_DATA = "% Logfile\n" + "".join(
    f"GYRO;{s * 1e-9 - 8000:.3f};{s * 1e-9:.6f};{r[0]};{r[1]};{r[2]};3\n"
    f"ACCE;{s * 1e-9 - 8000:.3f};{s * 1e-9 + 0.001:.6f};0.1;0.2;9.8;3\n"
    for s, r in zip(STAMPS.tolist(), RATE.tolist(), strict=True)
)
GNSS_LOGGER = "# Raw,utcTimeMillis\nFix,GPS,1.0,2.0,3.0,4.0\n" + "".join(
    f"UncalGyro,{1_665_000_000_000 + s // 1_000_000},{s},{r[0]},{r[1]},{r[2]},0.01,0.0,0.0\n"
    for s, r in zip(STAMPS.tolist(), RATE.tolist(), strict=True)
)
SENSEI = "".join(
    f"Gyroscope Sensor;1466433997168;{s};[{r[0]}, {r[1]}, {r[2]}]\n"
    for s, r in zip(STAMPS.tolist(), RATE.tolist(), strict=True)
)


@pytest.mark.parametrize(
    ("name", "text", "corrected"),
    [
        ("GyroscopeUncalibrated.csv", SENSOR_LOGGER, False),
        ("Gyroscope.csv", SENSOR_LOGGER, True),
        ("raw.csv", PHYPHOX, True),
        ("gyro_accel.csv", MARS, True),
        ("logfile.txt", GET_SENSOR_DATA, True),
        ("gnss_log.txt", GNSS_LOGGER, False),
        ("sensei.csv", SENSEI, True),
    ],
)
def test_the_common_loggers_are_recognised(
    tmp_path: Path, name: str, text: str, corrected: bool
) -> None:
    path = tmp_path / name
    path.write_text(text)
    log = read_phone_log(path)
    np.testing.assert_allclose(log.rate_rad_s, RATE, atol=1e-12)
    np.testing.assert_allclose(np.diff(log.stamp_ns), np.diff(STAMPS), atol=1500)
    assert abs(int(log.stamp_ns[0]) - STAMPS[0]) < 2_000  # never the Unix time beside it
    assert any("UNCALIBRATED" in note for note in log.notes) is corrected
    assert (log.accel_m_s2 is not None) is (name in ("gyro_accel.csv", "logfile.txt"))


def test_uncalibrated_rates_are_preferred(tmp_path: Path) -> None:
    path = tmp_path / "both.txt"
    path.write_text(GET_SENSOR_DATA + GNSS_LOGGER.replace("0.3,", "0.4,"))
    assert read_phone_log(path).rate_rad_s[0, 2] == 0.4


def test_decreasing_and_duplicate_timestamps(tmp_path: Path) -> None:
    lines = SENSEI.splitlines(keepends=True)
    path = tmp_path / "batched.csv"
    path.write_text("".join([lines[1], lines[0], lines[0], *lines[2:]]))
    log = read_phone_log(path)
    np.testing.assert_allclose(log.rate_rad_s, RATE)
    assert any("decreased" in note for note in log.notes)
    assert any("1 samples with a duplicate timestamp" in note for note in log.notes)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("1,2,3\n4,5,6\n", "neither a header nor sensor tags"),
        ("time,pressure\n1,2\n", "no columns for the time"),
        ("ACCE;1;2;3;4;5\n" * 3, "contains no gyroscope data"),
        (
            "timestamp,gx,gy,gz\n0,1,2,3\n300,1,2,3\n600,1,2,3\n",
            "this is not a sample rate of 4 to 2000 Hz",
        ),
        ("", "neither a header"),
    ],
)
def test_files_that_are_not_logs_are_rejected(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=says):
        read_phone_log(path)


def speeds(at_s: np.ndarray) -> np.ndarray:
    """A motion that never repeats: bumps at places of their own."""
    rng = np.random.default_rng(3)
    middle = np.cumsum(rng.uniform(2.0, 4.0, 40))
    height = rng.uniform(0.3, 1.5, 40)
    return np.asarray(
        (height * np.exp(-0.5 * ((at_s[:, None] - middle) / 0.4) ** 2)).sum(axis=1),
        dtype=np.float64,
    )


def test_a_clock_from_the_motion() -> None:
    unit = speeds(np.arange(0.0, 120.0, GRID_S))
    rng = np.random.default_rng(5)
    since_s = np.sort(np.arange(0.0, 90.0, 0.005) + rng.uniform(-5e-4, 5e-4, 18000))
    since_s -= since_s[0]
    capture_s = 17.1234 + (1.0 - 60e-6) * since_s
    result = find_phone_clock(since_s, speeds(capture_s) + rng.normal(0.0, 0.005, 18000), unit)
    assert abs(result.offset_s - 17.1234) < 2e-3
    assert abs(result.skew + 60e-6) < 2e-5
    assert abs(result.capture_s(since_s) - capture_s).max() < 2e-3


def test_a_short_log_can_begin_late() -> None:
    """Before, a log in the last third of the unit's recording raised a ValueError."""
    unit = speeds(np.arange(0.0, 120.0, GRID_S))
    since_s = np.arange(0.0, 38.5, 0.005)
    assert abs(find_phone_clock(since_s, speeds(82.2 + since_s), unit).offset_s - 82.2) < 2e-3


@pytest.mark.parametrize(
    ("speed", "text"), [(1.02, r"\+2\.0 %"), (0.98, r"-2\.0 %"), (1.005, "ppm")]
)
def test_a_clock_of_a_wrong_speed_is_named(speed: float, text: str) -> None:
    """Before, with 2 %: "the phone did not move together with the pan-tilt unit"."""
    unit = speeds(np.arange(0.0, 120.0, GRID_S))
    since_s = np.arange(0.0, 90.0, 0.005)
    with pytest.raises(InputError, match=f"clock and of the rig's clock differ by .*{text}"):
        find_phone_clock(since_s, speeds(17.0 + speed * since_s), unit)


def test_different_and_periodic_motions_are_rejected() -> None:
    unit = speeds(np.arange(0.0, 120.0, GRID_S))
    since_s = np.arange(0.0, 90.0, 0.01)
    with pytest.raises(InputError, match="did not move together with the pan-tilt unit"):
        find_phone_clock(since_s, speeds(110.0 - 1.3 * since_s), unit)
    again = np.abs(np.sin(np.arange(0.0, 120.0, GRID_S)))
    with pytest.raises(InputError, match="the motion repeats itself"):
        find_phone_clock(since_s, np.abs(np.sin(since_s)), again)


@pytest.fixture(scope="module")
def on_a_unit(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, dict[str, Any]]:
    """A recording of a unit, the log of a phone on it, and what the emulator hid."""
    folder = tmp_path_factory.mktemp("unit")
    made = record_once(shared_folder(tmp_path_factory), "quick", "--seed", "4")
    samples = load_samples(read_recording(made.path), "GY80-1")
    stamp_ns = np.rint((samples.time_s * (1.0 + 4e-5) + 54321.7) * 1e9).astype(np.int64)
    log = folder / "gnss_log.txt"
    with log.open("w") as lines:
        for stamp, rate in zip(stamp_ns.tolist(), samples.rate_rad_s.tolist(), strict=True):
            lines.write(f"UncalGyro,1,{stamp},{rate[0]:.9f},{rate[1]:.9f},{rate[2]:.9f},0,0,0\n")
    return made.path, log, made.truth


@pytest.mark.long
def test_a_phone_on_a_unit_becomes_an_additional_board(
    on_a_unit: tuple[Path, Path, dict[str, Any]], tmp_path: Path
) -> None:
    unit, log, _ = on_a_unit
    imported = import_phone(log, tmp_path / "phone.mcap", "NEXUS5", "MPU-6515", unit)
    both = read_recording(imported.path)
    assert both.is_complete
    assert both.board_ids == (BoardId("GY80-1"), BoardId("NEXUS5"))
    board, phone = (load_samples(both, name) for name in ("GY80-1", "NEXUS5"))
    # the same samples by another clock: as far apart in time as the motion can tell
    apart_s = np.interp(board.number, phone.number, phone.time_s) - board.time_s
    assert np.abs(apart_s - np.median(apart_s)).max() < 2e-3
    for topic, messages in read_recording(unit).topics.items():
        assert len(both.topics[topic]) >= len(messages)
    assert any("clock was estimated from the motion" in note for note in imported.notes)
    with pytest.raises(UsageError, match="the phone would get the name GY80-1"):
        import_phone(log, tmp_path / "again.mcap", "GY80-1", "MPU-6515", unit)
    assert not list(tmp_path.glob("again*"))


FARTHEST_SIGMA, ALL_SIGMA = 4.0, 2.0


@pytest.mark.long
def test_the_calibration_of_a_phone_agrees_within_its_uncertainty(
    on_a_unit: tuple[Path, Path, dict[str, Any]], tmp_path: Path
) -> None:
    """The log is GY80-1's samples by a clock of its own: what the emulator hid in that board holds.

    Its lag is in the clock's offset, so its time offset is no board's; nor is `odr_hz` known, for
    a log does not say it.
    """
    unit, log, truth = on_a_unit
    phone = import_phone(log, tmp_path / "phone.mcap", "NEXUS5", "MPU-6515", unit).path
    out = tmp_path / "calibrations"
    assert cli.run(["solve", str(phone), "--board", "NEXUS5", "--out", str(out)]) == 0
    document = out / "NEXUS5" / "v0001.yaml"
    result = parse_calibration(document.read_bytes(), document.name)
    assert result.trust.verdict != "refused"
    assert result.observability.rank == 12
    hidden = truth | {"boards": {"NEXUS5": truth["boards"]["GY80-1"]}}
    off = {
        row.name: row.sigmas
        for row in compare_with_truth(result, hidden)
        if not row.name.startswith("time")
    }
    assert len(off) == 12
    sigmas = np.array([abs(offset) for offset in off.values() if offset is not None])
    assert sigmas.size == 12
    assert sigmas.max() < FARTHEST_SIGMA, off
    assert np.sqrt(np.mean(sigmas**2)) < ALL_SIGMA, off


def test_the_time_of_a_phone_alone_starts_at_zero(
    on_a_unit: tuple[Path, Path, dict[str, Any]], tmp_path: Path
) -> None:
    _, log, _ = on_a_unit
    imported = import_phone(log, tmp_path / "alone.mcap", "PHONE", "android")
    alone = read_recording(imported.path)
    assert alone.start_ns == 0
    assert alone.metadata["gyrorig.board.PHONE"]["link"] == "file"
    assert load_samples(alone, "PHONE").number.size == imported.samples


def test_an_accelerometer_may_start_before_the_gyroscope(tmp_path: Path) -> None:
    source = tmp_path / "log.txt"
    rows = "".join(
        f"ACCE;1;{k / 100 - 0.004:.6f};0.1;0.2;9.8;3\nGYRO;1;{k / 100:.6f};1;2;3;3\n"
        for k in range(1000, 1050)
    )
    source.write_text(rows)
    imported = import_phone(source, tmp_path / "log.mcap", "PHONE", "android")
    recording = read_recording(imported.path)
    assert recording.start_ns == 4_000_000  # of the first rate, after the first acceleration
    gyro_s = load_samples(recording, "PHONE").time_s
    assert np.diff(gyro_s) == pytest.approx(0.01, abs=1e-6)


@pytest.mark.parametrize(("unit", "expected"), [("g", 9.80665), ("G", 9.80665), ("m/s^2", 1.0)])
def test_accelerations_in_g_are_converted(tmp_path: Path, unit: str, expected: float) -> None:
    source = tmp_path / "log.csv"
    axes = [f"gyro_{axis} (rad/s)" for axis in "xyz"] + [f"acc_{axis} ({unit})" for axis in "xyz"]
    rows = "".join(f"{k / 100},1,2,3,0,0,1\n" for k in range(50))
    source.write_text(f"time (s),{','.join(axes)}\n{rows}")
    accel = read_phone_log(source).accel_m_s2
    assert accel is not None
    assert accel[0].tolist() == pytest.approx([0.0, 0.0, expected])


def test_of_two_gyroscopes_in_one_table_the_uncalibrated_one_is_read(tmp_path: Path) -> None:
    source = tmp_path / "log.csv"
    rows = "".join(f"{k / 100},9,9,9,1,2,3\n" for k in range(50))
    head = "seconds_elapsed,gyro_x,gyro_y,gyro_z,gyroUncalibrated_x,gyroUncalibrated_y,"
    source.write_text(head + "gyroUncalibrated_z\n" + rows)
    assert read_phone_log(source).rate_rad_s[0].tolist() == [1.0, 2.0, 3.0]


def test_two_gyroscopes_in_one_table_are_refused(tmp_path: Path) -> None:
    """A phone and a watch: the first would be read without a word."""
    source = tmp_path / "log.csv"
    rows = "".join(f"{k / 100},9,9,9,1,2,3\n" for k in range(50))
    head = "seconds_elapsed,gyro_x,gyro_y,gyro_z,watch_gyro_x,watch_gyro_y,watch_gyro_z\n"
    source.write_text(head + rows)
    with pytest.raises(InputError, match="columns gyro_x and watch_gyro_x"):
        read_phone_log(source)


def tagged(separator: str, brackets: bool = False) -> str:
    """Return lines with decimal commas."""
    lines = []
    for k in range(200):
        rates = f"[0,1{separator} -0,2{separator} 0,3]" if brackets else "0,1;-0,2;0,3;3"
        text = f"GYRO;{k * 0.01:.3f};{k * 0.01:.6f};".replace(".", ",") + rates
        lines.append(text if brackets else text.replace(";", separator))
    return "\n".join(lines)


@pytest.mark.parametrize("text", [tagged(";"), tagged(",", brackets=True)])
def test_decimal_commas_of_tagged_lines(tmp_path: Path, text: str) -> None:
    """Before, the rates were 0, 10000 and 0 rad/s."""
    (tmp_path / "log.txt").write_text(text)
    log = read_phone_log(tmp_path / "log.txt")
    np.testing.assert_allclose(log.rate_rad_s, np.tile([0.1, -0.2, 0.3], (200, 1)))
    assert np.array_equal(np.diff(log.stamp_ns), np.full(199, 10_000_000))


def test_decimal_commas_between_commas_are_refused(tmp_path: Path) -> None:
    (tmp_path / "log.txt").write_text(tagged(","))
    with pytest.raises(InputError, match="have decimal commas, and commas are also between"):
        read_phone_log(tmp_path / "log.txt")
