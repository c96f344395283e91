# ruff: noqa: T201
"""How well the twin of one trial of BROAD predicts the gyro of another trial of the same sensor.

    python tests/bench/bench_twin_attitudes.py [--data FOLDER]

The trials have reference attitudes and no motion unit. `gyrorig twin` makes a twin from each
trial. The bench then moves the emulated board of the twin along the reference attitudes of another
trial. It integrates the noise-free rates and the measured rates over windows of 1 s. The error is
the angle between the two rotations. The same is done with the
default simulation, with an ideal sensor, and with the twin of the tested trial itself. Intervals
of 95 % come from a bootstrap over blocks of 10 s.

The measurements are in $GYRORIG_DATA, or in shared/data next to the checkout.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import permutations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.support.rotation_error import window_rotations

from gyrorig_daemon.config import parse_rig
from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.physics.hand_stage import HandMotion
from gyrorig_daemon.emulator.physics.imu import ImuModel, ImuTruth
from gyrorig_daemon.emulator.physics.lowpass import butterworth_delay_s
from gyrorig_daemon.emulator.physics.stage_motion import Stage, StageMotion
from gyrorig_daemon.emulator.twin.twin_devices import link_delay_s
from gyrorig_daemon.session.emulation_options import EmulationOptions
from gyrorig_daemon.session.emulator_process import build_emulated_rig
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import times_ns
from gyrorig_solver.data.samples import GyroSamples, load_samples
from gyrorig_solver.reference import AttitudeReference
from gyrorig_solver.reference.attitude_reference import read_attitude
from gyrorig_solver.twin_check.twin_folder_check import default_rig_text

FloatArray = NDArray[np.float64]

ROOT = Path(__file__).resolve().parents[2]
TRIALS = {
    "02": "02_undisturbed_slow_rotation_B",
    "05": "05_undisturbed_slow_rotation_with_breaks_B",
    "07": "07_undisturbed_fast_rotation_B",
    "24": "24_disturbed_tapping_A",
    "03": "03_undisturbed_slow_rotation_C",
}
SAME_SENSOR = (("02", "05", "07"), ("24", "03"))
BOARD = "BROAD-1"
LEAD_S = 1.0  # from power-up of the emulated board to the first attitude
WINDOW_S, BLOCK_S = 1.0, 10.0
MOVING_RAD_S = 0.05
BOOTSTRAPS, SEED = 2000, 20261128
BIN = Path(sys.executable).parent
WAYS = ("default simulation", "ideal sensor", "twin", "twin of the tested trial")


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeStage(Stage):
    """A stage that follows reference attitudes. The two axes of a unit do not move."""

    angle_sum: CubicSpline | None = None  # integral of the body rate over time since power-up

    @property
    def revision(self) -> int:
        """Return 0: nothing changes the motion."""
        return 0

    def motion(self, start_s: float, period_s: float, count: int) -> HandMotion:
        """Return the motion in each of `count` intervals; see `Stage.motion`."""
        edges_s: FloatArray = start_s + period_s * np.arange(count + 1, dtype=np.float64)
        assert self.angle_sum is not None
        clipped_s = np.clip(edges_s, self.angle_sum.x[0], self.angle_sum.x[-1])
        rates = np.diff(self.angle_sum(clipped_s), axis=0) / period_s
        still = np.zeros(count)
        up = np.tile([0.0, 0.0, 1.0], (count, 1))
        return HandMotion(still, still, still, still, rates, up)

    def gravity_during(self, motion: StageMotion) -> FloatArray:
        """Return the specific force of a board that lies flat; no gyro of BROAD depends on it."""
        return self.gravity_stage_m_s2(0.0, 1.0, motion.pan_rad.size)

    def gravity_stage_m_s2(self, start_s: float, period_s: float, count: int) -> FloatArray:
        """Return the specific force of a board that lies flat, (count, 3)."""
        return np.tile([0.0, 0.0, self.gravity_m_s2], (count, 1))


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A trial: its measured rates, its reference attitudes, and the folder of its twin."""

    samples: GyroSamples
    angle_sum: CubicSpline  # integral of the body rate over time
    covered_s: tuple[tuple[float, float], ...]  # times with reference attitudes
    twin: Path


def read_trial(name: str, data: Path, folder: Path) -> Trial:
    """Import a trial, make its twin, and read its samples and attitudes."""
    path = folder / f"{name}.mcap"
    archive = data / "broad" / f"{TRIALS[name]}.npz"
    _run("import", "broad", archive, "--board", BOARD, "--out", path)
    twin = folder / f"twin-{name}" / "twin.yaml"
    _run("twin", path, "--out", twin.parent)
    recording = read_recording(path)
    samples = load_samples(recording, BOARD)
    raw = recording.reference_attitude()
    attitude = read_attitude(
        np.asarray((times_ns(raw["host_time"]) - samples.origin_ns) * 1e-9, np.float64),
        np.asarray(raw["orientation"], dtype=np.float64),
        np.asarray(raw["standard_deviation"], dtype=np.float64),
    )
    return Trial(samples, *_integrate_attitudes(attitude), twin)


def _run(*words: str | Path) -> None:
    subprocess.run([str(BIN / "gyrorig"), "-q", *map(str, words)], check=True, capture_output=True)


def _integrate_attitudes(
    attitude: AttitudeReference,
) -> tuple[CubicSpline, tuple[tuple[float, float], ...]]:
    """Return the integral of the body rate, which does not rise in gaps, and the covered times."""
    times: list[FloatArray] = []
    sums: list[FloatArray] = []
    covered = []
    last = np.zeros((1, 3))
    for segment in attitude.rate_segments():
        steps = segment.rate_rad_s * segment.duration_s[:, None]
        sums.append(np.concatenate([last, last + np.cumsum(steps, axis=0)]))
        times.append(np.append(segment.begin_s, segment.end_s[-1]))
        last = sums[-1][-1:]
        covered.append((float(segment.begin_s[0]), float(segment.end_s[-1])))
    time_s, angle_sum = np.concatenate(times), np.concatenate(sums)
    is_new = np.append(True, np.diff(time_s) > 0.0)  # segments can have an end in common
    return CubicSpline(time_s[is_new], angle_sum[is_new]), tuple(covered)


def predict_rates(rig_text: bytes, trial: Trial, is_ideal: bool = False) -> FloatArray:
    """Return the noise-free rates of an emulated board at the samples of a trial, (n, 3).

    Args:
        rig_text: the rig file.
        trial: whose attitudes move the board.
        is_ideal: replace gain, bias and delay of the board by those of an ideal sensor.
    """
    config = parse_rig(rig_text, "rig.yaml")
    rig = build_emulated_rig(config, EmulationOptions(noise_free=True), 0).rig
    board = rig.settings.boards[0]
    imu = rig.board_truth(board.name).imu
    if is_ideal:
        imu = replace(imu, gain=np.eye(3), bias_rad_s=np.zeros(3), tau_s=0.0)
    begin_s = float(trial.samples.time_s[0]) - LEAD_S
    shifted = CubicSpline(trial.angle_sum.x - begin_s, trial.angle_sum(trial.angle_sum.x))
    axes = rig.stage
    stage = AttitudeStage(pan=axes.pan, tilt=axes.tilt, angle_sum=shifted)
    # A recording states the times of the samples later by the error of the clock mapping.
    truth = rig.truth.boards[board.name]
    recorded_s = link_delay_s(board, truth, rig.truth.latency) - truth.stamp_early_s
    if is_ideal:
        recorded_s = -butterworth_delay_s(board.bandwidth_hz)
    until_s = float(trial.samples.time_s[-1]) - begin_s
    time_s, rate_rad_s = _simulate(imu, stage, rig, board.name, until_s)
    return np.asarray(
        CubicSpline(time_s + recorded_s, rate_rad_s)(trial.samples.time_s - begin_s),
        dtype=np.float64,
    )


def _simulate(
    imu: ImuTruth, stage: Stage, rig: EmulatedRig, board: str, until_s: float
) -> tuple[FloatArray, FloatArray]:
    hooks = rig.fresh_hooks().board(board)
    model = ImuModel(imu, stage, 0.0, np.random.default_rng(0), 40, hooks)
    times: list[FloatArray] = []
    rates: list[FloatArray] = []
    while not times or times[-1][-1] < until_s + LEAD_S / 2.0:
        block = model.next_block()
        times.append(block.time_s)
        rates.append(block.rate_rad_s)
    return np.concatenate(times), np.vstack(rates)


def window_starts_s(trial: Trial) -> FloatArray:
    """Return the begins of the windows with reference attitudes in which the sensor moves."""
    starts = np.concatenate(
        [np.arange(first, last - WINDOW_S, WINDOW_S) for first, last in trial.covered_s]
    )
    inside = (starts > trial.samples.time_s[0]) & (starts + WINDOW_S < trial.samples.time_s[-1])
    starts = starts[inside]
    turned = trial.angle_sum(starts + WINDOW_S) - trial.angle_sum(starts)
    path = np.abs(turned).max(axis=1) / WINDOW_S
    return np.asarray(starts[path > MOVING_RAD_S], dtype=np.float64)


def rms_with_interval(angle_rad: FloatArray, starts_s: FloatArray) -> str:
    """Return the rms in degrees with its 95 % interval, from a bootstrap over blocks."""
    _, block = np.unique(np.floor(starts_s / BLOCK_S), return_inverse=True)
    sums, counts = np.bincount(block, angle_rad**2), np.bincount(block)
    rows = np.random.default_rng(SEED).integers(0, sums.size, (BOOTSTRAPS, sums.size))
    low, high = np.percentile(
        np.sqrt(sums[rows].sum(axis=1) / counts[rows].sum(axis=1)), (2.5, 97.5)
    )
    rms = np.sqrt(np.mean(angle_rad**2))
    return f"{np.degrees(rms):.3f} ({np.degrees(low):.3f} to {np.degrees(high):.3f})"


def compare_pair(fitted: Trial, tested: Trial) -> Mapping[str, str]:
    """Return the error of each simulation on the tested trial."""
    text = fitted.twin.read_bytes()
    default = default_rig_text(text, fitted.twin).encode()
    predictions = (
        predict_rates(default, tested),
        predict_rates(default, tested, is_ideal=True),
        predict_rates(text, tested),
        predict_rates(tested.twin.read_bytes(), tested),
    )
    starts_s = window_starts_s(tested)
    time_s, windows = tested.samples.time_s, (starts_s, starts_s + WINDOW_S, WINDOW_S)
    measured = window_rotations(time_s, tested.samples.rate_rad_s, *windows)
    cells = {}
    for name, prediction in zip(WAYS, predictions, strict=True):
        predicted = window_rotations(time_s, prediction, *windows)
        angle = np.asarray((measured.inv() * predicted).magnitude(), dtype=np.float64)
        cells[name] = rms_with_interval(angle, starts_s)
    return {**cells, "windows": str(starts_s.size)}


def main() -> int:
    """Compare all ordered pairs of trials of one sensor."""
    parser = argparse.ArgumentParser(description=__doc__)
    default = os.environ.get("GYRORIG_DATA") or ROOT.parent / "shared" / "data"
    parser.add_argument("--data", type=Path, default=Path(default))
    data = parser.parse_args().data
    if not (data / "broad").is_dir():
        raise SystemExit(f"{data} has no folder broad. Set GYRORIG_DATA to the measurements.")
    with tempfile.TemporaryDirectory() as name:
        trials = {key: read_trial(key, data, Path(name)) for key in TRIALS}
        print(f"| fitted → tested | {' | '.join(f'{way}, °' for way in WAYS)} | windows |")
        print("|---|---|---|---|---|---|")
        for group in SAME_SENSOR:
            for fitted, tested in permutations(group, 2):
                cells = compare_pair(trials[fitted], trials[tested])
                print(f"| {fitted} → {tested} | {' | '.join(cells.values())} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
