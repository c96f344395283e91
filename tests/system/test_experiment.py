"""An experiment on an emulated rig in simulated time; the solver is a child of the service."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from tests.support.simulated_service import Bench

from gyrorig_daemon.emulator.emulator_settings import RigSettings
from gyrorig_daemon.emulator.injection import parse_injection
from gyrorig_daemon.service.jobs import UntilNamed
from gyrorig_daemon.service.service_loop import LoopExit
from gyrorig_protocol.recording.reader import read_recording

SURVEY = Path(__file__).resolve().parents[2] / "config" / "programs" / "survey-40.yaml"
HIDDEN = "scale_asymmetry@z:0.0005"


def hide_cause(settings: RigSettings) -> RigSettings:
    return replace(settings, injections=(parse_injection(HIDDEN),))


def program_name(recording: Path) -> str:
    (program,) = (
        attached.data
        for attached in read_recording(recording).attachments
        if attached.name == "program.yaml"
    )
    return str(yaml.safe_load(program)["name"])


@pytest.mark.long
def test_a_hidden_cause_gets_one_name(tmp_path: Path) -> None:
    bench = Bench(tmp_path, change=hide_cause)
    bench.waits_for_solver = True
    limits = UntilNamed(minutes=20.0, rounds=3)
    bench.at(3.0, lambda: bench.put(SURVEY.read_text(), session="x", until_named=limits))
    ending = bench.serve(1_500.0, lambda: bool(bench.results("done") + bench.results("failed")))
    bench.state.__exit__(None, None, None)
    assert ending is LoopExit.END
    (path,) = bench.results("done") + bench.results("failed")
    document = json.loads(path.read_text())
    assert document["result"] == "done", document["reason"]
    experiment = document["experiment"]
    first, *_, last = experiment["rounds"]
    assert [len(cause["one_of"]) for cause in first["causes"]] == [1]
    assert "scale_asymmetry" in {first["causes"][0]["cause"], *first["causes"][0]["one_of"]}
    assert experiment["outcome"] == "named"
    assert [c["one_of"] for c in last["causes"] if c["cause"] == "scale_asymmetry"] == [[]]
    assert all(c["cause"] != "scale_quadratic" for c in last["causes"])
    assert 2 <= len(experiment["rounds"]) <= 3
    programs = [program_name(path) for path in bench.recordings()]
    assert programs[0] == "survey-40"
    assert len(programs) == len(experiment["rounds"])
    explaining = [s for s in bench.statuses if s["state"] == "explaining"]
    assert explaining[0]["experiment"]["step"] == "explaining"
    assert bench.log[0].startswith("Ready.")
    assert any("explaining 2 recordings" in line for line in bench.log)
