"""Tables: the text stays, the rates are right, and what is wrong is said in one line."""

import json
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gyrorig_solver import Calibration, cli
from gyrorig_solver.apply import corrected_table
from gyrorig_solver.apply.corrected_table import TableColumns, apply_to_table
from gyrorig_solver.calibration import CalibrationDocument as Document
from gyrorig_solver.calibration.calibration_document import calibration_as_yaml

Captured = pytest.CaptureFixture[str]
GYRO = ("gx", "gy", "gz")
RNG = np.random.default_rng(5)


def table(path: Path, rows: int = 30, delimiter: str = ",", end: str = "\n") -> np.ndarray:
    data = RNG.integers(-20000, 20000, size=(rows, 3))
    lines = [delimiter.join(("t", "note", *GYRO))]
    lines += [
        delimiter.join((f"{k / 100:.2f}", '"a word"', *map(str, row)))
        for k, row in enumerate(data.tolist())
    ]
    path.write_text(end.join(lines) + end, newline="")
    return data


@pytest.mark.parametrize(("delimiter", "end"), [(",", "\n"), (";", "\r\n"), ("\t", "\n")])
def test_rates_are_added_to_the_unchanged_text(
    golden: Path, tmp_path: Path, delimiter: str, end: str
) -> None:
    counts = table(tmp_path / "in.csv", delimiter=delimiter, end=end)
    result = Calibration.load(golden)
    summary = apply_to_table(
        result, tmp_path / "in.csv", tmp_path / "out.csv", TableColumns(GYRO, time="t")
    )
    old = (tmp_path / "in.csv").read_text().splitlines()
    new = (tmp_path / "out.csv").read_text().splitlines()
    assert all(n.startswith(o + delimiter) for o, n in zip(old, new, strict=True))
    cells = [line.split(delimiter) for line in new]
    assert cells[0][-4:] == ["rate_x_rad_s", "rate_y_rad_s", "rate_z_rad_s", "time_of_motion_s"]
    output = np.array([row[-4:] for row in cells[1:]], dtype=float)
    np.testing.assert_allclose(output[:, :3], result.rates(counts), rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(output[:, 3], np.arange(30) / 100 - 0.0125, atol=1e-9)
    assert summary.rows == 30
    assert summary.without == 0
    assert summary.outside == int(np.sum(np.abs(result.rates(counts)).max(axis=1) > 1.25))


def test_blocks_do_not_change_the_result(
    golden: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    table(tmp_path / "in.csv")
    result = Calibration.load(golden)
    apply_to_table(result, tmp_path / "in.csv", tmp_path / "one.csv", TableColumns(GYRO))
    monkeypatch.setattr(corrected_table, "ROWS_PER_BLOCK", 7)
    apply_to_table(result, tmp_path / "in.csv", tmp_path / "two.csv", TableColumns(GYRO))
    assert (tmp_path / "one.csv").read_bytes() == (tmp_path / "two.csv").read_bytes()


def test_a_row_without_a_reading_has_no_rate(golden: Path, tmp_path: Path) -> None:
    (tmp_path / "in.csv").write_text("gx,gy,gz\n1,2,3\n4,,6\nnan,8,9\n10,11,12\n")
    summary = apply_to_table(
        Calibration.load(golden), tmp_path / "in.csv", tmp_path / "out.csv", TableColumns(GYRO)
    )
    lines = (tmp_path / "out.csv").read_text().splitlines()
    assert [line.endswith(",,,") for line in lines] == [False, False, True, True, False]
    assert (summary.rows, summary.without) == (4, 2)


def test_a_row_without_a_time_has_rates(golden: Path, tmp_path: Path, capsys: Captured) -> None:
    (tmp_path / "in.csv").write_text("t,gx,gy,gz\n0,1,2,3\n,1,2,3\n2,,2,3\n")
    command = ["apply", str(golden), str(tmp_path / "in.csv"), "--columns", "gx,gy,gz"]
    assert cli.run([*command, "--time", "t", "-o", str(tmp_path / "out.csv")]) == 0
    rows = [line.split(",")[4:] for line in (tmp_path / "out.csv").read_text().splitlines()[1:]]
    assert rows[1] == [*rows[0][:3], ""]
    assert rows[2] == ["", "", "", ""]
    printed = capsys.readouterr().out
    assert "1 rows have no time and get no time of the motion" in printed
    assert "1 rows have no reading and get no rate" in printed


def test_a_block_of_blank_lines_is_skipped(
    golden: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(corrected_table, "ROWS_PER_BLOCK", 2)
    (tmp_path / "in.csv").write_text("gx,gy,gz\n1,2,3\n4,5,6\n\n\n7,8,9\n")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        summary = apply_to_table(
            Calibration.load(golden), tmp_path / "in.csv", tmp_path / "out.csv", TableColumns(GYRO)
        )
    assert summary.rows == 3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("gx,gy\n1,2\n", "no column 'gz'"),
        ("gx,gy,gz, gx\n1,2,3,4\n", "the table in.csv has 2 columns with the name 'gx'"),
        ("gx,gy,gz\n", "a header, but no rows"),
        ("gx,gy,gz\n1,2\n", "row 1 of the table in.csv has only 2 columns"),
        ("gx,gy,gz\n1,2,3\n1,x,3\n", "has 'x' in the column gy, which is not a number"),
        ("gx,gy,gz,note\n1,2,3,a\n1,2,3\n", "row 2 of the table in.csv has 3 columns, but the"),
        ("gx,gy,gz\n1,2,3\n1,2,3,4\n", "row 2 of the table in.csv has 4 columns, but the"),
        ("gx;gy;gz\n1;2;3\n1;2;3;\n", "row 2 of the table in.csv has 4 columns, but the"),
        ("gx,gy,gz,rate_x_rad_s\n1,2,3,4\n", "calibrated data (column rate_x_rad_s)"),
        ("", "no column 'gx'"),
        (
            "gx,gy,gz,note\n1,2,3,a\n1,2,3," + 200_000 * "n" + ",\n",
            "row 2 of the table in.csv cannot",
        ),
    ],
)
def test_an_unusable_table_is_rejected_and_no_file_remains(
    golden: Path, tmp_path: Path, text: str, message: str, capsys: Captured
) -> None:
    (tmp_path / "in.csv").write_text(text)
    out = tmp_path / "out.csv"
    code = cli.run(
        ["apply", str(golden), str(tmp_path / "in.csv"), "--columns", "gx,gy,gz", "-o", str(out)]
    )
    assert code == 3
    assert message in capsys.readouterr().err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["in.csv", "v0001.yaml"]


@pytest.mark.parametrize("name", ["none.csv", "."])
def test_a_table_that_cannot_be_read_is_refused(
    golden: Path, tmp_path: Path, name: str, capsys: Captured
) -> None:
    command = ["apply", str(golden), str(tmp_path / name), "-o", str(tmp_path / "out.csv")]
    assert cli.run([*command, "--columns", "gx,gy,gz"]) == 3
    assert "cannot be read" in capsys.readouterr().err


def test_the_mark_of_a_spreadsheet_is_no_part_of_a_name(golden: Path, tmp_path: Path) -> None:
    """Excel writes a byte order mark; a quoted cell may contain the delimiter."""
    (tmp_path / "in.csv").write_bytes(b'\xef\xbb\xbfgx,gy,gz,note\r\n1,2,3,"a, b"\r\n')
    summary = apply_to_table(
        Calibration.load(golden), tmp_path / "in.csv", tmp_path / "out.csv", TableColumns(GYRO)
    )
    assert summary.rows == 1
    assert (tmp_path / "out.csv").read_text().startswith("gx,gy,gz,note,rate_x_rad_s")


def test_options_of_tables_without_an_effect_are_refused(
    golden: Path, tmp_path: Path, capsys: Captured
) -> None:
    table(tmp_path / "in.csv")
    out = ["-o", str(tmp_path / "out.csv")]
    base = ["apply", str(golden), str(tmp_path / "in.csv"), "--columns", "gx,gy,gz", *out]
    assert cli.run([*base, "--time-unit", "ms"]) == 2
    assert "--time-unit needs the option --time" in capsys.readouterr().err
    assert cli.run([*base, "--bias-only", "--frame", "stage"]) == 2
    assert "so --frame has no effect" in capsys.readouterr().err
    assert cli.run(["apply", str(golden), "drive.mcap", "--unit", "rad/s", *out]) == 2
    assert "are only for tables" in capsys.readouterr().err


def test_the_command_prints_text_and_json(golden: Path, tmp_path: Path, capsys: Captured) -> None:
    table(tmp_path / "in.csv")
    base = ["apply", str(golden), str(tmp_path / "in.csv"), "--columns", "gx,gy,gz"]
    assert cli.run([*base, "-o", str(tmp_path / "a.csv")]) == 0
    assert "30 rows" in capsys.readouterr().out
    assert cli.run([*base, "-o", str(tmp_path / "b.csv"), "--json", "--frame", "sensor"]) == 0
    output = json.loads(capsys.readouterr().out)
    assert (output["rows"], output["frame"], output["board"]) == (30, "sensor", "GY80-0007")
    assert cli.run([*base, "-o", str(tmp_path / "b.csv")]) == 2
    assert "b.csv already exists" in capsys.readouterr().err
    assert cli.run([*base[:3], "-o", str(tmp_path / "c.csv")]) == 2
    assert "--columns X,Y,Z" in capsys.readouterr().err


def test_a_folder_that_cannot_be_written(golden: Path, tmp_path: Path, capsys: Captured) -> None:
    table(tmp_path / "in.csv")
    out = tmp_path / "none" / "out.csv"
    base = ["apply", str(golden), str(tmp_path / "in.csv"), "--columns", "gx,gy,gz"]
    assert cli.run([*base, "-o", str(out)]) == 1
    error = capsys.readouterr().err
    assert "cannot be written" in error
    assert "in a folder that exists" in error
    assert "disk space" not in error


def test_temperatures_outside_those_of_a_constant_bias_are_remarked(
    tmp_path: Path, document: Callable[..., Document], capsys: Captured
) -> None:
    (tmp_path / "in.csv").write_text("gx,gy,gz,T\n0,0,0,25\n0,0,0,60\n0,0,0,\n")
    made = document(validity={"rate_rad_s": [-4.0, 4.0], "temperature_degc": [24.0, 26.0]})
    (tmp_path / "constant.yaml").write_text(calibration_as_yaml(made))
    base = ["apply", str(tmp_path / "constant.yaml"), str(tmp_path / "in.csv")]
    base += ["--columns", "gx,gy,gz", "--temperature", "T", "-o"]
    assert cli.run([*base, str(tmp_path / "a.csv")]) == 0
    assert "1 of 3 rows were taken outside 24.0 to 26.0 degC" in capsys.readouterr().out
    assert cli.run([*base, str(tmp_path / "b.csv"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["outside_warmth"] == 1


def test_a_needed_temperature_column_is_required_and_used(
    tmp_path: Path, document: Callable[..., Document], capsys: Captured
) -> None:
    (tmp_path / "in.csv").write_text("gx,gy,gz,T\n0,0,0,25\n0,0,0,35\n")
    slope = {"value": [1e-3, 0.0, 0.0], "std": [0.0] * 3, "unit": "rad/s/K"}
    reference = {"value": [25.0], "std": [0.0], "unit": "degC"}
    made = document(
        parameters={"thermal_bias.slope": slope, "thermal_bias.reference": reference},
        validity={"rate_rad_s": [-4.0, 4.0], "temperature_degc": [20.0, 40.0]},
    )
    warm = tmp_path / "warm.yaml"
    warm.write_text(calibration_as_yaml(made))
    base = ["apply", str(warm), str(tmp_path / "in.csv"), "--columns", "gx,gy,gz"]
    assert cli.run([*base, "-o", str(tmp_path / "a.csv")]) == 2
    assert "--temperature" in capsys.readouterr().err
    assert cli.run([*base, "--temperature", "T", "-o", str(tmp_path / "a.csv")]) == 0
    rows = (tmp_path / "a.csv").read_text().splitlines()[1:]
    first, second = (np.array(r.split(",")[-3:], dtype=float) for r in rows)
    inverse = Calibration(made).correction.inverse
    np.testing.assert_allclose(first - second, inverse @ [0.01, 0.0, 0.0], atol=1e-8)
    capsys.readouterr()
    (tmp_path / "in.csv").write_text("gx,gy,gz,T\n0,0,0,25\n0,0,0,45\n")
    assert cli.run([*base, "--temperature", "T", "-o", str(tmp_path / "b.csv")]) == 0
    assert "1 rows get no rate" in capsys.readouterr().out
    assert (tmp_path / "b.csv").read_text().splitlines()[2] == "0,0,0,45,,,"
    (tmp_path / "in.csv").write_text("gx,gy,gz,T\n0,0,0,45\n")
    assert cli.run([*base, "--temperature", "T", "-o", str(tmp_path / "c.csv")]) == 3
    assert "outside 20.0 to 40.0 degC" in capsys.readouterr().err
    assert not (tmp_path / "c.csv").exists()


def test_a_dash_is_standard_output(
    golden: Path, tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before, `gyrorig apply` wrote a table to a file with the name `-`."""
    monkeypatch.chdir(tmp_path)
    table(tmp_path / "in.csv")
    base = ["apply", str(golden), "in.csv", "--columns", "gx,gy,gz", "-o"]
    assert cli.run([*base, "file.csv"]) == 0
    capsys.readouterr()
    before = set(tmp_path.iterdir())
    assert cli.run([*base, "-"]) == 0
    output = capsys.readouterr()
    assert output.out == (tmp_path / "file.csv").read_text()
    assert "30 rows" in output.err
    assert cli.run([*base, "-", "--json"]) == 2
    assert cli.run(["apply", str(golden), "drive.mcap", "-o", "-"]) == 2
    assert "a recording cannot be written to standard output" in capsys.readouterr().err
    assert set(tmp_path.iterdir()) == before
