"""Reading a calibration for use: unknown parameters are errors with a suggestion."""

from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from gyrorig_protocol.errors import InputError
from gyrorig_solver import Calibration, cli
from gyrorig_solver.apply import read_calibration
from gyrorig_solver.calibration import CalibrationDocument
from gyrorig_solver.discover.attitude.attitude_terms import attitude_terms
from gyrorig_solver.model.catalogue import catalogue

Captured = pytest.CaptureFixture[str]


def rename_parameter(path: Path, name: str, wrong_name: str) -> Path:
    """Write the calibration again with one parameter under another name."""
    document = yaml.safe_load(path.read_text())
    document["parameters"][wrong_name] = document["parameters"].pop(name)
    path.write_text(yaml.safe_dump(document))
    return path


@pytest.mark.parametrize(
    ("name", "wrong_name"), [("scale", "scael"), ("bias", "bais"), ("time_offset", "time_ofset")]
)
def test_a_misspelt_base_parameter_is_an_error_with_a_suggestion(
    golden: Path, name: str, wrong_name: str
) -> None:
    rename_parameter(golden, name, wrong_name)
    with pytest.raises(
        InputError, match=rf"unknown parameter '{wrong_name}'\. Did you mean {name}\?"
    ):
        Calibration.load(golden)


@pytest.mark.parametrize(
    ("parameter", "suggestion"),
    [
        ("scale_cubik", "scale_cubic"),
        ("thermal_bias.slop", "thermal_bias.slope"),
        ("back_lash.gap", None),
        ("bias.x", "bias"),
    ],
)
def test_a_misspelt_cause_is_an_error(
    document: Callable[..., CalibrationDocument], parameter: str, suggestion: str | None
) -> None:
    entry = {"value": [0.0] * 3, "std": [0.0] * 3, "unit": "1"}
    with pytest.raises(InputError, match="unknown parameter") as caught:
        Calibration(document(parameters={parameter: entry}))
    assert caught.value.remedy
    if suggestion:
        assert f"did you mean {suggestion}?" in caught.value.remedy


@pytest.mark.parametrize("parameter", ["backlash.gap", "bias_step@2.step", "thermal_bias.lag"])
def test_the_parameters_of_the_catalogue_are_known(
    document: Callable[..., CalibrationDocument], parameter: str
) -> None:
    entry = {"value": [0.0] * 3, "std": [0.0] * 3, "unit": "1"}
    assert Calibration(document(parameters={parameter: entry})).board == "GY80-0007"


@pytest.mark.parametrize("cause", sorted(attitude_terms().keys() - catalogue().keys()))
def test_the_parameters_of_a_fit_to_attitudes_are_known(
    document: Callable[..., CalibrationDocument], cause: str
) -> None:
    entry = {"value": [0.0] * 3, "std": [0.0] * 3, "unit": "1"}
    assert Calibration(document(parameters={cause: entry})).board == "GY80-0007"


def test_a_missing_base_parameter_is_an_error(golden: Path) -> None:
    document = yaml.safe_load(golden.read_text())
    del document["parameters"]["bias"]
    golden.write_text(yaml.safe_dump(document))
    with pytest.raises(InputError, match="lacks the parameter 'bias'"):
        read_calibration(golden)


@pytest.mark.parametrize("command", [["export", "--format", "json"], ["report"]])
def test_every_command_that_reads_a_calibration_checks_it(
    golden: Path, command: list[str], capsys: Captured
) -> None:
    rename_parameter(golden, "scale", "scael")
    assert cli.run([command[0], str(golden), *command[1:]]) == 3
    assert "Did you mean scale?" in capsys.readouterr().err


def test_a_calibration_given_as_the_table_is_recognised(
    golden: Path, tmp_path: Path, capsys: Captured
) -> None:
    out = tmp_path / "out.csv"
    arguments = ["apply", str(golden), str(golden), "--columns", "x,y,z", "-o", str(out)]
    assert cli.run(arguments) == 3
    assert "is a calibration, not a text table" in capsys.readouterr().err
    assert not out.exists()


def test_a_recording_given_as_the_calibration_is_recognised(
    golden: Path, tmp_path: Path, capsys: Captured
) -> None:
    recording = tmp_path / "session.mcap"
    recording.write_bytes(b"\x89MCAP0\r\n" + bytes(100))
    assert cli.run(["apply", str(recording), str(golden), "-o", str(tmp_path / "out.csv")]) == 3
    assert "is a recording (MCAP)" in capsys.readouterr().err


def test_a_dash_is_standard_output(
    golden: Path, tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before, `gyrorig export` wrote a file with the name `-`."""
    monkeypatch.chdir(tmp_path)
    before = set(tmp_path.iterdir())
    assert cli.run(["export", str(golden), "--format", "json", "-o", "-"]) == 0
    assert '"board"' in capsys.readouterr().out
    assert set(tmp_path.iterdir()) == before
