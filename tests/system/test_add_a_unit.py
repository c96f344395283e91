"""The pages 'Add a pan-tilt unit' as they are written: their files record, solve, and are right."""

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
PAGES = {"turntable": "add-a-unit.md", "frame_head": "add-a-unit-with-frames.md"}
FILE = re.compile(r"<!-- test: save (\S+) -->\n```\w+\n(.*?)```", re.DOTALL)
QUICK = ROOT / "config/programs/quick.yaml"


def written_files(folder: Path, page: str) -> list[str]:
    """Write the files of a page, as a reader does."""
    files = FILE.findall((ROOT / "docs/how-to" / page).read_text(encoding="utf-8"))
    for name, text in files:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    return [name for name, _ in files]


def run(folder: Path, *words: str) -> str:
    completed = subprocess.run(
        [sys.executable, "-m", *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert completed.returncode == 0, completed.stdout + completed.stderr
    return completed.stdout


@pytest.mark.long
@pytest.mark.parametrize("driver", PAGES)
def test_the_unit_of_the_page_records_and_solves(tmp_path: Path, driver: str) -> None:
    names = written_files(tmp_path, PAGES[driver])
    assert names == [
        f"gyrorig_extensions/units/{driver}.py",
        f"gyrorig_extensions/emulated_units/emulated_{driver}.py",
        f"rig-{driver.replace('_', '-')}.yaml",
    ]
    record = ["gyrorig_daemon", "record", "--config", names[2], "--program", str(QUICK)]
    run(
        tmp_path,
        *record,
        "--simulated-time",
        "--seed",
        "5",
        "--truth",
        "truth.yaml",
        "--out",
        "recordings",
    )
    (recording,) = tmp_path.glob("recordings/*.mcap")
    run(tmp_path, "gyrorig_solver", "solve", str(recording), "--extend", "none", "--out", "results")
    solved = load(tmp_path / "results/GY80-1/v0001.yaml")
    truth = load(tmp_path / "truth.yaml")["boards"]["GY80-1"]
    assert solved["observability"]["unobservable"] == []
    off = np.array(solved["matrices"]["STM"]) - np.array(truth["STM"])
    assert np.abs(off).max() < 2e-3
    bias = solved["parameters"]["bias"]
    z = (np.array(bias["value"]) - truth["mean_bias_rad_s"]) / np.array(bias["std"])
    assert np.abs(z).max() < 5.0


def load(path: Path) -> Any:
    return yaml.safe_load(path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", ["turntabel", "no_such_unit"])
def test_an_unknown_driver_is_refused_in_one_line(tmp_path: Path, name: str) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text(
        f"rig: r\nptu: {{port: emulated, driver: {name}}}\nboards: [{{id: b, port: emulated}}]\n"
    )
    completed = subprocess.run(
        [sys.executable, "-m", "gyrorig_daemon", "record", "--config", str(rig), "--program",
         str(QUICK), "--simulated-time", "--out", str(tmp_path)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert completed.returncode == 2
    assert len(completed.stderr.strip().splitlines()) == 1
    assert name in completed.stderr
