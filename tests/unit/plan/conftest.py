"""Recordings of programs on the emulated rig, made as a person makes them."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

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
    folder = tmp_path_factory.mktemp("recorded")
    made: dict[tuple[Path, int, tuple[str, ...]], tuple[Path, dict[str, Any]]] = {}

    def run(program: Path, seed: int, *hide: str) -> tuple[Path, dict[str, Any]]:
        if (program, seed, hide) not in made:
            name = f"{program.stem}-{seed}-{len(made)}"
            truth = folder / f"{name}.yaml"
            process = subprocess.run(
                [
                    *(sys.executable, "-m", "gyrorig_daemon", "record", "--simulated-time"),
                    *("--config", str(RIG), "--program", str(program), "--seed", str(seed)),
                    *("--out", str(folder), "--truth", str(truth), "--json"),
                    *("--session", name),
                    *(part for cause in hide for part in ("--hide", cause)),
                ],
                capture_output=True,
                text=True,
                check=True,
            )
            path = Path(json.loads(process.stdout)["recording"])
            made[program, seed, hide] = path, yaml.safe_load(truth.read_text(encoding="utf-8"))
        return made[program, seed, hide]

    return run
