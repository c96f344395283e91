"""Single events of several recordings: each keeps its own size and figure."""

import json
from pathlib import Path

import pytest
from tests.unit.twin.conftest import record, run_gyrorig

from gyrorig_protocol.twin import parse_twin
from gyrorig_solver.findings.findings_document import parse_findings

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two recordings that lose 16 and 4 steps."""
    folder = tmp_path_factory.mktemp("events")
    recordings = []
    for number, steps in enumerate((16, 4), start=1):
        options = ("--seed", "3", "--session-seed", str(number), "--session", f"s{number}")
        hidden = ("--hide", f"lost_steps@pan:{steps}")
        recordings.append(record(folder / str(number), *options, *hidden)[0])
    return recordings


def test_a_twin_has_the_event_of_each_recording(files: list[Path], tmp_path: Path) -> None:
    """Before, both events had the values of the last one, 240 standard uncertainties off."""
    process = run_gyrorig("twin", *files, "--out", tmp_path)
    assert process.returncode == 0, process.stderr
    twin = parse_twin((tmp_path / "twin.yaml").read_bytes(), "twin.yaml")
    sizes = {c.recording: c.parameters["angle.pan"] for c in twin.causes if c.cause == "lost_steps"}
    first, last = (sizes[path.name] for path in files)
    assert first.std is not None
    assert abs(first.value / last.value - 4.0) < 0.2
    assert twin.posterior is not None
    assert sum(name.startswith("causes.") for name in twin.posterior.names) >= 2


def test_each_event_has_its_figure(files: list[Path], tmp_path: Path) -> None:
    process = run_gyrorig("explain", *files, "--out", tmp_path)
    assert process.returncode in (0, 4), process.stderr
    document = parse_findings((tmp_path / "GY80-1" / "findings.yaml").read_bytes(), "findings.yaml")
    figures = {cause.evidence.figure for cause in document.causes if cause.cause == "lost_steps"}
    assert len(figures) == 2
    assert all((tmp_path / "GY80-1" / str(figure)).is_file() for figure in figures)


def test_the_event_is_not_repeated_in_a_new_recording(files: list[Path], tmp_path: Path) -> None:
    """Before, the check found 10 differences: the twin lost the steps again."""
    sound = record(tmp_path / "new", "--seed", "3", "--session-seed", "7", "--session", "sound")[0]
    out = tmp_path / "twin"
    assert run_gyrorig("twin", files[0], "--out", out).returncode == 0
    (event,) = parse_twin((out / "twin.yaml").read_bytes(), "twin.yaml").causes
    assert (event.cause, event.recording) == ("lost_steps", files[0].name)
    process = run_gyrorig("twin-check", sound, files[0], out, "--draws", "10", "--json")
    assert process.returncode == 0, process.stderr
    new, fitted = sorted(json.loads(process.stdout)["boards"], key=lambda board: -board["held_out"])
    assert (new["different"], fitted["different"]) == (False, False)
    assert f"lost_steps in {files[0].name}" in new["not_repeated"]
    assert fitted["not_repeated"] == ""
    # In the fitted recording, the event happens: without it, the twin would be far off.
    assert fitted["after"]["log_density_nats_per_s"] > (
        fitted["without_causes"]["log_density_nats_per_s"] + 100.0
    )
