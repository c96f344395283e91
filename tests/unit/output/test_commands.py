"""The commands as a person or a program calls them: words, objects, exit codes, one-line errors."""

import hashlib
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from tests.support.emulated_recordings import record_once
from tests.support.made_once import shared_folder

from gyrorig_protocol.documents import finite_values
from gyrorig_protocol.errors import UsageError
from gyrorig_solver import cli
from gyrorig_solver.calibration import parse_calibration
from gyrorig_solver.commands.terminal import printable
from gyrorig_solver.model import find_term

COMMANDS = ["demo", "import", "check", "solve", "compare", "apply", "export", "report", "plan"]
Captured = pytest.CaptureFixture[str]


@pytest.fixture(scope="session")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, int], Path]:
    """Record a program on the emulated rig, faster than time; each kind once."""
    shared = shared_folder(tmp_path_factory)
    return lambda program, seed: record_once(shared, program, "--seed", str(seed)).path


def test_texts_from_strangers_do_not_steer_the_terminal(capsys: Captured) -> None:
    assert printable("a\x1b[2J\u202eb\nc µ") == "a\\x1b[2J\\u202eb\nc µ"
    for options in ([], ["--traceback"]):
        assert cli.run([*options, "check", "a\x1b[2J.mcap"]) == 3
        assert "\x1b" not in capsys.readouterr().err


def test_numbers_that_json_does_not_know_are_null() -> None:
    assert finite_values({"a": [float("nan"), 1.0], "b": (float("inf"),)}) == {
        "a": [None, 1.0],
        "b": [None],
    }


def one_line(captured: str) -> str:
    assert captured.count("\n") == 1, captured
    assert captured.startswith("gyrorig: ")
    assert "Traceback" not in captured
    return captured


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_an_example(command: str, capsys: Captured) -> None:
    assert cli.run([command, "--help"]) == 0
    text = capsys.readouterr().out
    assert "Example" in text
    assert f"gyrorig {command}" in text


def test_help_names_every_command_and_version_the_project(capsys: Captured) -> None:
    assert cli.run(["--help"]) == 0
    text = capsys.readouterr().out
    assert all(f"\n  {name} " in text for name in [*COMMANDS, "record", "emulate"])
    assert cli.run(["--version"]) == 0
    assert capsys.readouterr().out.startswith("gyrorig ")


@pytest.mark.parametrize(
    "arguments",
    [
        ["nonsense"],
        ["solve"],
        ["solve", "x.mcap", "--method", "magic"],
        ["check", "--colour"],
        ["demo", "--seed", "-1"],
        ["import", "no-such-format", "x.csv", "--out", "x.mcap"],
    ],
)
def test_wrong_usage_is_one_line_and_2(arguments: list[str], capsys: Captured) -> None:
    assert cli.run(arguments) == 2
    one_line(capsys.readouterr().err)


@pytest.mark.parametrize("arguments", [[], ["store"]])
def test_a_group_by_itself_shows_its_help_in_lines(arguments: list[str], capsys: Captured) -> None:
    assert cli.run(arguments) == 2
    text = capsys.readouterr().err
    assert text.startswith("Usage: gyrorig")
    assert "\nCommands:\n" in text


def test_a_cause_that_is_misspelt_is_guessed() -> None:
    with pytest.raises(UsageError, match=r"'backlsh' is not .*\. Did you mean backlash\?"):
        find_term("backlsh")
    with pytest.raises(UsageError, match=r"'xyzzy' is not .*\. `gyrorigd causes` lists all"):
        find_term("xyzzy")


@pytest.mark.parametrize("command", ["check", "solve"])
@pytest.mark.parametrize("content", [None, b"", b"not a recording", b"\x89MCAP0\r\n" + b"x" * 99])
def test_what_is_no_recording_is_one_line_and_3(
    command: str,
    content: bytes | None,
    tmp_path: Path,
    capsys: Captured,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "input.mcap"
    if content is not None:
        path.write_bytes(content)
    assert cli.run([command, str(path)]) == 3
    assert "input.mcap" in one_line(capsys.readouterr().err)
    assert cli.run([command, str(path), "--json"]) == 3
    captured = capsys.readouterr()
    assert json.loads(captured.out)["exit_code"] == 3


def test_a_reader_that_goes_away_is_no_fault() -> None:
    line = f"{sys.executable} -m gyrorig_solver solve --help | true; exit ${{PIPESTATUS[0]}}"
    process = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=False)
    assert process.stderr == ""
    assert process.returncode in (0, 1)


def test_a_demo_that_cannot_record_says_why_in_one_line(tmp_path: Path, capsys: Captured) -> None:
    program = tmp_path / "far.yaml"
    program.write_text("schema: gyrorig/program/1\nname: far\nsteps: [{move: {pan_deg: 999.0}}]\n")
    assert cli.run(["demo", "--out", str(tmp_path / "out"), "--program", str(program)]) == 2
    assert "pan" in one_line(capsys.readouterr().err)


def test_a_fault_of_the_program_is_one_line_and_1(
    capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    def break_down(*_: object, **__: object) -> None:
        raise KeyError("inside")

    monkeypatch.setattr(cli.cli, "main", break_down)
    assert cli.run(["check", "x.mcap"]) == 1
    line = one_line(capsys.readouterr().err)
    assert "fault in the program" in line
    assert "gyrorig --traceback check x.mcap" in line


@pytest.mark.parametrize("missing", ["scipy", "jinja2"])
def test_without_the_solver_extra_the_error_names_it(missing: str, tmp_path: Path) -> None:
    code = (
        f"import sys; sys.modules[{missing!r}] = None; from gyrorig_solver.cli import run; "
        "print(run(['--help'])); sys.exit(run(['solve', 'x.mcap']))"
    )
    process = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, check=False
    )
    assert process.returncode == 2, process.stderr
    assert "gyrorig[solver]" in one_line(process.stderr)
    assert process.stdout.endswith("0\n")


@pytest.mark.parametrize("command", ["record", "emulate"])
def test_the_daemon_gets_its_own_arguments(command: str, tmp_path: Path) -> None:
    process = subprocess.run(
        [sys.executable, "-m", "gyrorig_solver", command, "--config", "none.yaml", "--odd"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        check=False,
    )
    assert process.returncode == 2
    assert "--odd" in process.stderr
    shown = subprocess.run(
        [sys.executable, "-m", "gyrorig_solver", command, "--help"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert "--config" in shown.stdout


def test_check_tells_what_a_recording_can_calibrate(
    simulated: Callable[[str, int], Path], capsys: Captured
) -> None:
    path = simulated("quick", 3)
    assert cli.run(["check", str(path)]) == 0
    text = capsys.readouterr().out
    assert "sound" in text
    assert "12 of 12" in text
    assert cli.run(["check", str(path), "--json"]) == 0
    description = json.loads(capsys.readouterr().out)["recordings"][0]
    assert description["complete"]
    assert description["boards"][0]["lost"] == 0
    assert description["boards"][0]["clock_pings"] > 0
    assert description["identifiable"]


def test_check_of_a_rest_says_what_is_missing_and_why(
    simulated: Callable[[str, int], Path], capsys: Captured
) -> None:
    assert cli.run(["check", str(simulated("static", 3))]) == 4
    text = capsys.readouterr().out
    assert "sound, but cannot calibrate all" in text
    assert "3 of 12" in text
    assert "cannot be determined. " in text


def test_check_of_a_cut_recording_says_what_is_lost(
    simulated: Callable[[str, int], Path], tmp_path: Path, capsys: Captured
) -> None:
    whole = simulated("quick", 3).read_bytes()
    cut = tmp_path / "cut.mcap.part"
    cut.write_bytes(whole[: len(whole) * 3 // 4])
    cli.run(["check", str(cut)])
    text = capsys.readouterr().out
    assert "usable, with remarks" in text
    assert "  ! " in text


def test_several_recordings_one_bad_is_done_in_part(
    simulated: Callable[[str, int], Path], tmp_path: Path, capsys: Captured
) -> None:
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(b"bad")
    assert cli.run(["check", str(simulated("quick", 3)), str(bad)]) == 5
    captured = capsys.readouterr()
    assert "12 of 12" in captured.out
    assert "bad.mcap" in one_line(captured.err)


def test_solving_twice_changes_no_number_and_chains_the_versions(
    simulated: Callable[[str, int], Path], tmp_path: Path, capsys: Captured
) -> None:
    path = str(simulated("survey-40", 3))  # quick rests at too few tilts
    for _ in range(2):
        assert cli.run(["solve", path, "--out", str(tmp_path)]) == 0
    output = capsys.readouterr().out
    assert "version 1: good\n  All 12 parameters were determined" in output
    assert "  Next: use it with `gyrorig apply`" in output
    first, second = (tmp_path / "GY80-1" / f"v000{n}.yaml" for n in (1, 2))
    digest = "sha256:" + hashlib.sha256(first.read_bytes()).hexdigest()
    assert parse_calibration(second.read_bytes(), "v0002").previous == digest
    old, new = yaml.safe_load(first.read_text()), yaml.safe_load(second.read_text())
    assert old.pop("findings")["file"] == "v0001.findings.yaml"
    assert new.pop("findings")["file"] == "v0002.findings.yaml"
    for key in ("version", "previous", "created"):
        old.pop(key, None)
        new.pop(key, None)
    assert old == new
    assert first.with_suffix(".report.html").stat().st_size > 50_000


def test_a_page_is_made_again_with_its_recordings_or_without(
    simulated: Callable[[str, int], Path], tmp_path: Path, capsys: Captured
) -> None:
    path, out = simulated("quick", 3), tmp_path / "out"
    assert cli.run(["solve", str(path), "--out", str(out), "--json"]) == 0
    board = json.loads(capsys.readouterr().out)["boards"][0]
    document, page = board["file"], Path(board["report"]).read_text()
    again = tmp_path / "again.html"
    assert cli.run(["report", document, str(path), "-o", str(again), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["figures"] is True
    assert again.read_text() == page
    assert cli.run(["report", document, "-o", str(again)]) == 0
    assert "<figure" not in again.read_text()
    assert board["calibration"]["inputs"][0]["sha256"] in again.read_text()
    capsys.readouterr()
    other = tmp_path / "other.mcap"
    other.write_bytes(path.read_bytes()[:-9000])
    assert cli.run(["report", document, str(other)]) == 3
    assert "Give all recordings that the calibration was solved from" in capsys.readouterr().err
    assert cli.run(["report", str(path)]) == 3


def test_solve_of_a_rest_gives_nulls_and_4(
    simulated: Callable[[str, int], Path], tmp_path: Path, capsys: Captured
) -> None:
    path = str(simulated("static", 3))
    assert cli.run(["solve", path, "--out", str(tmp_path), "--json"]) == 4
    board = json.loads(capsys.readouterr().out)["boards"][0]
    assert board["verdict"] == "limited"
    assert board["calibration"]["parameters"]["scale"]["value"] == [None, None, None]
    assert None not in board["calibration"]["parameters"]["bias"]["value"]


def test_paper_method_is_written_as_such(
    simulated: Callable[[str, int], Path], tmp_path: Path, capsys: Captured, contract_judge: Path
) -> None:
    path = str(simulated("quick", 3))
    assert cli.run(["solve", path, "--method", "paper", "--out", str(tmp_path)]) == 4
    assert "refused" in capsys.readouterr().out
    written = tmp_path / "GY80-1" / "v0001.yaml"
    assert parse_calibration(written.read_bytes(), "v0001").solver.method == "paper"
    judged = subprocess.run(
        [sys.executable, str(contract_judge), str(written)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert judged.returncode == 0, judged.stdout


def test_a_board_that_is_not_there_is_one_line_and_3(
    simulated: Callable[[str, int], Path], tmp_path: Path, capsys: Captured
) -> None:
    path = str(simulated("quick", 3))
    assert cli.run(["solve", path, "--board", "NOBODY", "--out", str(tmp_path / "cal")]) == 3
    assert "GY80-1" in one_line(capsys.readouterr().err)
    assert not (tmp_path / "cal").exists()


def test_import_check_solve_of_a_table(tmp_path: Path, capsys: Captured) -> None:
    rows = ["t,gx,gy,gz"] + [f"{k / 100:.2f},{0.01:.6f},{-0.02:.6f},{1e-4 * (k % 7):.6f}"
                             for k in range(2000)]  # fmt: skip
    table, columns = tmp_path / "rest.csv", tmp_path / "columns.yaml"
    table.write_text("\n".join(rows) + "\n")
    columns.write_text(
        'schema: gyrorig/import/1\nboard: "T1"\nsensor: "unknown"\ntime: {key: t}\n'
        "gyro: {keys: [gx, gy, gz], unit: rad/s}\nstatic: [{start: 0, end: 2000}]\n"
    )
    out = tmp_path / "rest.mcap"
    order = ["import", "csv", str(table), "--map", str(columns), "--out", str(out), "--json"]
    assert cli.run(order) == 0
    assert json.loads(capsys.readouterr().out)["samples"] == 2000
    assert cli.run(order) == 2  # it exists: nothing is overwritten
    one_line(capsys.readouterr().err)
    assert cli.run(["check", str(out)]) == 4
