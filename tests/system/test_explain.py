"""`gyrorig explain`, `solve --extend auto` and `demo --hide` as a stranger runs them.

The emulator hides, the desk finds: two programs that share no code of physics. The first test runs
the installed programs; the others call the same commands in this process.
"""

import hashlib
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from tests.support.commands_in_process import run_command

from gyrorig_daemon.cli import run as run_daemon
from gyrorig_protocol.documents import parse_yaml
from gyrorig_solver.calibration import parse_calibration
from gyrorig_solver.check import score_causes
from gyrorig_solver.cli import run as run_solver
from gyrorig_solver.findings.findings_document import parse_findings

ROOT = Path(__file__).parents[2]
# Sweeps at three tilts with reversals, two speeds, a move of tilt, rests: half a minute.
PROGRAM = """schema: gyrorig/program/1
name: short-sweeps
steps:
  - rest: {seconds: 4.0, phase: static}
"""
PROGRAM += "".join(
    f"  - move: {{tilt_deg: {tilt}, speed_deg_s: 40.0}}\n  - rest: {{seconds: 0.5}}\n"
    + "".join(
        f"  - move: {{pan_deg: {pan}, speed_deg_s: {speed}}}\n  - rest: {{seconds: 0.5}}\n"
        for pan, speed in ((60.0, 80.0), (90.0, 50.0), (-60.0, 80.0), (0.0, 40.0))
    )
    for tilt in (-30.0, 0.0, 25.0, 10.0, -15.0)
)


def gyrorig(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "gyrorig_solver", *arguments],
        capture_output=True,
        text=True,
        check=False,
    )


def recorded(folder: Path, *more: str, in_process: bool = True) -> tuple[Path, dict[str, Any]]:
    folder.mkdir(parents=True, exist_ok=True)
    program, truth = folder / "program.yaml", folder / "truth.yaml"
    program.write_text(PROGRAM)
    words = [
        *("record", "--simulated-time", "--json"),
        *("--config", str(ROOT / "config" / "rig.yaml"), "--program", str(program)),
        *("--out", str(folder), "--truth", str(truth), *more),
    ]
    if in_process:
        process = run_command(run_daemon, *words)
        assert process.returncode == 0, process.stderr
    else:
        command = [sys.executable, "-m", "gyrorig_daemon", *words]
        process = subprocess.run(command, capture_output=True, text=True, check=True)
    return Path(json.loads(process.stdout)["recording"]), parse_yaml(truth.read_bytes(), "truth")


@pytest.fixture(scope="module")
def without_causes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of a rig without hidden causes."""
    return recorded(tmp_path_factory.mktemp("without_causes"), "--seed", "8")[0]


def judged(judge: Path, *files: Path) -> str:
    process = subprocess.run(
        [sys.executable, str(judge), *map(str, files)], capture_output=True, text=True, check=False
    )
    return process.stdout if process.returncode else ""


@pytest.mark.long
def test_a_hidden_play_is_named_taken_in_and_kept_by_the_contract(
    tmp_path: Path, contract_judge: Path
) -> None:
    hidden = ("--seed", "21", "--hide", "backlash@pan:0.0015")
    path, truth = recorded(tmp_path, *hidden, in_process=False)
    process = gyrorig("explain", str(path), "--out", str(tmp_path / "findings"), "--json")
    assert process.returncode == 0, process.stderr
    (board,) = json.loads(process.stdout)["boards"]
    file = Path(board["file"])
    document = parse_findings(file.read_bytes(), file.name)
    assert [
        (score_cause.cause, score_cause.score) for score_cause in score_causes(document, truth)
    ] == [("backlash", "right")]
    (cause,) = document.causes
    gap, half = cause.parameters["gap.pan"], 4.0
    assert gap.value is not None
    assert gap.std is not None
    assert abs(gap.value - 0.0015) < half * gap.std
    assert document.gain is not None
    assert (document.gain.held_out_log_likelihood or 0.0) > 10.0
    assert (file.parent / str(cause.evidence.figure)).read_text().startswith("<?xml")
    assert "The gears have backlash, on pan" in Path(board["report"]).read_text()

    store = tmp_path / "calibrations"
    process = gyrorig("solve", str(path), "--extend", "auto", "--out", str(store), "--json")
    assert process.returncode == 0, process.stderr
    (solved,) = json.loads(process.stdout)["boards"]
    calibration = parse_calibration(Path(solved["file"]).read_bytes(), "v0001.yaml")
    assert calibration.findings is not None
    assert calibration.findings.causes == ["backlash"]
    assert "backlash" in calibration.solver.terms
    findings_path = Path(solved["file"]).with_name(calibration.findings.file)
    assert judged(contract_judge, file, findings_path, Path(solved["file"])) == ""


@pytest.mark.long
@pytest.mark.parametrize(
    ("hide", "cause"),
    [
        ("corrupt_samples:0.01", "corrupt_samples"),
        ("repeated_samples:0.02", "repeated_samples"),
        ("lost_samples:0.01", "lost_samples"),
        ("axis_swap@yz", "axis_swap"),
        ("sign_flip@x", "sign_flip"),
        ("wrong_full_scale:2", "wrong_full_scale"),
    ],
)
def test_faults_of_the_link_are_named_from_the_stream(
    hide: str, cause: str, tmp_path: Path
) -> None:
    path, truth = recorded(tmp_path, "--seed", "3", "--hide", hide)
    words = ("explain", str(path), "--out", str(tmp_path / "findings"), "--json")
    process = run_command(run_solver, *words)
    assert process.returncode == 0, process.stderr
    (board,) = json.loads(process.stdout)["boards"]
    document = parse_findings(Path(board["file"]).read_bytes(), "findings.yaml")
    assert [
        (score_cause.cause, score_cause.score) for score_cause in score_causes(document, truth)
    ] == [(cause, "right")]


def test_a_rig_as_it_should_be_has_no_findings(without_causes: Path, tmp_path: Path) -> None:
    words = ("explain", str(without_causes), "--out", str(tmp_path / "findings"))
    process = run_command(run_solver, *words)
    assert process.returncode == 0, process.stderr
    assert "no error found" in process.stdout
    assert "not detectable here" in process.stdout


def test_what_is_no_recording_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "no.mcap").write_bytes(b"not a recording")
    words = ("explain", str(tmp_path / "no.mcap"), "--out", str(tmp_path / "out"))
    process = run_command(run_solver, *words)
    assert process.returncode == 3
    assert len(process.stderr.splitlines()) == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.long
def test_the_demo_opens_the_seal_at_the_end(tmp_path: Path) -> None:
    """In real time: a short motion, so that whatever is hidden may as well not show."""
    program = tmp_path / "short.yaml"
    program.write_text(
        "schema: gyrorig/program/1\nname: short\nsteps:\n  - rest: {seconds: 3.0, phase: static}\n"
        "  - move: {pan_deg: 30.0, speed_deg_s: 60.0}\n  - rest: {seconds: 1.0}\n"
    )
    out = tmp_path / "demo"
    process = gyrorig(
        "demo", "--out", str(out), "--program", str(program), "--hide", "random", "--json"
    )
    assert process.returncode in (0, 1, 4), process.stderr + process.stdout
    document = json.loads(process.stdout)
    hidden = parse_yaml((out / "truth.yaml").read_bytes(), "truth.yaml")["hidden"]
    text = json.dumps(hidden, sort_keys=True, separators=(",", ":"))
    assert document["seal"] == hashlib.sha256(text.encode()).hexdigest()
    (board,) = document["boards"]
    names = {entry["cause"] for entry in hidden["causes"]}
    assert names <= {entry["cause"] for entry in board["hidden"]}
    assert all(entry["words"] for entry in board["hidden"])


def test_a_fitted_recording_cannot_be_held_out(without_causes: Path, tmp_path: Path) -> None:
    path, out = without_causes, tmp_path / "findings"
    words = ("explain", str(path), "--held-out", str(path), "--out", str(out))
    process = run_command(run_solver, *words)
    assert process.returncode == 2
    assert f"the recording {path.name} is given twice. Give each recording once" in process.stderr
    assert not out.exists()
