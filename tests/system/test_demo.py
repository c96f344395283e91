"""The demo as a stranger runs it: real ptys, the real daemon as its own process, real time."""

import json
import subprocess
import sys
from pathlib import Path

from gyrorig_solver.calibration import parse_calibration


def test_demo_goes_the_whole_way(tmp_path: Path) -> None:
    out = tmp_path / "demo"
    process = subprocess.run(
        [sys.executable, "-m", "gyrorig_solver", "demo", "--out", str(out), "--json"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 0, process.stderr + process.stdout
    document = json.loads(process.stdout)
    (board,) = document["boards"]
    assert board["verdict"] == "good"
    assert len(board["parameters"]) == 13
    assert max(abs(p["sigmas"]) for p in board["parameters"]) <= 3.5
    assert Path(document["recording"]).is_file()
    assert parse_calibration(Path(board["file"]).read_bytes(), "v0001").version == 1
    assert Path(board["report"]).read_text().startswith("<!doctype html>")
    assert not list(out.glob("*.part"))


def test_what_the_demo_wrote_keeps_the_contracts(tmp_path: Path, contract_judge: Path) -> None:
    program = tmp_path / "short.yaml"
    program.write_text(
        "schema: gyrorig/program/1\nname: short\nsteps:\n  - rest: {seconds: 2.0, phase: static}\n"
        "  - move: {pan_deg: 30.0, speed_deg_s: 60.0}\n"
        "  - move: {pan_deg: 0.0, speed_deg_s: 40.0}\n"
    )
    out = tmp_path / "demo"
    process = subprocess.run(
        [
            *(sys.executable, "-m", "gyrorig_solver", "demo"),
            *("--out", str(out), "--program", str(program)),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode in (1, 4), process.stderr + process.stdout
    assert "not determined" in process.stdout
    written = [*out.glob("*.mcap"), *out.rglob("v*.yaml")]
    assert len(written) == 3  # recording, calibration and findings
    judged = subprocess.run(
        [sys.executable, str(contract_judge), *map(str, written)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert judged.returncode == 0, judged.stdout
