"""What the program says of recordings that cannot show everything; through the commands."""

import json
from pathlib import Path
from typing import Any

import pytest
from tests.support.commands_in_process import run_command

from gyrorig_daemon.cli import run as run_daemon
from gyrorig_solver.cli import run as run_solver

ROOT = Path(__file__).resolve().parents[2]
PAN_ONLY = """\
schema: gyrorig/program/1
name: pan-only
description: pan at tilt 0, and nothing else
settings: {base_speed_deg_s: 3.0, acceleration_deg_s2: 200.0, default_speed_deg_s: 60.0}
steps:
  - repeat:
      times: 4
      steps:
        - move: {pan_deg: 120.0, speed_deg_s: 60.0}
        - rest: {seconds: 0.6}
        - move: {pan_deg: -120.0, speed_deg_s: 90.0}
        - rest: {seconds: 0.6}
"""


def _record(out: Path, program: Path, *more: str) -> Path:
    words = ["record", "--simulated-time", "--seed", "2", "--out", str(out)]
    words += ["--config", str(ROOT / "config" / "rig.yaml"), "--program", str(program)]
    process = run_command(run_daemon, *words, *more)
    assert process.returncode == 0, process.stderr
    return next(out.glob("*.mcap"))


def _solve(recording: Path, out: Path, *more: str) -> tuple[int, dict[str, Any]]:
    words = ("solve", str(recording), "--out", str(out), "--json", *more)
    process = run_command(run_solver, *words)
    document: dict[str, Any] = json.loads(process.stdout)
    return process.returncode, document["boards"][0]["calibration"]


def test_pan_at_tilt_zero_only(tmp_path: Path) -> None:
    program = tmp_path / "pan.yaml"
    program.write_text(PAN_ONLY, encoding="utf-8")
    code, document = _solve(_record(tmp_path / "r", program), tmp_path / "c")
    assert code == 4
    assert document["observability"]["rank"] == 6
    assert document["parameters"]["scale"]["value"] == [None, None, None]
    assert document["matrices"]["STM"][0][:2] == [None, None]
    assert document["matrices"]["STM"][2][2] is not None  # what pan turns is known
    reasons = " ".join(document["trust"]["reasons"])
    assert "tilt did not move; move tilt at a few speeds" in reasons
    assert "sweep pan at a positive and at a negative tilt" in reasons


@pytest.mark.long
@pytest.mark.parametrize(("soak_k", "fitted"), [("4", False), ("25", True)])
def test_a_polynomial_of_temperature_needs_ten_kelvin(
    tmp_path: Path, soak_k: str, fitted: bool
) -> None:
    program = ROOT / "config" / "programs" / "full.yaml"
    hidden = ("--soak", soak_k, "--hide", "thermal_bias:0.001", "--truth", str(tmp_path / "t.json"))
    recording = _record(tmp_path / "r", program, *hidden)
    code, document = _solve(recording, tmp_path / "c", "--extend", "thermal_bias")
    warnings = [w for w in document["quality"]["warnings"] if "thermal_bias" in w]
    assert ("thermal_bias" in document["solver"]["terms"]) == fitted
    assert code == (0 if fitted else 4)
    if not fitted:
        assert "needs 10 K" in warnings[0]
        assert "warm the board" in warnings[0]
        return
    assert "selected with windows" in warnings[0]
    # The die follows the thermometer late; only a few lags are tried, so 15 % is near.
    truth = json.loads((tmp_path / "t.json").read_text(encoding="utf-8"))
    slope = truth["hidden"]["causes"][0]["parameters"]["slope"]["value"]
    assert document["parameters"]["thermal_bias"]["value"] == pytest.approx(slope, rel=0.15)
