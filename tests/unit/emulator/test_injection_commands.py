"""Injection of causes on the command line: output, commitment, recording metadata."""

import hashlib
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from gyrorig_daemon.cli import run
from gyrorig_daemon.session.emulation_options import estimate_session_s
from gyrorig_protocol.program import parse_program
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording

ROOT = Path(__file__).resolve().parents[3]
RIG = ROOT / "config" / "rig.yaml"
PROGRAM = """\
schema: gyrorig/program/1
name: short
settings: {base_speed_deg_s: 3.0, acceleration_deg_s2: 200.0}
steps:
  - rest: {seconds: 2.0, phase: static}
  - move: {pan_deg: 60.0, tilt_deg: -20.0, speed_deg_s: 60.0}
  - rest: {seconds: 1.0}
  - move: {pan_deg: 0.0, tilt_deg: 10.0, speed_deg_s: 80.0}
  - rest: {seconds: 2.0, phase: static}
"""


def order(folder: Path, *more: str) -> list[str]:
    program = folder / "short.yaml"
    program.write_text(PROGRAM)
    return ["record", "--config", str(RIG), "--program", str(program), "--out", str(folder),
            "--session", "s", "--simulated-time", "--json", *more]  # fmt: skip


def recorded(folder: Path, capsys: pytest.CaptureFixture[str], *more: str) -> dict[str, Any]:
    """What the command printed."""
    assert run(order(folder, *more)) == 0
    document: dict[str, Any] = json.loads(capsys.readouterr().out)
    return document


def recording(folder: Path, capsys: pytest.CaptureFixture[str], *more: str) -> Recording:
    folder.mkdir()
    return read_recording(Path(recorded(folder, capsys, *more)["recording"]))


def own_description(rec: Recording) -> tuple[object, object]:
    """What a recording says besides its messages, without the instant it was made."""
    metadata = {name: dict(record) for name, record in rec.metadata.items()}
    for key in ("anchor_utc_ns", "anchor_monotonic_raw_ns"):
        metadata["gyrorig"].pop(key)
    return metadata, [(a.name, a.media_type, a.data) for a in rec.attachments]


def test_the_truth_states_the_cause_with_its_parameters(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = tmp_path / "truth.yaml"
    recorded(tmp_path, capsys, "--hide", "backlash@tilt:1e-3", "--hide", "bias_step@y",
             "--truth", str(truth))  # fmt: skip
    document = yaml.safe_load(truth.read_text())
    gap, step = document["hidden"]["causes"]
    size = {"value": 1e-3, "unit": "rad"}
    assert gap == {
        "cause": "backlash", "part": "ptu", "where": "tilt", "board": None,
        "size": size, "parameters": {"gap": size},
    }  # fmt: skip
    assert (step["board"], step["where"]) == ("GY80-1", "y")
    values = step["parameters"]["step"]["value"]
    assert values[1] == step["size"]["value"]
    assert (values[0], values[2]) == (0.0, 0.0)
    begin_s, end_s = estimate_session_s(parse_program(PROGRAM, "short"))
    middle = (step["parameters"]["at"]["value"] - begin_s) / (end_s - begin_s)
    assert 0.35 <= middle <= 0.65


@pytest.mark.long
def test_a_recording_does_not_say_what_it_hides(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    causes = ("ringing", "thermal_bias", "wrong_full_scale:2", "base_speed_jump", "clock_skew")
    hide = [word for cause in causes for word in ("--hide", cause)]
    plain = recording(tmp_path / "plain", capsys)
    hiding = recording(tmp_path / "hiding", capsys, *hide)
    random = recording(tmp_path / "random", capsys, "--hide", "random", "--truth",
                       str(tmp_path / "truth.json"))  # fmt: skip
    quiet = recording(tmp_path / "quiet", capsys, "--noise-free")
    for other in (hiding, random, quiet):
        assert own_description(other) == own_description(plain)
        messages = str([m for topic in ("/diagnostics", "/session/event")
                    for m in other.messages(topic)])  # fmt: skip
        assert not any(cause.split(":")[0] in messages for cause in causes)


def test_noise_free_leaves_the_rounding_only(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    quiet = recording(tmp_path / "a", capsys, "--noise-free").array("/board/GY80-1/imu_raw")
    noisy = recording(tmp_path / "b", capsys).array("/board/GY80-1/imu_raw")
    first_second = slice(20, 120)
    assert np.ptp(quiet["gyro"][first_second], axis=0).max() <= 1
    assert np.ptp(noisy["gyro"][first_second], axis=0).min() > 30
    assert (quiet["sequence"][:50] == noisy["sequence"][:50]).all()


def test_a_soak_shows_in_the_temperature(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plain = recording(tmp_path / "a", capsys).array("/board/GY80-1/imu_raw")
    soaked = recording(tmp_path / "b", capsys, "--soak", "20").array("/board/GY80-1/imu_raw")
    rise_k = 0.1 * (soaked["temperature"].astype(float) - plain["temperature"])
    assert rise_k.max() == pytest.approx(20.0, abs=0.2)
    assert rise_k[-1] < 5.0  # and cools down again
    assert rise_k[0] < 5.0
    assert (soaked["gyro"] == plain["gyro"]).all()


def test_the_truth_says_when_steps_were_lost(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = tmp_path / "truth.json"
    output = recorded(tmp_path, capsys, "--hide", "lost_steps@pan:8", "--truth", str(truth))
    document = json.loads(truth.read_text())
    at_s = document["happened"]["lost_steps.pan"]["value"]
    (hidden,) = document["hidden"]["causes"]
    rec = read_recording(Path(output["recording"]))
    begun_s = 1e-9 * (
        int(rec.metadata["gyrorig"]["anchor_monotonic_raw_ns"]) - document["power_up_raw_ns"]
    )
    positions = rec.array("/ptu/position")
    time_s = begun_s + 1e-9 * (positions["log_time"].astype(np.int64) - rec.start_ns)
    at = int(np.searchsorted(time_s, at_s))
    assert hidden["parameters"]["after"]["value"] < at_s
    assert positions["pan_steps"][at] != positions["pan_steps"][at - 20]  # pan was turning


def test_a_sealed_truth_is_opened_at_the_end(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = tmp_path / "truth.json"
    assert run(order(tmp_path, "--hide", "random", "--seed", "8", "--truth", str(truth))) == 0
    output = capsys.readouterr()
    seal = json.loads(output.out)["seal"]
    assert f"SHA-256 is {seal}" in output.err
    document = json.loads(truth.read_text())
    text = json.dumps(document["hidden"], sort_keys=True, separators=(",", ":"))
    assert hashlib.sha256(text.encode()).hexdigest() == seal == document["seal"]["sha256"]
    assert len(document["hidden"]["causes"]) == 1
    assert "mean_bias_rad_s" in document["boards"]["GY80-1"]


def test_the_emulator_alone_keeps_its_seal_closed_while_it_runs(tmp_path: Path) -> None:
    truth = tmp_path / "truth.json"
    command = [
        sys.executable,
        "-m",
        "gyrorig_daemon",
        "emulate",
        "--config",
        str(RIG),
        "--json",
        "--until-eof",
        "--hide",
        "random",
        "--hide",
        "worm_error@pan",
        "--truth",
        str(truth),
    ]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdin is not None
        announced = json.loads(process.stdout.readline())
        closed = json.loads(truth.read_text())
        assert set(closed) == {"seal"}
        assert closed["seal"]["sha256"] == announced["seal"]
        process.stdin.close()
        assert process.wait(60) == 0
    opened = json.loads(truth.read_text())
    assert opened["hidden"]["causes"][1]["where"] == "pan"
    assert opened["seal"] == closed["seal"]


def test_the_causes_can_be_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["causes"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 42
    line = "backlash@pan,tilt: gap between motor and gear; random size: 0.0002 to 0.0025 rad"
    assert line in lines
    assert run(["causes", "--json"]) == 0
    causes = {entry["cause"]: entry for entry in json.loads(capsys.readouterr().out)["causes"]}
    assert causes["backlash"]["typical"] == 9e-4
    assert causes["wrong_full_scale"]["nothing_at"] == 1.0


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (("--hide", "wobble"), "is not the name of a simulated error"),
        (("--hide", "backlash:wide"), "a number in rad"),
        (("--hide", "backlash@z"), "After @, write one of pan, tilt"),
        (("--hide", "random"), "Add --truth FILE"),
    ],
)
def test_what_cannot_be_hidden_ends_with_2_and_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], more: tuple[str, ...], words: str
) -> None:
    for simulated in (True, False):
        arguments = order(tmp_path, *more)
        if not simulated:
            arguments.remove("--simulated-time")
        assert run(arguments) == 2
        errors = capsys.readouterr().err
        assert words in errors
        assert errors.count("\n") == 1
    assert not list(tmp_path.glob("*.mcap*"))


def test_a_real_rig_hides_nothing_on_demand(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = tmp_path / "rig.yaml"
    text = RIG.read_text().replace("port: emulated", "port: /dev/null", 1)
    rig.write_text(text.replace("port: emulated", "port: /dev/zero", 1))
    arguments = order(tmp_path, "--hide", "backlash")
    arguments.remove("--simulated-time")
    arguments[2] = str(rig)
    assert run(arguments) == 2
    assert "need an emulated rig" in capsys.readouterr().err
