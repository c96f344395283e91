"""Run the commands of the page, and read their results.

What to use when: `find_measured_folder` for the folder of measurements; `run_all` imports, checks
and solves every set in an empty folder, and returns the output of each command. The numbers of the
page are from the calibrations in that folder.
"""

import contextlib
import io
import os
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import times_ns
from gyrorig_solver.calibration import CalibrationDocument, CalibrationStore, parse_calibration
from gyrorig_solver.cli import run
from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.samples import GyroSamples, load_samples
from gyrorig_solver.model import FACTOR_NAMES, factor_jacobian
from gyrorig_solver.model.gain_matrix import GainFactors
from gyrorig_solver.reference import AttitudeReference, TimeInterval, read_attitude, read_turns
from gyrorig_solver.reference.known_turns import KnownTurn

ROOT = Path(__file__).resolve().parents[2]
VARIABLE = "GYRORIG_DATA"
STORE = "calibrations"
EXPLAINED = "explained"  # the set of explain commands, and their folder

# In the order of the page. Trials of one unit of `broad` have one board: 02, 05 and 07.
COMMANDS: dict[str, tuple[str, ...]] = {
    "broad": (
        "gyrorig import broad $GYRORIG_DATA/broad/02_undisturbed_slow_rotation_B.npz"
        " --board BROAD-1 --out 02.mcap",
        "gyrorig import broad $GYRORIG_DATA/broad/05_undisturbed_slow_rotation_with_breaks_B.npz"
        " --board BROAD-1 --out 05.mcap",
        "gyrorig import broad $GYRORIG_DATA/broad/07_undisturbed_fast_rotation_B.npz"
        " --board BROAD-1 --out 07.mcap",
        "gyrorig import broad $GYRORIG_DATA/broad/24_disturbed_tapping_A.npz"
        " --board BROAD-2 --out 24.mcap",
        "gyrorig import broad $GYRORIG_DATA/broad/03_undisturbed_slow_rotation_C.npz"
        " --board BROAD-2 --out 03.mcap",
        "gyrorig import broad $GYRORIG_DATA/broad/33_disturbed_attached_magnet_2cm.npz"
        " --board BROAD-3 --out 33.mcap",
        "gyrorig check 02.mcap 05.mcap 07.mcap 24.mcap 03.mcap 33.mcap",
        "gyrorig solve 02.mcap",
        "gyrorig solve 05.mcap",
        "gyrorig solve 07.mcap",
        "gyrorig solve 24.mcap",
        "gyrorig solve 03.mcap",
        "gyrorig solve 33.mcap",
    ),
    "imu-tk-xsens": (
        "gyrorig import imu-tk-xsens $GYRORIG_DATA/imu_tk_xsens/xsens_raw.npz --out xsens.mcap",
        "gyrorig check xsens.mcap",
        "gyrorig solve xsens.mcap",
    ),
    "imucal-ferraris": (
        "gyrorig import imucal-ferraris $GYRORIG_DATA/imucal_ferraris/example_ferraris_session.csv"
        " --out ferraris.mcap",
        "gyrorig check ferraris.mcap",
        "gyrorig solve ferraris.mcap",
    ),
    "mpu6050-serial-log": (
        "gyrorig import mpu6050-serial-log-rest"
        " $GYRORIG_DATA/mpu6050_serial_log/unmoved-with-x-pointing-forward-10min.npz"
        " --out rest.mcap",
        "gyrorig import mpu6050-serial-log-turn"
        " $GYRORIG_DATA/mpu6050_serial_log/rotate-ccw-around-x-pointing-forward.npz"
        " --out forward.mcap",
        "gyrorig import mpu6050-serial-log-turn"
        " $GYRORIG_DATA/mpu6050_serial_log/rotate-ccw-around-x-pointing-up.npz --out up.mcap",
        "gyrorig check rest.mcap forward.mcap up.mcap",
        "gyrorig solve forward.mcap up.mcap",
        "gyrorig solve rest.mcap forward.mcap up.mcap",
    ),
    "mpu6050-raw-counts": (
        "gyrorig import mpu6050-raw-counts-rest"
        " $GYRORIG_DATA/mpu6050_raw_counts/example_data_tinit_calc.npz --out still.mcap",
        "gyrorig import mpu6050-raw-counts-poses"
        " $GYRORIG_DATA/mpu6050_raw_counts/example_data_calibration.npz --out poses.mcap",
        "gyrorig check still.mcap poses.mcap",
        "gyrorig solve still.mcap",
        "gyrorig solve poses.mcap",
    ),
    "car-imu-can": (
        "gyrorig import car-imu-can $GYRORIG_DATA/car_imu_can/can_frames.npz --out can.mcap",
        "gyrorig import car-imu-can $GYRORIG_DATA/car_imu_can/imu_pose.npz --out car.mcap",
        "gyrorig check car.mcap",
        "gyrorig solve car.mcap",
    ),
    EXPLAINED: (
        "gyrorig explain 02.mcap --held-out 05.mcap --out explained/02",
        "gyrorig explain 05.mcap --held-out 02.mcap --out explained/05",
        "gyrorig explain 07.mcap --held-out 02.mcap --out explained/07",
        "gyrorig explain 24.mcap --held-out 03.mcap --out explained/24",
        "gyrorig explain 03.mcap --held-out 24.mcap --out explained/03",
        "gyrorig explain 33.mcap --out explained/33",
        "gyrorig explain 02.mcap 05.mcap --held-out 07.mcap --out explained/02-05",
        "gyrorig explain car.mcap --out explained/car",
        "gyrorig explain rest.mcap --out explained/rest",
        "gyrorig explain still.mcap --out explained/still",
        "gyrorig explain forward.mcap up.mcap rest.mcap --out explained/forward-up-rest",
        "gyrorig explain xsens.mcap --out explained/xsens",
        "gyrorig explain ferraris.mcap --out explained/ferraris",
    ),
}


def find_measured_folder() -> Path:
    """Return the folder of measurements: $GYRORIG_DATA, or shared/data next to the checkout.

    Raises:
        SystemExit: the folder does not exist.
    """
    named = os.environ.get(VARIABLE)
    folder = Path(named) if named else ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        raise SystemExit(
            f"no measured data at {folder}: set {VARIABLE} to the folder with broad, imu_tk_xsens, "
            "imucal_ferraris, mpu6050_serial_log, mpu6050_raw_counts and car_imu_can"
        )
    return folder.resolve()


@dataclass(frozen=True, slots=True)
class CommandRun:
    """One command line with its exit code and output."""

    line: str
    exit_code: int
    output: str
    errors: str


@dataclass(frozen=True, slots=True, eq=False)
class LoadedRecording:
    """One imported recording as input of the estimators."""

    samples: GyroSamples
    turns: tuple[KnownTurn, ...]
    rests: tuple[TimeInterval, ...]
    attitude: AttitudeReference | None

    def make_rest_mask(self, time_s: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Return a mask of the times that are in one of the rests."""
        mask = np.zeros(time_s.size, np.bool_)
        for rest in self.rests:
            mask |= (time_s >= rest.begin_s) & (time_s <= rest.end_s)
        return mask


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredSets:
    """Every imported, checked and solved set, in one folder."""

    data: Path
    folder: Path
    runs: Mapping[str, tuple[CommandRun, ...]]  # by set

    def read_calibration(self, board: str, version: int = 1) -> CalibrationDocument:
        """Return a calibration that `gyrorig solve` wrote."""
        path = CalibrationStore(self.folder / STORE).versions(BoardId(board))[version - 1].path
        return parse_calibration(path.read_bytes(), path.name)

    def list_recordings(self) -> list[Path]:
        """Return the recordings that `gyrorig import` wrote."""
        return sorted(self.folder.glob("*.mcap"))

    def list_documents(self) -> list[Path]:
        """Return the calibrations and findings that `gyrorig solve` wrote to the store."""
        return sorted((self.folder / STORE).rglob("*.yaml"))

    def list_explanations(self) -> list[Path]:
        """Return the findings that `gyrorig explain` wrote."""
        return sorted((self.folder / EXPLAINED).rglob("*.yaml"))

    def load_recording(self, name: str) -> LoadedRecording:
        """Return one imported recording."""
        recording = read_recording(self.folder / f"{name}.mcap")
        samples = load_samples(recording, recording.board_ids[0])
        phases = read_turns(recording.events(), samples.origin_ns)
        raw = recording.reference_attitude()
        attitude = None
        if raw.size:
            time_s = (times_ns(raw["host_time"]) - samples.origin_ns) * 1e-9
            attitude = read_attitude(
                np.asarray(time_s, np.float64), raw["orientation"], raw["standard_deviation"]
            )
        return LoadedRecording(samples, phases.turns, phases.rests, attitude)


def run_all(
    data: Path, folder: Path, commands: Mapping[str, tuple[str, ...]] = COMMANDS
) -> MeasuredSets:
    """Run every command of the page, or the given commands.

    Args:
        data: folder of the measurements.
        folder: empty folder for the recordings and the store.
        commands: by set.
    """
    runs = {}
    with contextlib.chdir(folder):
        for name, lines in commands.items():
            runs[name] = tuple(_run_command(line, data) for line in lines)
    return MeasuredSets(data, folder, runs)


def _run_command(line: str, data: Path) -> CommandRun:
    words = [word.replace(f"${VARIABLE}", str(data)) for word in shlex.split(line)[1:]]
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = run(words)
    return CommandRun(line, code, out.getvalue(), err.getvalue())


def as_array(values: list[float | None] | float | None) -> FloatArray:
    """Return the values of a parameter; null in the document becomes nan."""
    listed = values if isinstance(values, list) else [values]
    return np.array([np.nan if v is None else v for v in listed], dtype=np.float64)


def read_value_and_std(
    calibration: CalibrationDocument, name: str
) -> tuple[FloatArray, FloatArray]:
    """Return a parameter of a calibration document, and its standard deviation."""
    parameter = calibration.parameters[name]
    return as_array(parameter.value), as_array(parameter.std)


def compute_gain_and_std(calibration: CalibrationDocument) -> tuple[FloatArray, FloatArray]:
    """Return G = S T M and the standard deviation of each entry, from the document's covariance.

    Every factor of the calibration must be observable.
    """
    factors = GainFactors(
        *(
            read_value_and_std(calibration, name)[0]
            for name in ("scale", "nonorthogonality", "misalignment")
        )
    )
    at = [calibration.covariance.order.index(name) for name in FACTOR_NAMES]
    covariance = np.array(calibration.covariance.matrix)[np.ix_(at, at)]
    back = np.linalg.inv(factor_jacobian(factors))
    std = np.sqrt(np.diag(back @ covariance @ back.T)).reshape(3, 3)
    return factors.gain, np.asarray(std, dtype=np.float64)
