"""The simulator's recordings keep the contract, and the solver finds the truth without causes."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from tests.bench.accuracy.board import NAMES
from tests.bench.rigs.prior_sizes import NOT_SIMULATED, PERSISTENT, PRIOR_SIZES, HiddenCauses
from tests.bench.rigs.recording_file import write_recording
from tests.bench.rigs.rig import SimulatedRig, draw_rig, read_program, simulate_rig
from tests.bench.rigs.trial import read_calibration, sigmas, solve_in_process

from gyrorig_solver.model.catalogue import catalogue

LARGEST_SD = 4.0  # once in 1200 times among 13 parameters
FEWEST_COVERED = 20  # of 26 at 95 %; fewer happen once in 300 times


def test_every_cause_of_the_catalogue_is_simulated_or_says_why_not() -> None:
    simulated = {prior.cause for prior in PRIOR_SIZES}
    assert simulated.isdisjoint(NOT_SIMULATED)
    assert simulated | set(NOT_SIMULATED) == set(catalogue())
    assert set(PERSISTENT) <= simulated


def test_recording_keeps_the_contract(
    plain: SimulatedRig, contract_judge: Path, tmp_path: Path
) -> None:
    path = tmp_path / "rig.mcap"
    write_recording(plain, path)
    judged = subprocess.run(
        [sys.executable, str(contract_judge), str(path)], capture_output=True, check=False
    )
    assert judged.returncode == 0, judged.stdout.decode()


def test_same_seed_is_the_same_rig() -> None:
    first, second = draw_rig(9), draw_rig(9)
    assert first.description() == second.description()
    assert np.array_equal(first.stream.gyro, second.stream.gyro)
    assert not np.array_equal(first.truth, draw_rig(4).truth)


@pytest.mark.long
def test_solver_finds_the_truth_of_rigs_without_causes(tmp_path: Path) -> None:
    inside = 0
    for seed in (1, 2):
        rng = np.random.default_rng([5, seed])
        rig = simulate_rig(seed, read_program("survey-40.yaml"), HiddenCauses(), rng)
        recording, out = tmp_path / f"{seed}.mcap", tmp_path / str(seed)
        write_recording(rig, recording)
        code, output = solve_in_process(())(recording, out)
        assert code == 0, output
        row = {"truth": rig.truth.tolist(), **read_calibration(next(out.glob("*/v0001.yaml")))}
        assert row["verdict"] == "good", row["reasons"]
        z = np.abs(sigmas(row, "std"))
        assert np.max(z) < LARGEST_SD, dict(zip(NAMES, z, strict=True))
        inside += int(np.sum(z < 1.96))
    assert inside >= FEWEST_COVERED


def test_base_model_is_wrong_where_the_axes_are_skewed(tmp_path: Path) -> None:
    rng = np.random.default_rng([5, 1])
    causes = HiddenCauses({"axis_nonorthogonality": {"size": 0.003}})
    rig = simulate_rig(1, read_program("survey-40.yaml"), causes, rng)
    write_recording(rig, tmp_path / "rig.mcap")
    solve_in_process(("--extend", "none"))(tmp_path / "rig.mcap", tmp_path / "out")
    calibration = read_calibration(next((tmp_path / "out").glob("*/v0001.yaml")))
    error = np.array(calibration["value"]) - rig.truth
    # The sensor matrix takes the skew for a turn about y.
    assert abs(error[10]) == pytest.approx(0.003, rel=0.5)
