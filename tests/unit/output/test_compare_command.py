"""`gyrorig compare`: a calibration compared with true values or with another calibration."""

import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from tests.support.emulated_recordings import record_once
from tests.support.made_once import shared_folder

from gyrorig_solver import cli

ROOT = Path(__file__).parents[3]
GOLDEN = Path(__file__).parent / "golden"
Captured = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a recording, its true values and two versions of its calibration."""
    folder = tmp_path_factory.mktemp("compare")
    recording = record_once(shared_folder(tmp_path_factory), "quick")
    (folder / "truth.yaml").write_bytes(recording.truth_path.read_bytes())
    for _ in range(2):
        assert cli.run(["solve", str(recording.path), "--out", str(folder / "calibrations")]) == 0
    return folder


def calibration(session: Path, version: int = 1) -> str:
    (path,) = (session / "calibrations").glob(f"*/v{version:04d}.yaml")
    return str(path)


def test_every_parameter_is_compared_with_its_true_value(session: Path, capsys: Captured) -> None:
    capsys.readouterr()
    assert cli.run(["compare", calibration(session), str(session / "truth.yaml")]) == 0
    lines = capsys.readouterr().out.splitlines()
    names = [line.split()[0] for line in lines[2:15]]
    assert names[:4] == ["bias.x", "bias.y", "bias.z", "scale.x"]
    assert names[-1] == "time_offset"
    assert all(line.rstrip(" !").endswith(" u") for line in lines[2:15])
    assert "13 of 13 by at most 3.5 u" in lines[-1]


def test_the_object_has_the_numbers_of_the_table(session: Path, capsys: Captured) -> None:
    capsys.readouterr()
    arguments = ["compare", calibration(session), str(session / "truth.yaml"), "--json"]
    assert cli.run(arguments) == 0
    result = json.loads(capsys.readouterr().out)
    truth = yaml.safe_load((session / "truth.yaml").read_text(encoding="utf-8"))
    board = truth["boards"][result["board"]]
    bias = result["parameters"][0]
    assert bias["truth"] == pytest.approx(57.29577951 * board["mean_bias_rad_s"][0])
    assert bias["sigmas"] == pytest.approx((bias["found"] - bias["truth"]) / bias["std"])


def test_a_changed_value_is_marked(session: Path, tmp_path: Path, capsys: Captured) -> None:
    truth = yaml.safe_load((session / "truth.yaml").read_text(encoding="utf-8"))
    for board in truth["boards"].values():
        board["mean_bias_rad_s"][0] += 0.01
    changed = tmp_path / "truth.yaml"
    changed.write_text(yaml.safe_dump(truth), encoding="utf-8")
    capsys.readouterr()
    assert cli.run(["compare", calibration(session), str(changed)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[2].startswith("  bias.x")
    assert lines[2].endswith("u !")


def test_two_versions_of_one_recording_agree(session: Path, capsys: Captured) -> None:
    capsys.readouterr()
    assert cli.run(["compare", calibration(session), calibration(session, 2), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["compared_with"] == "other"
    assert all(row["sigmas"] == 0.0 for row in result["parameters"])


def test_calibrations_of_different_boards_have_a_remark(tmp_path: Path, capsys: Captured) -> None:
    text = (GOLDEN / "good.yaml").read_text()
    (tmp_path / "name.yaml").write_text(text.replace("GY80-0007", "OTHER-9"))
    (tmp_path / "uid.yaml").write_text(text.replace("0123456789abcdef", "f00d"))
    for name, words in (("name.yaml", "OTHER-9"), ("uid.yaml", "'f00d'")):
        assert cli.run(["compare", str(GOLDEN / "good.yaml"), str(tmp_path / name)]) == 0
        printed = capsys.readouterr().out
        assert "remark: the calibrations are of different boards, GY80-0007 with" in printed
        assert words in printed
    assert cli.run(["compare", str(GOLDEN / "good.yaml"), str(GOLDEN / "good.yaml")]) == 0
    assert "remark" not in capsys.readouterr().out


@pytest.mark.parametrize("names", [("good", "limited"), ("limited", "good")])
def test_a_parameter_without_a_value_is_shown_in_both_orders(
    names: tuple[str, str], capsys: Captured
) -> None:
    paths = [str(GOLDEN / f"{name}.yaml") for name in names]
    assert cli.run(["compare", *paths]) == 4
    printed = capsys.readouterr().out
    assert "not determined" in printed
    assert len([line for line in printed.splitlines() if line.startswith("  scale.")]) == 3


@pytest.mark.parametrize("kind", ["rig", "text", "missing"])
def test_another_kind_of_file_is_refused_in_one_line(
    session: Path, tmp_path: Path, capsys: Captured, kind: str
) -> None:
    given = {"rig": ROOT / "config" / "rig.yaml", "missing": tmp_path / "none.yaml"}
    text = tmp_path / "text.yaml"
    text.write_text("just words\n", encoding="utf-8")
    capsys.readouterr()
    assert cli.run(["compare", calibration(session), str(given.get(kind, text))]) == 3
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "Traceback" not in error


def damaged(source: Path, path: Path, *keys: str | int, value: Any) -> str:
    """Write a document with one entry replaced, and return its file."""
    document = yaml.safe_load(source.read_text(encoding="utf-8"))
    entry = document
    for key in keys[:-1]:
        entry = entry[key]
    entry[keys[-1]] = value
    path.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
    return str(path)


@pytest.mark.parametrize(
    ("keys", "value", "words"),
    [
        (("parameters", "bias", "std"), [1e-4, 1e-4], "each value of bias"),
        (("parameters", "scale", "std"), [1e-4] * 4, "each value of scale"),
        (("parameters", "misalignment", "std"), [], "each value of misalignment"),
        (("parameters", "time_offset", "std"), [1e-4], "each value of time_offset"),
        (("covariance", "matrix"), [[1.0]], "column of its covariance"),
        (("covariance", "order"), ["bias.x"], "column of its covariance"),
    ],
)
@pytest.mark.parametrize("command", ["compare", "report"])
def test_a_list_of_another_length_is_one_line(
    command: str,
    keys: tuple[str, ...],
    value: list[float],
    words: str,
    tmp_path: Path,
    capsys: Captured,
) -> None:
    path = damaged(GOLDEN / "good.yaml", tmp_path / "bad.yaml", *keys, value=value)
    others = [str(GOLDEN / "good.yaml")] if command == "compare" else []
    capsys.readouterr()
    assert cli.run([command, path, *others]) == 3
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert words in line


def test_an_uncertainty_that_is_not_stated_gives_no_sigma(tmp_path: Path, capsys: Captured) -> None:
    """Before, the sigma was that of the other calibration alone."""
    keys = ("parameters", "bias", "std")
    path = damaged(GOLDEN / "good.yaml", tmp_path / "a.yaml", *keys, value=[None, 1e-4, 1e-4])
    good = str(GOLDEN / "good.yaml")
    for pair in ((path, good), (good, path)):
        capsys.readouterr()
        assert cli.run(["compare", *pair, "--json"]) == 0
        rows = {row["name"]: row for row in json.loads(capsys.readouterr().out)["parameters"]}
        assert rows["bias.x"]["std"] is None
        assert rows["bias.y"]["std"] is not None
    path = damaged(GOLDEN / "good.yaml", tmp_path / "b.yaml", *keys, value=None)
    assert cli.run(["compare", path, good]) == 0


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("mean_bias_rad_s", [0.1, 0.2]),
        ("STM", [[1.0, 0.0], [0.0, 1.0]]),
        ("low_pass", {"kind": "butterworth", "order": 2, "cutoff_hz": 0.0}),
        ("low_pass", {"kind": "butterworth", "order": 2, "cutoff_hz": -1.0}),
    ],
)
def test_a_truth_with_another_shape_is_one_line(
    key: str, value: Any, tmp_path: Path, capsys: Captured
) -> None:
    name = yaml.safe_load((GOLDEN / "good.yaml").read_text(encoding="utf-8"))["board"]["id"]
    board = {
        "STM": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        "bias_rad_s": [0.0, 0.0, 0.0],
        "tau_s": 0.001,
        "low_pass": {"kind": "butterworth", "order": 2, "cutoff_hz": 20.0},
    }
    truth = tmp_path / "truth.yaml"
    for change, status in (({}, 0), ({key: value}, 3)):
        document = {"schema": "gyrorig/truth/1", "boards": {name: board | change}}
        truth.write_text(yaml.safe_dump(document), encoding="utf-8")
        capsys.readouterr()
        assert cli.run(["compare", str(GOLDEN / "good.yaml"), str(truth)]) == status
    assert "does not contain the true values" in capsys.readouterr().err


def test_a_refused_calibration_is_named(session: Path, tmp_path: Path, capsys: Captured) -> None:
    """Before: its values were compared without a word about its verdict."""
    refused = tmp_path / "refused.yaml"
    document = yaml.safe_load(Path(calibration(session)).read_text(encoding="utf-8"))
    document["trust"] = {"verdict": "refused", "reasons": ["the reference is no reference"]}
    document["parameters"]["scale"] = {
        **document["parameters"]["scale"], "value": [None] * 3, "std": [None] * 3,
    }  # fmt: skip
    refused.write_text(yaml.safe_dump(document), encoding="utf-8")
    capsys.readouterr()
    assert cli.run(["compare", calibration(session), str(refused)]) == 4
    out = capsys.readouterr().out
    remark = "the second calibration, version 1, is refused: the reference is no reference"
    assert f"  remark: {remark}" in out
    cli.run(["compare", str(refused), str(session / "truth.yaml")])
    assert "  remark: the first calibration, version 1, is refused" in capsys.readouterr().out
