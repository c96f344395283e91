"""Measured data, imported and fitted, beside what the authors' own packages get from it.

Figures: imucal from the installed package on the same session; imu_tk as its program
printed them for this file (threshold multiplier 6, 37 moves, bias held at the first rest);
`broad` and the 720 degree turns against their own references.
"""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.support.rotation_error import window_rotation_error

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import times_ns
from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.samples import GyroSamples, load_samples
from gyrorig_solver.estimate import fit_attitude, fit_gravity, fit_turns
from gyrorig_solver.importers import import_measurements, load_import_map
from gyrorig_solver.reference import AttitudeReference, TurnReference, read_attitude, read_turns

MAPS = Path(__file__).resolve().parents[3] / "config" / "imports"
LoadedRecording = tuple[GyroSamples, TurnReference, AttitudeReference | None]
Loader = Callable[[str, str], LoadedRecording]


@pytest.fixture
def load(measured_data: Path, tmp_path: Path) -> Loader:
    """Import a file by a shipped map and return what the estimators take."""

    def loaded(name: str, source: str) -> LoadedRecording:
        out = tmp_path / f"{Path(source).stem}.mcap"
        import_measurements(measured_data / source, load_import_map(MAPS / f"{name}.yaml"), out)
        recording = read_recording(out)
        samples = load_samples(recording, recording.board_ids[0])
        turns = read_turns(recording.events(), samples.origin_ns)
        if "/reference/attitude" not in recording.topics:
            return samples, turns, None
        raw = recording.reference_attitude()
        time_s = np.asarray((times_ns(raw["host_time"]) - samples.origin_ns) * 1e-9, np.float64)
        return (
            samples,
            turns,
            read_attitude(time_s, raw["orientation"], raw["standard_deviation"]),
        )

    return loaded


def test_ferraris_session_beside_imucal(load: Loader, measured_data: Path) -> None:
    pandas = pytest.importorskip("pandas")
    imucal = pytest.importorskip("imucal")
    folder = measured_data / "imucal_ferraris"
    table = pandas.read_csv(folder / "example_ferraris_session.csv").set_index("n_samples")
    listed = json.loads((folder / "example_ferraris_session_list.json").read_text())
    regions = imucal.ferraris_regions_from_section_list(table, pandas.DataFrame(listed).T)
    theirs = imucal.FerrarisCalibration().compute(
        regions, sampling_rate_hz=102.4, from_acc_unit="m/s^2", from_gyr_unit="deg/s"
    )
    samples, turns, _ = load("imucal-ferraris", "imucal_ferraris/example_ferraris_session.csv")
    fit = fit_turns([(samples, turns)])
    gain = theirs.K_g @ theirs.R_g  # measured = K R true + K_ga acc + b
    # imucal also fits a g-sensitivity, which moves the bias under the turns by up to
    # 0.004 deg/s: 1e-4 of a turn. The hand's own degree and a half is 4e-3.
    np.testing.assert_allclose(fit.gain, gain, atol=1.5e-4)
    np.testing.assert_allclose(np.degrees(fit.bias_rad_s), theirs.b_g, atol=1e-3)
    assert fit.observability.rank == 12
    assert np.abs((fit.gain - gain) / fit.gain_std).max() < 0.05
    assert "the recordings cannot check these uncertainties" in fit.warnings[0]


def test_serial_log_gives_the_first_column_of_the_gain_and_no_factor(load: Loader) -> None:
    folder = "mpu6050_serial_log"
    rest = load("mpu6050-serial-log-rest", f"{folder}/unmoved-with-x-pointing-forward-10min.npz")
    turns = [
        load("mpu6050-serial-log-turn", f"{folder}/rotate-ccw-around-x-pointing-{way}.npz")
        for way in ("forward", "up")
    ]
    fit = fit_turns([(s, t) for s, t, _ in (rest, *turns)])
    # Plain sums over every count of each file, at the rate of its own arrivals, give 711.8 and
    # 710.3 degrees of 720. Without the first burst's 19 samples it would be 716.1 and 710.3.
    assert fit.gain[0, 0] == pytest.approx((711.8 + 710.3) / 1440.0, abs=0.001)
    assert 0.003 < fit.gain_std[0, 0] < 0.008
    # scale.x is the norm of a row whose other entries may add 0.1^2, more than the noise.
    assert np.isnan(fit.scale).all()
    assert np.isnan(fit.gain[:, 1:]).all()
    assert fit.recordings[0].bias_rad_s[0] == pytest.approx(np.radians(4.535), abs=1e-4)
    # The last recording has no rest, and the bias can have changed by 0.1 deg/s before it.
    assert fit.bias_rad_s[0] == pytest.approx(np.radians(4.535), abs=np.radians(0.02))
    assert 0.05 < np.degrees(fit.std["bias.x"]) < 0.11
    with pytest.raises(InputError, match="never rests"):
        fit_turns([turns[0][:2]])


def imu_tk_gain(scale_rad_s: float) -> FloatArray:
    """G of imu_tk's result: x' = T K (x - b), as its program printed it for this file."""
    T = np.array(
        [
            [1.0, 0.00593634, 0.00111101],
            [0.00808812, 1.0, -0.0535569],
            [0.0253067, -0.0025513, 1.0],
        ]
    )
    K = np.diag([2.09295e-4, 2.09899e-4, 2.09483e-4])
    return np.asarray(np.linalg.inv(T @ K) * scale_rad_s, dtype=np.float64)


def test_multi_position_session_beside_imu_tk(load: Loader) -> None:
    samples, turns, _ = load("imu-tk-xsens", "imu_tk_xsens/xsens_raw.npz")
    fit = fit_gravity(samples, 9.81744, turns.rests[0])
    assert fit.gravity_moves is not None
    assert fit.gravity_moves.moves == 37
    theirs = imu_tk_gain(samples.quantum_rad_s)
    off = (fit.gain - theirs) / fit.gain_std
    # They hold the bias at the first rest; with the bias freed their own values move by
    # up to 0.45 of these deviations, ours take the bias of each move's two rests.
    assert np.abs(off).max() < 2.5
    assert np.sqrt(np.mean(off**2)) < 1.2
    assert np.degrees(fit.gravity_moves.sigma_rad) < 0.36
    assert fit.observability.rank == 12
    assert fit.observability.unobservable == ("time_offset",)
    assert "accelerometer's frame" in fit.reference


def test_few_poses_determine_little_and_give_reasons(load: Loader) -> None:
    source = "mpu6050_raw_counts/example_data_calibration.npz"
    samples, turns, _ = load("mpu6050-raw-counts-poses", source)
    fit = fit_gravity(samples, 9.80665, turns.rests[0])
    assert fit.observability.rank < 12
    assert {"scale.x", "scale.y"} <= set(fit.observability.unobservable)
    assert any("turn the board about all axes" in reason for reason in fit.observability.reasons)


@pytest.mark.long
@pytest.mark.parametrize(
    ("train", "test", "raw_deg", "after_deg"),
    [
        ("02_undisturbed_slow_rotation_B", "07_undisturbed_fast_rotation_B", 2.66, 0.33),
        ("24_disturbed_tapping_A", "03_undisturbed_slow_rotation_C", 0.81, 0.22),
    ],
)
def test_motion_capture_on_data_not_used_for_the_fit(
    load: Loader, train: str, test: str, raw_deg: float, after_deg: float
) -> None:
    """Raw: nominal gain, the held-out file's own static bias taken off, no time offset."""
    samples, _, reference = load("broad", f"broad/{train}.npz")
    assert reference is not None
    fit = fit_attitude([(samples, reference)])
    assert fit.observability.rank == 12
    assert fit.time_offset_s == pytest.approx(4.15e-3, abs=0.05e-3)
    other, phases, truth = load("broad", f"broad/{test}.npz")
    assert truth is not None
    still = np.zeros(other.time_s.size, np.bool_)
    resting = np.zeros(truth.time_s.size, np.bool_)
    for rest in phases.rests:
        still |= (other.time_s >= rest.begin_s) & (other.time_s <= rest.end_s)
        resting |= (truth.time_s >= rest.begin_s) & (truth.time_s <= rest.end_s)
    bias = np.median(other.rate_rad_s[still], axis=0)
    raw = window_rotation_error(other.time_s, other.rate_rad_s - bias, truth, 1.0, ~resting)
    calibrated = (other.rate_rad_s - fit.bias_rad_s) @ np.linalg.inv(fit.gain).T
    after = window_rotation_error(
        other.time_s - fit.time_offset_s, calibrated, truth, 1.0, ~resting
    )
    assert np.degrees(raw.rms_rad) == pytest.approx(raw_deg, rel=0.05)
    assert np.degrees(after.rms_rad) == pytest.approx(after_deg, rel=0.1)
    assert after.interval_rad[1] < raw.interval_rad[0]


def test_a_pose_that_depends_on_the_gyro_is_limited(load: Loader) -> None:
    """The car's pose was made with this gyro's help: gains differ between frequencies."""
    samples, _, reference = load("car-imu-can", "car_imu_can/imu_pose.npz")
    assert reference is not None
    fit = fit_attitude([(samples, reference)])
    assert any("depends on the gyro" in reason for reason in fit.limited_reasons)
    assert fit.bias_rad_s[2] == pytest.approx(0.068, abs=0.002)
