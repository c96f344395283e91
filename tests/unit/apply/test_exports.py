"""Every export, applied by a reader that shares nothing with its writer."""

import json
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import yaml
from pymavlink.mavparm import MAVParmDict  # type: ignore[import-untyped]

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_solver import cli
from gyrorig_solver.calibration import CalibrationDocument
from gyrorig_solver.calibration.temperature_record import (
    CurveRecord,
    HysteresisRecord,
    TemperatureRecord,
)
from gyrorig_solver.export import FORMATS, ExportOptions, ExportSource, export_text
from gyrorig_solver.export.c_header import FixedPoint, c_header, largest_count
from gyrorig_solver.export.flight_controllers import shift_polynomial

Captured = pytest.CaptureFixture[str]
DocumentFactory = Callable[..., CalibrationDocument]
SCALE = 0.00015271630954950384  # the golden calibration's
BIAS = [0.0078125, -0.015625, 0.03125]
WARM: dict[str, Any] = {
    "thermal_bias.slope": {"value": [1e-3, -2e-3, 5e-4], "std": [0.0] * 3, "unit": "rad/s/K"},
    "thermal_bias.square": {"value": [1e-5, 2e-5, -1e-5], "std": [0.0] * 3, "unit": "rad/s/K^2"},
    "thermal_bias.reference": {"value": [30.0], "std": [0.0], "unit": "degC"},
}
FLAGS = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror"]


def gain_of(result: CalibrationDocument) -> np.ndarray:
    return np.array(result.matrices.STM, dtype=np.float64)


def true_rates(result: CalibrationDocument, reading_rad_s: np.ndarray) -> np.ndarray:
    return np.linalg.solve(gain_of(result), (reading_rad_s - BIAS).T).T


MAIN = """
#include <stdio.h>
#include "board.h"

int main(void)
{
    int32_t counts[3], step[3];
    float rate[3];
    long a, b, c;

    printf("%d\\n", NAME_self_test());
    while (scanf("%ld %ld %ld", &a, &b, &c) == 3) {
        counts[0] = (int32_t)a; counts[1] = (int32_t)b; counts[2] = (int32_t)c;
        NAME_rate_float(counts, rate);
        NAME_rate_fixed(counts, step);
        printf("%.9g %.9g %.9g %ld %ld %ld\\n", (double)rate[0], (double)rate[1], (double)rate[2],
               (long)step[0], (long)step[1], (long)step[2]);
    }
    return 0;
}
"""


def compiled(folder: Path, header: str, main: str, *compiler: str) -> Path:
    if shutil.which(compiler[0]) is None:
        pytest.skip(f"no {compiler[0]} here: install gcc (apt install build-essential)")
    (folder / "board.h").write_text(header)
    (folder / "main.c").write_text(main)
    program = folder / "program"
    subprocess.run([*compiler, str(folder / "main.c"), "-o", str(program)], check=True)
    return program


def run(program: Path, rows: np.ndarray | None = None) -> list[list[float]]:
    text = "" if rows is None else "\n".join(" ".join(map(str, row)) for row in rows.tolist())
    process = subprocess.run([program], input=text, capture_output=True, text=True, check=True)
    return [[float(word) for word in line.split()] for line in process.stdout.splitlines()]


@pytest.mark.parametrize(
    "compiler", [["gcc", *FLAGS], ["g++", "-x", "c++", "-std=c++11", "-Wall", "-Wextra", "-Werror"]]
)
def test_compiled_c_gives_the_true_rates(
    document: DocumentFactory, tmp_path: Path, compiler: list[str]
) -> None:
    result = document()
    header = c_header(ExportSource.of(result), "NAME")
    program = compiled(tmp_path, header, MAIN, *compiler)
    rng = np.random.default_rng(8)
    counts = rng.integers(-32768, 32768, size=(500, 3))
    corners = np.array(np.meshgrid(*[[-32768, 32767]] * 3)).reshape(3, -1).T
    counts = np.concatenate([counts, corners])
    first, *rows = run(program, counts)
    assert first == [0.0]
    output = np.array(rows)
    wanted = true_rates(result, counts * SCALE)
    np.testing.assert_allclose(output[:, :3], wanted, rtol=0.0, atol=3e-6)  # float: 6 to 7 digits
    (point,) = re.findall(r"#define NAME_FIXED_POINT (\d+)", header)
    (bound,) = re.findall(r"rounding error is at most ([0-9.e-]+) rad/s", header)
    error = np.abs(output[:, 3:] * 2.0 ** -int(point) - wanted).max()
    assert error <= float(bound) * 1.05  # two digits of it are printed
    assert error < 1e-7


def test_c_with_a_temperature(document: DocumentFactory, tmp_path: Path) -> None:
    result = document(
        parameters=WARM, validity={"rate_rad_s": [-4.0, 4.0], "temperature_degc": [0.0, 70.0]}
    )
    main = """
#include <stdio.h>
#include "board.h"

int main(void)
{
    const int32_t counts[3] = {1000, -2000, 3000};
    float rate[3], degc;

    for (degc = 0.0f; degc < 60.0f; degc += 7.0f) {
        NAME_rate_float_at(counts, degc, rate);
        printf("%.9g %.9g %.9g %.9g\\n", (double)degc, (double)rate[0], (double)rate[1],
               (double)rate[2]);
    }
    return NAME_self_test();
}
"""
    rows = np.array(
        run(compiled(tmp_path, c_header(ExportSource.of(result), "NAME"), main, "gcc", *FLAGS))
    )
    warmth = (rows[:, 0] - 30.0)[:, None]
    read = np.array([1000, -2000, 3000]) * SCALE
    drift = warmth * [1e-3, -2e-3, 5e-4] + warmth**2 * [1e-5, 2e-5, -1e-5]
    np.testing.assert_allclose(rows[:, 1:], true_rates(result, read - drift), atol=1e-6)


def two_references(document: DocumentFactory) -> CalibrationDocument:
    """Return a calibration with a bias curve from 40 degC and a scale curve from 25 degC."""
    scale: dict[str, Any] = {
        "thermal_scale": {"value": [1e-3, -5e-4, 2e-3], "std": [0.0] * 3, "unit": "1/K"},
        "thermal_scale.reference": {"value": [25.0], "std": [0.0], "unit": "degC"},
    }
    covariance = [[[1e-12, 0.0], [0.0, 1e-12]]] * 3
    record = TemperatureRecord(
        source="chamber",
        reference_degc=40.0,
        range_degc=[0.0, 80.0],
        bias=CurveRecord("polynomial", "rad/s", [[1e-4, 2e-4, -1e-4]], covariance),
    )
    validity = {"rate_rad_s": [-4.0, 4.0], "temperature_degc": [0.0, 80.0]}
    return msgspec.structs.replace(
        document(parameters=scale, validity=validity), temperature=record
    )


AT_TEMPERATURES = """
#include <stdio.h>
#include "board.h"

int main(void)
{
    const int32_t counts[3] = {10000, -8000, 12000};
    float rate[3], degc;

    printf("%d 0 0 0\\n", NAME_self_test());
    NAME_rate_float(counts, rate);
    printf("40 %.9g %.9g %.9g\\n", (double)rate[0], (double)rate[1], (double)rate[2]);
    for (degc = 25.0f; degc < 80.0f; degc += 15.0f) {
        NAME_rate_float_at(counts, degc, rate);
        printf("%.9g %.9g %.9g %.9g\\n", (double)degc, (double)rate[0], (double)rate[1],
               (double)rate[2]);
    }
    return 0;
}
"""


def test_c_takes_the_reference_temperature_of_each_curve(
    document: DocumentFactory, tmp_path: Path
) -> None:
    source = ExportSource.of(two_references(document))
    header = c_header(source, "NAME")
    first, *rows = run(compiled(tmp_path, header, AT_TEMPERATURES, "gcc", *FLAGS))
    assert first[0] == 0.0
    assert source.calibration is not None
    output = np.array(rows)
    counts = np.tile([10000, -8000, 12000], (len(rows), 1))
    wanted = source.calibration.rates(counts, temperature_degc=output[:, 0])
    np.testing.assert_allclose(output[:, 1:], wanted, atol=2e-6)


def test_the_self_test_finds_a_wrong_reference_temperature(
    document: DocumentFactory, tmp_path: Path
) -> None:
    header = c_header(ExportSource.of(two_references(document)), "NAME")
    wrong = header.replace("warmth = degc - 25.0f", "warmth = degc - 40.0f")
    assert wrong != header
    rows = run(compiled(tmp_path, wrong, AT_TEMPERATURES, "gcc", *FLAGS))
    assert rows[0][0] > 0


def test_the_self_test_finds_a_wrong_number(document: DocumentFactory, tmp_path: Path) -> None:
    header = c_header(ExportSource.of(document()), "NAME")
    first = re.search(r"static const int32_t A\[3\]\[3\] = \{\s*\{(\d+)", header)
    assert first is not None
    wrong = header.replace(first[1], str(int(first[1]) + 4096), 1)
    rows = run(compiled(tmp_path, wrong, MAIN, "gcc", *FLAGS))
    assert rows[0][0] > 0


@pytest.mark.parametrize("scale", [1e-7, 1.5e-4, 1.06e-3, 1.0])
def test_fixed_point_never_overflows_and_keeps_its_bound(scale: float) -> None:
    rng = np.random.default_rng(3)
    limit = largest_count(scale, 2000.0)
    matrix = scale * (np.eye(3) + 0.05 * rng.normal(size=(3, 3)))
    offset = 0.3 * rng.normal(size=3)
    fixed = FixedPoint.of(matrix, offset, limit)
    assert np.abs(fixed.matrix).max() < 2**31
    for row in np.array(np.meshgrid(*[[-limit, limit]] * 3)).reshape(3, -1).T.tolist():
        steps = fixed.rates(row)
        assert max(abs(s) for s in steps) < 2**31
        sums = np.abs(fixed.matrix.astype(object)) @ np.abs(np.array(row, dtype=object))
        assert max(int(s) + abs(o) for s, o in zip(sums, fixed.offset, strict=True)) < 2**62
        wanted = matrix @ np.array(row, dtype=np.float64) + offset
        off = np.abs(np.array(steps) * 2.0**-fixed.fraction_bits - wanted).max()
        assert off <= fixed.error_bound_rad_s(limit) * (1.0 + 1e-6) + 1e-9 * np.abs(wanted).max()


def test_hostile_names_stay_inside_their_comments(
    document: DocumentFactory, tmp_path: Path
) -> None:
    result = document(
        board="a_b", trust={"verdict": "limited", "reasons": ['*/ #error "x" \\', "é\n"]}
    )
    for kind in ("c", "ros", "kalibr", "px4", "ardupilot"):
        text = export_text(ExportSource.of(result), kind)
        assert "\nerror" not in text.replace("#", "")
        assert "*/ #error" not in text
    program = compiled(tmp_path, c_header(ExportSource.of(result), "NAME"), MAIN, "gcc", *FLAGS)
    assert run(program)[0] == [0.0]


def rcl(text: str) -> dict[str, Any]:
    """Read a parameter file as rcl_yaml_param_parser does: one type in a list, no null."""
    (tree,) = yaml.safe_load(text).values()
    assert list(tree) == ["ros__parameters"]
    flat: dict[str, Any] = {}

    def take(prefix: str, node: dict[str, Any]) -> None:
        for name, value in node.items():
            if isinstance(value, dict):
                take(f"{prefix}{name}.", value)
                continue
            values = value if isinstance(value, list) else [value]
            kinds = {type(v) for v in values}
            assert len(kinds) == 1
            assert kinds <= {bool, int, float, str}
            flat[prefix + name] = value

    take("", tree["ros__parameters"])
    return flat


def test_ros_parameters_applied_to_a_drivers_rates(document: DocumentFactory) -> None:
    result = document()
    text = export_text(ExportSource.of(result), "ros")
    output = rcl(text)
    parameters = {n.removeprefix("gyro_calibration."): v for n, v in output.items()}
    correction = np.array(parameters["angular_velocity_correction"]).reshape(3, 3)
    read = np.random.default_rng(1).normal(size=(40, 3))
    rates = (read - parameters["angular_velocity_bias"]) @ correction.T
    np.testing.assert_allclose(rates, true_rates(result, read), atol=1e-12)
    assert parameters["time_offset"] == 0.0125
    assert parameters["noise_density"] == [0.0005, 0.0005, 0.00075]
    assert "bias_random_walk" not in parameters  # one axis of it is not known
    assert list(
        yaml.safe_load(export_text(ExportSource.of(result), "ros", ExportOptions("/imu_node")))
    ) == ["/imu_node"]


def px4(text: str) -> dict[str, float]:
    """Read a file as QGroundControl does: five columns between tabs, MAV_PARAM_TYPE last."""
    result = {}
    for line in text.splitlines():
        if line.startswith("#"):
            continue
        vehicle, component, name, value, kind = line.split("\t")
        assert (vehicle, component) == ("1", "1")
        assert len(name) <= 16
        result[name] = float(value) if kind == "9" else int(value)
        assert kind in ("6", "9")
    return result


def test_px4_subtracts_the_bias_and_its_drift(document: DocumentFactory) -> None:
    plain = px4(export_text(ExportSource.of(document("limited")), "px4", ExportOptions(slot=1)))
    assert plain == dict(
        zip(("CAL_GYRO1_XOFF", "CAL_GYRO1_YOFF", "CAL_GYRO1_ZOFF"), BIAS, strict=True)
    )
    result = px4(
        export_text(
            ExportSource.of(document(parameters=WARM)), "px4", ExportOptions(device_id=2293762)
        )
    )
    assert result["CAL_GYRO0_ID"] == result["TC_G0_ID"] == 2293762
    assert result["TC_G_ENABLE"] == 1
    assert (result["TC_G0_TMIN"], result["TC_G0_TMAX"]) == (24.5, 26.0)
    for axis in range(3):
        for degc in (10.0, 30.0, 45.0):
            # PX4: offset = X0 + X1 dT + X2 dT^2 + X3 dT^3
            warmth = degc - result["TC_G0_TREF"]
            output = sum(result[f"TC_G0_X{p}_{axis}"] * warmth**p for p in range(4))
            slope, square = (WARM[f"thermal_bias.{n}"]["value"][axis] for n in ("slope", "square"))
            assert output == pytest.approx(slope * warmth + square * warmth**2, abs=1e-12)


def test_ardupilot_subtracts_the_bias_and_its_drift(document: DocumentFactory) -> None:
    text = export_text(ExportSource.of(document(parameters=WARM)), "ardupilot")
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    result = {name: float(value) for name, value in (line.split(",") for line in lines)}
    assert result["INS_GYR_CAL"] == 0
    assert [result[f"INS_GYROFFS_{a}"] for a in "XYZ"] == BIAS
    assert all(len(name) <= 16 for name in result)

    def polynomial(axis: str, degc: float) -> float:  # AP_InertialSensor_tempcal.cpp
        step = degc - 35.0
        c = [result[f"INS_TCAL1_GYR{k}_{axis}"] for k in (1, 2, 3)]
        return (c[0] + (c[1] + c[2] * step) * step) * step * 1e-6

    for axis, name in enumerate("XYZ"):
        for degc in (10.0, 24.5, 30.0, 45.0):
            output = polynomial(name, degc) - polynomial(name, result["INS_GYR1_CALTEMP"])
            slope, square = (WARM[f"thermal_bias.{n}"]["value"][axis] for n in ("slope", "square"))
            warmth = degc - 30.0
            assert output == pytest.approx(slope * warmth + square * warmth**2, abs=1e-9)
    second = export_text(ExportSource.of(document()), "ardupilot", ExportOptions(slot=1))
    assert "INS_GYR2OFFS_X,0.0078125" in second


def test_ardupilots_own_library_reads_the_file(
    document: DocumentFactory, tmp_path: Path, capsys: Captured
) -> None:
    path = tmp_path / "gyro.parm"
    path.write_text(export_text(ExportSource.of(document(parameters=WARM)), "ardupilot"))
    result = MAVParmDict()
    assert result.load(str(path))
    assert [result[f"INS_GYROFFS_{a}"] for a in "XYZ"] == BIAS
    assert "Invalid line" not in capsys.readouterr().out  # it goes on behind what it cannot read
    assert len(result) == sum(not line.startswith("#") for line in path.read_text().splitlines())


def test_relative_temperatures_are_not_exported_to_autopilots(document: DocumentFactory) -> None:
    """Where a sensor's temperature counts from anywhere, TMIN and TREF would be wrong."""
    result = document(parameters=WARM, validity={"rate_rad_s": [-1.0, 1.0]})
    for kind in ("px4", "ardupilot"):
        text = export_text(ExportSource.of(result), kind)
        assert "not contained in this format: thermal_bias" in text
        assert "TC" not in text.replace("MTC", "")
    assert "the unknown zero of the recording" in export_text(ExportSource.of(result), "c")


def test_a_polynomial_moved_to_another_reference() -> None:
    rng = np.random.default_rng(2)
    old = rng.normal(size=(3, 3))
    new = shift_polynomial(old, 20.0, 35.0)
    for degc in (-10.0, 20.0, 35.0, 60.0):
        powers = np.arange(1, 4)
        was = ((degc - 20.0) ** powers) @ old - (15.0**powers) @ old
        np.testing.assert_allclose(((degc - 35.0) ** powers) @ new, was, rtol=1e-10, atol=1e-9)


def test_json_has_the_numbers_and_the_document(document: DocumentFactory) -> None:
    result = document()
    output = json.loads(export_text(ExportSource.of(result), "json"))
    read = np.random.default_rng(1).normal(size=(10, 3))
    rates = (read - output["bias_rad_s"]) @ np.array(output["inverse_gain"]).T
    np.testing.assert_allclose(rates, true_rates(result, read), atol=1e-12)
    assert output["calibration"]["schema"] == "gyrorig/calibration/1"
    nothing = json.loads(export_text(ExportSource.of(document("limited")), "json"))
    assert nothing["inverse_gain"] is None


@pytest.mark.parametrize("kind", ["c", "ros"])
def test_an_unobservable_gain_is_not_exported(document: DocumentFactory, kind: str) -> None:
    with pytest.raises(InputError, match=r"has no value for .*scale"):
        export_text(ExportSource.of(document("limited")), kind)


@pytest.mark.parametrize("kind", [k for k in FORMATS if k != "json"])
def test_causes_that_a_format_lacks_are_listed_or_rejected(
    document: DocumentFactory, kind: str
) -> None:
    bent = {"scale_cubic": {"value": [1e-4] * 3, "std": [0.0] * 3, "unit": "s^2/rad^2"}}
    text = export_text(ExportSource.of(document(parameters=bent)), kind)
    assert "not contained in this format: scale_cubic" in text
    if kind == "kalibr":
        return  # it has a place for the next one
    force = {"g_sensitivity": {"value": [1e-4] * 9, "std": [0.0] * 9, "unit": "rad/s/(m/s^2)"}}
    with pytest.raises(InputError, match="the export format can only contain a constant bias"):
        export_text(ExportSource.of(document(parameters=force)), kind)


def warmed(document: DocumentFactory) -> CalibrationDocument:
    """Return the golden calibration with a bias and a scale that depend on the temperature."""
    covariance = [[[1e-12, 0.0], [0.0, 1e-12]]] * 3
    record = TemperatureRecord(
        source="chamber",
        reference_degc=25.0,
        range_degc=[-10.0, 60.0],
        bias=CurveRecord("polynomial", "rad/s", [[1e-3, 2e-3, -1e-3]], covariance),
        scale=CurveRecord("polynomial", "1", [[1e-4] * 3], covariance),
    )
    return msgspec.structs.replace(document(), temperature=record)


@pytest.mark.parametrize("kind", ["ros", "kalibr"])
def test_a_format_with_a_constant_bias_states_that_the_temperature_is_left_out(
    document: DocumentFactory, kind: str
) -> None:
    text = export_text(ExportSource.of(warmed(document)), kind)
    assert "the bias against the temperature (the bias here is that at 25.00 degC)" in text
    assert "the scale factor against the temperature" in text


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize("name", ["good", "limited"])
def test_every_export_states_the_hysteresis_and_the_lag_that_it_does_not_apply(
    document: DocumentFactory, kind: str, name: str
) -> None:
    if (kind, name) in {("c", "limited"), ("ros", "limited"), ("kalibr", "limited")}:
        return  # without a gain, they have no rates
    record = warmed(document).temperature
    assert record is not None
    width = HysteresisRecord([5e-3] * 3, [1e-4] * 3, 1e-9, True)
    lagged = msgspec.structs.replace(record, lag_s=-60.0, hysteresis=width)
    result = msgspec.structs.replace(document(name), temperature=lagged)
    text = export_text(ExportSource.of(result), kind)
    assert "the hysteresis of the bias is not applied" in text
    has_curve = kind not in {"ros", "kalibr"}
    assert ("the lag of the die temperature is not applied" in text) == has_curve


def test_c_states_a_thermal_bias_that_it_does_not_contain(document: DocumentFactory) -> None:
    slope = {"thermal_bias.slope": WARM["thermal_bias.slope"]}
    text = export_text(ExportSource.of(document(parameters=slope)), "c")
    assert "not contained in this format: thermal_bias" in text
    assert "has no reference temperature" in text


def test_json_lists_what_its_formula_leaves_out(document: DocumentFactory) -> None:
    """`rate = inverse_gain (reading - bias)` has a constant bias and gain."""

    def left_out(result: CalibrationDocument) -> str:
        return "; ".join(json.loads(export_text(ExportSource.of(result), "json"))["not_applied"])

    assert left_out(document()) == ""
    for words in ("the change of the bias with the temp", "the change of the scale factor with"):
        assert words in left_out(warmed(document))
    assert "change of the bias with the temperature" in left_out(document(parameters=WARM))
    bent = {"scale_cubic": {"value": [1e-4] * 3, "std": [0.0] * 3, "unit": "s^2/rad^2"}}
    force = {"g_sensitivity": {"value": [1e-4] * 9, "std": [0.0] * 9, "unit": "rad/s/(m/s^2)"}}
    assert "the cube of the rate is not applied" in left_out(document(parameters=bent))
    assert "the sensitivity to acceleration is not applied" in left_out(document(parameters=force))


def test_the_comment_of_the_c_code_has_the_formula_of_its_frame(document: DocumentFactory) -> None:
    stage, sensor = (export_text(ExportSource.of(document(), f), "c") for f in ("stage", "sensor"))
    assert "A = scale (S T M)^-1, c = -(S T M)^-1 b" in stage
    assert "A = scale (S T)^-1, c = -(S T)^-1 b" in sensor


def test_every_export_names_its_frame(document: DocumentFactory) -> None:
    for kind in ("c", "ros", "kalibr", "json"):
        stage, sensor = (
            export_text(ExportSource.of(document(), frame), kind) for frame in ("stage", "sensor")
        )
        assert "the stage's axes" in stage
        assert "axes of the sensor" in sensor
        assert stage != sensor
    assert "rows first, columns in" in export_text(ExportSource.of(document()), "kalibr")
    assert "# (rad/s)^2, rows first" in export_text(ExportSource.of(document()), "ros")


@pytest.mark.parametrize("kind", ["px4", "ardupilot"])
def test_a_frame_without_effect_is_rejected(document: DocumentFactory, kind: str) -> None:
    with pytest.raises(
        UsageError, match=r"in the sensor's own axes, .*\. Remove the option --frame"
    ):
        export_text(ExportSource.of(document(), "sensor"), kind)


def test_options_that_a_format_lacks_are_rejected(document: DocumentFactory) -> None:
    source = ExportSource.of(document())
    for kind, options in (
        ("c", ExportOptions("1st")),
        ("px4", ExportOptions("x")),
        ("px4", ExportOptions(slot=4)),
        ("c", ExportOptions(slot=0)),
        ("ardupilot", ExportOptions(device_id=1)),
        ("matlab", ExportOptions()),
    ):
        with pytest.raises(UsageError):
            export_text(source, kind, options)
    trust = {"verdict": "refused", "reasons": ["nothing turned: turn it"]}
    with pytest.raises(InputError, match=r"gave it the verdict `refused`\. Nothing turned"):
        ExportSource.of(document(trust=trust))


def test_the_command_writes_a_file_once_or_prints_the_text(
    golden: Path, tmp_path: Path, capsys: Captured
) -> None:
    out = tmp_path / "imu.yaml"
    command = ["export", str(golden), "--format", "kalibr"]
    assert cli.run([*command, "-o", str(out)]) == 0
    assert "kalibr" in capsys.readouterr().out
    assert cli.run(command) == 0
    assert capsys.readouterr().out == out.read_text()
    assert cli.run([*command, "-o", str(out)]) == 2
    assert "exists" in capsys.readouterr().err
    assert cli.run([*command, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["text"] == out.read_text()
    assert cli.run(["export", str(golden), "--format", "px4"]) == 0
    assert "\t" in capsys.readouterr().out  # its columns are between tabs


@pytest.mark.parametrize("device_id", ["99999999999", "-5"])
def test_an_identifier_that_px4_cannot_store_is_refused(
    golden: Path, device_id: str, capsys: Captured
) -> None:
    command = ["export", str(golden), "--format", "px4", "--device-id"]
    assert cli.run([*command, device_id]) == 2
    assert "--device-id" in capsys.readouterr().err
    assert cli.run([*command, str(2**31 - 1)]) == 0
    assert f"CAL_GYRO0_ID\t{2**31 - 1}\t6" in capsys.readouterr().out
