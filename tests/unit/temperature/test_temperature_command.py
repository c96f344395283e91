"""`gyrorig temperature`: curves from tables and calibrations, applied, and exported as C."""

import json
import math
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import yaml

from gyrorig_solver import Calibration, cli
from gyrorig_solver.calibration import CalibrationDocument, parse_calibration
from gyrorig_solver.calibration.calibration_document import (
    BudgetRow,
    Parameter,
    ParameterUncertainty,
    Trust,
    UncertaintyRecord,
    calibration_as_yaml,
)
from gyrorig_solver.calibration.total_uncertainty import judge_total
from gyrorig_solver.estimate import fit_temperature
from gyrorig_solver.estimate.temperature import BiasTable
from gyrorig_solver.export import ExportSource, export_text
from gyrorig_solver.pipeline.temperature_values import (
    TemperatureValues,
    with_temperature_curves,
)

GOLDEN = Path(__file__).parents[1] / "output" / "golden" / "good.yaml"
Captured = pytest.CaptureFixture[str]
HEADER = "temperature_degc,bias_x,bias_y,bias_z,scale_x,scale_y,scale_z\n"


def true_bias_dps(degc: Any) -> Any:
    x = (np.asarray(degc) - 25.0) / 25.0
    return np.stack([0.4 * x + 0.1 * x**2, -0.2 * x, 0.3 - 0.05 * x**3], axis=-1)


def true_scale(degc: Any) -> Any:
    x = (np.asarray(degc) - 25.0)[..., None] / 25.0
    return np.array([1.02, 0.98, 1.0]) * (1.0 + 0.004 * x)


@pytest.fixture
def table(tmp_path: Path) -> Path:
    rng = np.random.default_rng(3)
    degc = np.linspace(0.0, 50.0, 21)
    bias = true_bias_dps(degc) + rng.normal(0.0, 0.004, (21, 3))
    scale = true_scale(degc) + rng.normal(0.0, 1e-4, (21, 3))
    path = tmp_path / "chamber.csv"
    rows = np.column_stack([degc, bias, scale])
    np.savetxt(path, rows, fmt="%.6f", delimiter=",", header=HEADER.strip(), comments="")
    return path


def solved(
    arguments: list[str], out: Path, capsys: Captured
) -> tuple[CalibrationDocument, dict[str, Any]]:
    capsys.readouterr()
    assert cli.run(["temperature", *arguments, "--out", str(out), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    return parse_calibration(Path(result["file"]).read_bytes(), "result"), result


def test_a_table_gives_curves_of_bias_and_scale(
    table: Path, tmp_path: Path, capsys: Captured
) -> None:
    document, result = solved([str(table), "--calibration", str(GOLDEN)], tmp_path / "cal", capsys)
    record = document.temperature
    assert record is not None
    assert record.scale is not None
    assert record.range_degc == [0.0, 50.0]
    calibration = Calibration(document)
    degc = np.array([3.0, 25.0, 47.0])
    rate = np.array([[0.5, -0.4, 0.3]] * 3)
    lower, rotation = (
        np.array(m, dtype=np.float64) for m in (document.matrices.T, document.matrices.M)
    )
    read = true_scale(degc) * (rate @ (lower @ rotation).T) + np.radians(true_bias_dps(degc))
    output = calibration.rates(read, "rad/s", temperature_degc=degc)
    np.testing.assert_allclose(output, rate, atol=5e-4)
    assert "scale factor follows the temperature" in Path(result["report"]).read_text("utf-8")
    command = ["temperature", str(table), "--board", "GY80-0007", "--out", str(tmp_path / "cal")]
    assert cli.run(command) == 0  # the next version
    assert (tmp_path / "cal" / "GY80-0007" / "v0002.yaml").exists()


def test_other_columns_of_a_table_may_contain_words(
    table: Path, tmp_path: Path, capsys: Captured
) -> None:
    header, *rows = table.read_text().splitlines()
    lines = [f"{header},bias_note", *(f"{row},as measured" for row in rows)]
    (tmp_path / "noted.csv").write_text("\n".join(lines))
    document, _ = solved([str(tmp_path / "noted.csv"), "--board", "B"], tmp_path / "a", capsys)
    plain, _ = solved([str(table), "--board", "B"], tmp_path / "b", capsys)
    assert document.temperature is not None
    assert plain.temperature is not None
    assert document.temperature.bias == plain.temperature.bias


def test_calibrations_at_several_temperatures(tmp_path: Path, capsys: Captured) -> None:
    paths = []
    for k, degc in enumerate([0.0, 10.0, 20.0, 30.0, 40.0, 50.0]):
        plain = yaml.safe_load(GOLDEN.read_text())
        plain["parameters"]["bias"]["value"] = np.radians(true_bias_dps(degc)).tolist()
        plain["parameters"]["scale"]["value"] = true_scale(degc).ravel().tolist()
        plain["quality"]["mean_temperature_degc"] = degc
        path = tmp_path / f"v{k}.yaml"
        bias_rad_s = plain["parameters"]["bias"]["value"][0]
        total = ParameterUncertainty(
            1e-5, 5e-5, 5.1e-5, [bias_rad_s - 1e-4, bias_rad_s + 1e-4], 1e-3, "rad/s"
        )
        document = msgspec.structs.replace(
            parse_calibration(yaml.safe_dump(plain), "input"),
            uncertainty=UncertaintyRecord(2.0, {"bias.x": total}, [], "0" * 64, 0.954),
        )
        path.write_text(calibration_as_yaml(document))
        paths.append(str(path))
    document, _ = solved(paths, tmp_path / "cal", capsys)
    # The inputs do not state the total uncertainty of y and z.
    assert document.uncertainty is None
    record = document.temperature
    assert record is not None
    assert record.scale is not None
    slope = np.array(record.scale.coefficients)[0]
    np.testing.assert_allclose(slope, 0.004 / 25.0, rtol=0.05)
    assert document.board.id == "GY80-0007"


TYPE_B_RAD_S = 1.7e-3  # common to all temperatures
CAUSE = BudgetRow("bias.x", "g_sensitivity", "xz", TYPE_B_RAD_S, 0.9, "poses in all orientations")


def write_calibrations(folder: Path, **changes: str) -> list[str]:
    """Write calibrations at six temperatures; `changes`: of the board in the third one."""
    good = parse_calibration(GOLDEN.read_bytes(), "good")
    paths = []
    for k, degc in enumerate([0.0, 10.0, 20.0, 30.0, 40.0, 50.0]):
        bias: list[float | None] = np.radians(true_bias_dps(degc)).tolist()
        std: list[float | None] = [3e-5] * 3
        entries = {
            f"bias.{axis}": ParameterUncertainty(
                3e-5, TYPE_B_RAD_S, TYPE_B_RAD_S, [0.0, 0.0], 1.6e-3, "rad/s"
            )
            for axis in "xyz"
        }
        entries["scale.x"] = ParameterUncertainty(1e-4, 2e-4, 3e-4, [0.0, 0.0], 2e-3, "1")
        record = UncertaintyRecord(2.0, entries, [CAUSE], "0" * 64, 0.954)
        board = msgspec.structs.replace(good.board, **changes) if k == 2 else good.board
        recording = msgspec.structs.replace(good.inputs[0], sha256=f"{k}" * 64)
        document = msgspec.structs.replace(
            good,
            board=board,
            inputs=[recording],
            parameters=good.parameters | {"bias": Parameter(bias, std, "rad/s")},
            quality=msgspec.structs.replace(good.quality, mean_temperature_degc=degc),
            uncertainty=record,
            trust=judge_total(Trust("good", []), record),
        )
        path = folder / f"v{k}.yaml"
        path.write_text(calibration_as_yaml(document))
        paths.append(str(path))
    return paths


def test_a_curve_has_the_type_b_uncertainty_of_its_calibrations(
    tmp_path: Path, capsys: Captured, contract_judge: Path
) -> None:
    """Before, the result had the noise only, and the verdict of the last input."""
    document, result = solved(write_calibrations(tmp_path), tmp_path / "cal", capsys)
    record = document.uncertainty
    assert record is not None
    entry = record.parameters["bias.x"]
    assert entry.type_b == TYPE_B_RAD_S  # not averaged
    assert entry.total == pytest.approx(math.hypot(entry.type_a, TYPE_B_RAD_S))
    std, value = document.parameters["bias"].std, document.parameters["bias"].value
    assert isinstance(std, list)
    assert isinstance(value, list)
    assert entry.type_a == std[0]
    assert sum(entry.interval) / 2.0 == pytest.approx(value[0])
    assert record.parameters["scale.x"].type_b == 2e-4  # of the gain that is kept
    assert [row.cause for row in record.budget] == ["g_sensitivity"]
    assert document.trust.verdict == "limited"
    (reason,) = document.trust.reasons  # that of the last input is not repeated
    assert "the total standard uncertainty of bias." in reason
    assert [row.sha256[0] for row in document.inputs] == list("012345")
    subprocess.run([sys.executable, str(contract_judge), result["file"]], check=True)


@pytest.mark.parametrize("key", ["uid", "sensor"])
def test_calibrations_of_a_replaced_board_are_refused(
    key: str, tmp_path: Path, capsys: Captured
) -> None:
    command = ["temperature", *write_calibrations(tmp_path, **{key: "another"})]
    assert cli.run([*command, "--out", str(tmp_path / "cal")]) == 2
    assert f"the {key} of board GY80-0007 is" in capsys.readouterr().err
    paths = write_calibrations(tmp_path, **{key: "unknown"})
    assert cli.run(["temperature", *paths, "--out", str(tmp_path / "cal")]) == 0


def test_calibrations_with_two_settings_are_refused(tmp_path: Path, capsys: Captured) -> None:
    paths = write_calibrations(tmp_path)
    document = parse_calibration(Path(paths[2]).read_bytes(), "v2")
    config = msgspec.structs.replace(document.board.config, gyro_full_scale_dps=125.0)
    board = msgspec.structs.replace(document.board, config=config)
    text = calibration_as_yaml(msgspec.structs.replace(document, board=board))
    Path(paths[2]).write_text(text)
    assert cli.run(["temperature", *paths, "--out", str(tmp_path / "cal")]) == 2
    assert "the gyro_full_scale_dps of board GY80-0007 is" in capsys.readouterr().err


@pytest.mark.parametrize("changes", [{"id": "B"}, {"uid": "another"}])
def test_the_calibration_of_another_board_is_refused(
    changes: dict[str, str], table: Path, tmp_path: Path, capsys: Captured
) -> None:
    good = parse_calibration(GOLDEN.read_bytes(), "good")
    other = tmp_path / "other.yaml"
    board = msgspec.structs.replace(good.board, **changes)
    other.write_text(calibration_as_yaml(msgspec.structs.replace(good, board=board)))
    command = ["temperature", "--calibration", str(other), "--out", str(tmp_path / "cal")]
    assert cli.run([*command, *write_calibrations(tmp_path)]) == 2
    assert "GY80-0007" in capsys.readouterr().err
    status = cli.run([*command, str(table), "--board", "GY80-0007"])
    assert status == (2 if "id" in changes else 0)
    assert not (tmp_path / "cal" / "B").exists()


def test_scale_factors_of_a_table_count_as_determined(
    table: Path, tmp_path: Path, capsys: Captured
) -> None:
    document, _ = solved([str(table), "--board", "B"], tmp_path / "cal", capsys)
    assert document.observability.rank == 6
    names = {name for name in document.covariance.order if name.startswith("scale.")}
    assert names == {"scale.x", "scale.y", "scale.z"}
    assert not names & set(document.observability.unobservable)


@pytest.mark.parametrize("key", ["covariance", "coefficients"])
def test_a_curve_whose_lists_have_another_size_is_refused(
    key: str, table: Path, tmp_path: Path, capsys: Captured
) -> None:
    _, result = solved([str(table), "--board", "B"], tmp_path / "cal", capsys)
    plain = yaml.safe_load(Path(result["file"]).read_text())
    del plain["temperature"]["bias"][key][0]
    (tmp_path / "bad.yaml").write_text(yaml.safe_dump(plain, sort_keys=False))
    assert cli.run(["report", str(tmp_path / "bad.yaml")]) == 3
    assert "a curve of bias whose lists" in capsys.readouterr().err


@pytest.mark.parametrize("axis", range(3))
def test_one_axis_that_depends_on_the_temperature_is_enough(
    axis: int, tmp_path: Path, capsys: Captured
) -> None:
    """Five rows and 100 standard uncertainties: the other two axes hid the third one."""
    rng = np.random.default_rng(4)
    degc = np.linspace(0.0, 40.0, 5)
    bias = 0.1 + rng.normal(0.0, 0.004, (5, 3))
    bias[:, axis] += 100 * 0.004 * (degc - 20.0) / 20.0
    path = tmp_path / "chamber.csv"
    names = "temperature_degc,bias_x,bias_y,bias_z"
    rows = np.column_stack([degc, bias])
    np.savetxt(path, rows, fmt="%.6f", delimiter=",", header=names, comments="")
    document, _ = solved([str(path), "--board", "B"], tmp_path / "cal", capsys)
    assert document.temperature is not None
    assert document.temperature.bias is not None
    slope = np.degrees(np.array(document.temperature.bias.coefficients)[0])
    np.testing.assert_allclose(slope, np.eye(3)[axis] * 0.02, atol=2e-3)


def test_a_constant_bias_shows_no_dependence() -> None:
    rng = np.random.default_rng(5)
    for count in (4, 5, 8):
        for _ in range(20):
            table = BiasTable(
                np.linspace(0.0, 40.0, count), rng.normal(0.0, 1e-4, (count, 3)),
                np.zeros((count, 3)),
            )  # fmt: skip
            fit = fit_temperature([], table=table)
            assert fit is not None
            assert not fit.is_significant


def test_wrong_tables_are_one_line(table: Path, tmp_path: Path, capsys: Captured) -> None:
    few, word, names, flat, damaged = (
        tmp_path / name for name in ("few", "word", "names", "flat", "damaged")
    )
    damaged.write_bytes(HEADER.encode() + b"1,1,1,1,1,1\x00,1\n" * 5)
    few.write_text(HEADER + "1,1,1,1,1,1,1\n")
    word.write_text(HEADER + "1,1,x,1,1,1,1\n")
    names.write_text("T,x,y,z\n1,2,3,4\n")
    flat.write_text(
        HEADER + "".join(f"{t},{0.1 * (-1) ** t},0,0.1,1,1,1\n" for t in range(0, 40, 3))
    )
    for path, status, words in (
        (few, 2, "too few"),
        (word, 3, "'x' in the column bias_y"),
        (names, 3, "has no column 'temperature_degc'"),
        (flat, 3, "does not depend significantly"),
        (tmp_path / "absent", 3, "cannot be read"),
        (damaged, 3, "damaged"),
    ):
        assert cli.run(["temperature", str(path), "--board", "B"]) == status
        error = capsys.readouterr().err
        assert words in error
        assert error.count("\n") == 1
    assert cli.run(["temperature", str(table)]) == 2
    assert "--board" in capsys.readouterr().err


@pytest.mark.skipif(shutil.which("gcc") is None, reason="no C compiler")
def test_the_c_function_evaluates_a_spline_and_reports_the_range(tmp_path: Path) -> None:
    document = parse_calibration(GOLDEN.read_bytes(), "good")
    degc = np.linspace(0.0, 60.0, 31)
    kink = np.maximum(degc - 35.0, 0.0)[:, None] * [2e-3, -1e-3, 5e-4]
    noise = np.random.default_rng(1).normal(0.0, 1e-4, (31, 3))
    values = TemperatureValues(
        "made", degc, kink + noise, np.zeros((31, 3)), 1.0 + 1e-4 * degc[:, None] * np.ones(3),
        np.zeros((31, 3)), None,
    )  # fmt: skip
    document = with_temperature_curves(document, values)
    assert document.temperature is not None
    assert document.temperature.bias is not None
    assert document.temperature.bias.kind == "spline"
    source = ExportSource.of(document)
    (tmp_path / "board.h").write_text(export_text(source, "c"))
    stem = "gy80_0007"
    (tmp_path / "main.c").write_text(f"""
#include <stdio.h>
#include "board.h"
int main(void)
{{
    const int32_t counts[3] = {{1000, -2000, 3000}};
    float rate[3], degc;
    for (degc = -6.0f; degc < 70.0f; degc += 6.0f) {{
        const int outside = {stem}_rate_float_at(counts, degc, rate);
        printf("%.9g %d %.9g %.9g %.9g\\n", (double)degc, outside, (double)rate[0],
               (double)rate[1], (double)rate[2]);
    }}
    return {stem}_self_test();
}}
""")
    program = tmp_path / "main"
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror"]
    subprocess.run(["gcc", *flags, str(tmp_path / "main.c"), "-o", str(program)], check=True)
    text = subprocess.run([str(program)], check=True, capture_output=True, text=True).stdout
    rows = np.array([[float(word) for word in line.split()] for line in text.splitlines()])
    inside = rows[(rows[:, 0] >= 0.0) & (rows[:, 0] <= 60.0)]
    calibration = Calibration(document)
    scale = calibration.nominal_scale_rad_s
    assert scale is not None
    wanted = calibration.rates(
        np.tile([1000, -2000, 3000], (len(inside), 1)), temperature_degc=inside[:, 0]
    )
    np.testing.assert_allclose(inside[:, 2:], wanted, atol=2e-6)
    assert rows[:, 1].tolist() == [float(not 0.0 <= row[0] <= 60.0) for row in rows]


def test_autopilots_get_the_nearest_cubic_with_its_error() -> None:
    document = parse_calibration(GOLDEN.read_bytes(), "good")
    degc = np.linspace(0.0, 60.0, 31)
    kink = np.maximum(degc - 35.0, 0.0)[:, None] * [2e-3, -1e-3, 5e-4]
    noise = np.random.default_rng(1).normal(0.0, 1e-4, (31, 3))
    values = TemperatureValues("made", degc, kink + noise, np.zeros((31, 3)), None, None, None)
    document = with_temperature_curves(document, values)
    curve = ExportSource.of(document).bias_curve
    assert curve is not None
    cubic, error = curve.as_cubic()
    text = export_text(ExportSource.of(document), "px4")
    assert f"differs from the calibration by at most {error.max():.2g} rad/s" in text
    assert np.abs(cubic.change(degc) - curve.change(degc)).max() == pytest.approx(
        error.max(), rel=0.1
    )
    plain = msgspec.structs.replace(document, temperature=None)
    assert ExportSource.of(plain).bias_curve is None


@pytest.mark.parametrize(
    ("column", "value", "message_part"),
    [
        ("temperature_degc", "-400", "has -400 in the column temperature_degc"),
        ("bias_y", "1e9", "has 1e9 in the column bias_y"),
        ("bias_std_x", "-0.1", "has -0.1 in the column bias_std_x"),
        ("scale_z", "0", "has 0 in the column scale_z"),
        ("scale_x", "", "has nothing in the column scale_x"),
    ],
)
def test_values_that_are_not_possible_are_refused(
    column: str, value: str, message_part: str, tmp_path: Path, capsys: Captured
) -> None:
    names = [*HEADER.strip().split(","), "bias_std_x"]
    rows = [dict.fromkeys(names, "1") | {"temperature_degc": str(5 * k)} for k in range(8)]
    rows[2][column] = value
    path = tmp_path / "chamber.csv"
    path.write_text("\n".join([",".join(names), *(",".join(row.values()) for row in rows)]))
    assert cli.run(["temperature", str(path), "--board", "B", "--out", str(tmp_path)]) == 3
    text = capsys.readouterr().err
    assert f"row 3 of the table chamber.csv {message_part}" in text
    assert text.count("\n") == 1


@pytest.mark.parametrize(
    ("header", "row", "message_part"),
    [
        ("", "{t},5,0.11,-0.42,0.21", "row 1 of the table chamber.csv has 5 columns, but the"),
        ("", "{t},0.11,-0.42", "row 1 of the table chamber.csv has 3 columns, but the"),
        (",bias_x", "{t},0.1,0.2,0.3,{t}", "chamber.csv has 2 columns with the name 'bias_x'"),
    ],
)
def test_shifted_and_repeated_columns_are_refused(
    header: str, row: str, message_part: str, tmp_path: Path, capsys: Captured
) -> None:
    rows = [row.format(t=10 * k) for k in range(6)]
    path = tmp_path / "chamber.csv"
    path.write_text("\n".join(["temperature_degc,bias_x,bias_y,bias_z" + header, *rows]))
    assert cli.run(["temperature", str(path), "--board", "B", "--out", str(tmp_path)]) == 3
    assert message_part in capsys.readouterr().err


@pytest.mark.parametrize("constant", ["0.20", "0.200000", "0"])
def test_an_axis_that_is_constant_at_the_resolution_hides_no_curve(
    constant: str, tmp_path: Path, capsys: Captured
) -> None:
    rng = np.random.default_rng(2)
    rows = [
        f"{t},{0.11 + 0.01 * t + rng.normal(0, 0.01):.2f},"
        f"{0.4 - 0.006 * t + rng.normal(0, 0.01):.2f},{constant}"
        for t in range(-10, 61, 10)
    ]
    path = tmp_path / "chamber.csv"
    path.write_text("\n".join(["temperature_degc,bias_x,bias_y,bias_z", *rows]))
    document, _ = solved([str(path), "--board", "B"], tmp_path / "cal", capsys)
    assert document.temperature is not None
    assert document.temperature.bias is not None
    slope, std = document.temperature.bias.coefficients[0], document.parameters["bias"].std
    np.testing.assert_allclose(np.degrees(slope), [0.01, -0.006, 0.0], atol=4e-4)
    assert isinstance(std, list)
    assert std[2] is not None
    assert std[2] > 0.0


@pytest.mark.parametrize(("name", "words"), [("bias", "the bias"), ("scale", "the scale factor")])
def test_values_with_and_without_an_uncertainty_are_refused(
    name: str, words: str, table: Path, tmp_path: Path, capsys: Captured
) -> None:
    header, *rows = table.read_text().splitlines()
    columns = ",".join(f"{name}_std_{axis}" for axis in "xyz")
    stated = tmp_path / "stated.csv"
    stated.write_text("\n".join([f"{header},{columns}", *(f"{r},1e-3,1e-3,1e-3" for r in rows)]))
    command = ["temperature", "--board", "B", "--out", str(tmp_path)]
    assert cli.run([*command, str(table), str(stated)]) == 2
    assert f"some values of {words} have a standard uncertainty" in capsys.readouterr().err
    assert cli.run([*command, str(stated)]) == 0


def test_a_file_that_is_given_twice_is_refused(
    table: Path, tmp_path: Path, capsys: Captured
) -> None:
    command = ["temperature", str(table), str(table), "--board", "B", "--out", str(tmp_path)]
    assert cli.run(command) == 2
    assert "chamber.csv is given twice" in capsys.readouterr().err
