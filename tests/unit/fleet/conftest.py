"""Two recordings of an emulated board, and rows as a worker makes them."""

import subprocess
import sys
from pathlib import Path

import pytest

from gyrorig_solver.fleet.rows import Row

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two sessions of 40 s, of two emulated boards that have one name and one uid each."""
    folder = tmp_path_factory.mktemp("recorded")
    for seed in (3, 3):
        command = [str(Path(sys.executable).with_name("gyrorigd")), "record", "--simulated-time"]
        command += ["--config", str(ROOT / "config" / "rig.yaml"), "--seed", str(seed)]
        command += ["--program", str(ROOT / "config" / "programs" / "survey-40.yaml")]
        out = folder / str(len(list(folder.iterdir())))
        subprocess.run([*command, "--out", str(out)], check=True, capture_output=True)
    return sorted(folder.glob("*/*.mcap"))


def row(key: str, board: str = "B", **more: object) -> Row:
    plain: dict[str, object] = {
        "key": key,
        "status": "ok",
        "created": "2026-01-31T02:30:00Z",
        "batch": "b",
        "inputs": ["00"],
        "names": ["r.mcap"],
        "board": board,
        "version": 1,
        "parameters": {"bias_x": 0.25, "bias_x_std": 0.5},
    }
    return Row(**{**plain, **more})  # type: ignore[arg-type] # as the test says
