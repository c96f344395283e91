"""Recordings of programs on the emulated rig, made as a person makes them."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests.support.emulated_recordings import record_once
from tests.support.made_once import shared_folder

from gyrorig_protocol.program import MotionProgram, parse_program
from gyrorig_solver.calibration import find_profile
from gyrorig_solver.plan import RigModel, load_rig
from gyrorig_solver.plan.sensor_model import SensorModel

ROOT = Path(__file__).parents[3]
RIG = ROOT / "config" / "rig.yaml"
Record = Callable[..., tuple[Path, dict[str, Any]]]


@pytest.fixture(scope="session")
def rig() -> RigModel:
    return load_rig(RIG)


@pytest.fixture(scope="session")
def sensor(rig: RigModel) -> SensorModel:
    profile = find_profile(rig.sensor_name)
    assert profile is not None
    return rig.sensor(profile)


@pytest.fixture(scope="session")
def shipped() -> Callable[[str], MotionProgram]:
    def read(name: str) -> MotionProgram:
        return parse_program((ROOT / "config" / "programs" / f"{name}.yaml").read_bytes(), name)

    return read


@pytest.fixture(scope="session")
def record(tmp_path_factory: pytest.TempPathFactory) -> Record:
    """Record a program faster than time; return the recording and what the rig hides.

    Takes the program, a seed and what else to hide.
    """
    shared = shared_folder(tmp_path_factory)

    def run(program: Path, seed: int, *hide: str) -> tuple[Path, dict[str, Any]]:
        causes = [part for cause in hide for part in ("--hide", cause)]
        made = record_once(shared, program, "--seed", str(seed), *causes)
        return made.path, made.truth

    return run
