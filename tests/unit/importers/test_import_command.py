"""The command line of the import: formats, inputs, options, and the name of the recording."""

from pathlib import Path

import pytest
from tests.support.foreign_files import write_gyro_table, write_ros2_bag
from tests.support.simulated_attitudes import SimulatedAttitudes, simulate_attitudes

from gyrorig_solver import cli
from gyrorig_solver.importers import formats


@pytest.fixture(scope="module")
def short() -> SimulatedAttitudes:
    return simulate_attitudes(2, span_s=5.0)


def test_the_help_names_the_page_of_all_keys(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["import", "--help"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "reference/import-map.md" in text
    assert "docs/how-to/import.md" in text


def test_every_format_has_a_name_and_a_title() -> None:
    for name, entry in formats().items():
        assert entry.name == name
        assert entry.title
        assert entry.used_options


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (["csw", "log.csv"], "the format 'csw' is unknown. Did you mean csv?"),
        (["csv"], "the format csv is given without an input"),
        (["nothing.bag"], "the file nothing.bag does not exist"),
        (["log.csv", "--topic", "/imu"], "option --topic has no meaning for this input"),
        (["notes.txt"], "notes.txt is a text file, which `gyrorig import` cannot read"),
        (["empty"], "empty is a folder that contains nothing, which"),
        (["drive", "--map", "map.yaml"], "option --map has no meaning for this input (ROS 2 bag"),
    ],
)
def test_what_cannot_be_imported_is_named_in_one_line(
    words: list[str],
    error: str,
    short: SimulatedAttitudes,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    write_gyro_table(tmp_path / "log.csv", short)
    Path("notes.txt").write_text("dear diary\n")
    Path("empty").mkdir()
    Path("map.yaml").write_text(
        "schema: gyrorig/import/1\nboard: B\nsensor: X\ntime: {key: t}\n"
        "gyro: {keys: [g], unit: rad/s}\n"
    )
    if words[0] == "drive":
        write_ros2_bag(tmp_path / "drive", short)
    assert cli.run(["import", *words]) in (2, 3)
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1
    assert error in printed
    assert not list(tmp_path.glob("*.mcap"))


def test_the_recording_has_the_name_of_the_input(
    short: SimulatedAttitudes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (source,) = write_ros2_bag(tmp_path / "drive", short).glob("*.mcap")
    assert cli.run(["import", "drive"]) == 0
    assert cli.run(["import", "drive"]) == 2  # it exists
    source.rename(tmp_path / "part.mcap")
    assert cli.run(["import", "part.mcap"]) == 0
    assert {path.name for path in tmp_path.glob("*.mcap")} == {
        "drive.mcap",
        "part.mcap",
        "part-imported.mcap",
    }
