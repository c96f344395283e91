"""Every export, applied by a reader that shares nothing with its writer."""

import json
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from pymavlink.mavparm import MAVParmDict  # type: ignore[import-untyped]

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_solver import cli
from gyrorig_solver.calibration.document import Calibration
from gyrorig_solver.export.c_header import FixedPoint, c_header, count_limit
from gyrorig_solver.export.flight import shifted
from gyrorig_solver.export.formats import FORMATS, Wishes, exported
from gyrorig_solver.export.numbers import Source

Captured = pytest.CaptureFixture[str]
Made = Callable[..., Calibration]
SCALE = 0.00015271630954950384  # the golden calibration's
BIAS = [0.0078125, -0.015625, 0.03125]
WARM: dict[str, Any] = {
    "thermal_bias.slope": {"value": [1e-3, -2e-3, 5e-4], "std": [0.0] * 3, "unit": "rad/s/K"},
    "thermal_bias.square": {"value": [1e-5, 2e-5, -1e-5], "std": [0.0] * 3, "unit": "rad/s/K^2"},
    "thermal_bias.reference": {"value": [30.0], "std": [0.0], "unit": "degC"},
}
FLAGS = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror"]


def gain_of(found: Calibration) -> np.ndarray:
    return np.array(found.matrices.STM, dtype=np.float64)


def true_rates(found: Calibration, reading_rad_s: np.ndarray) -> np.ndarray:
    return np.linalg.solve(gain_of(found), (reading_rad_s - BIAS).T).T


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
    done = subprocess.run([program], input=text, capture_output=True, text=True, check=True)
    return [[float(word) for word in line.split()] for line in done.stdout.splitlines()]


@pytest.mark.parametrize(
    "compiler", [["gcc", *FLAGS], ["g++", "-x", "c++", "-std=c++11", "-Wall", "-Wextra", "-Werror"]]
)
def test_compiled_c_gives_the_true_rates(
    document: Made, tmp_path: Path, compiler: list[str]
) -> None:
    found = document()
    header = c_header(Source.of(found), "NAME")
    program = compiled(tmp_path, header, MAIN, *compiler)
    rng = np.random.default_rng(8)
    counts = rng.integers(-32768, 32768, size=(500, 3))
    corners = np.array(np.meshgrid(*[[-32768, 32767]] * 3)).reshape(3, -1).T
    counts = np.concatenate([counts, corners])
    first, *rows = run(program, counts)
    assert first == [0.0]
    told = np.array(rows)
    wanted = true_rates(found, counts * SCALE)
    np.testing.assert_allclose(told[:, :3], wanted, rtol=0.0, atol=3e-6)  # float: 6 to 7 digits
    (point,) = re.findall(r"#define NAME_FIXED_POINT (\d+)", header)
    (bound,) = re.findall(r"moves them by at most ([0-9.e-]+) rad/s", header)
    error = np.abs(told[:, 3:] * 2.0 ** -int(point) - wanted).max()
    assert error <= float(bound) * 1.05  # two digits of it are printed
    assert error < 1e-7


def test_c_with_a_temperature(document: Made, tmp_path: Path) -> None:
    found = document(parameters=WARM)
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
        run(compiled(tmp_path, c_header(Source.of(found), "NAME"), main, "gcc", *FLAGS))
    )
    warmth = (rows[:, 0] - 30.0)[:, None]
    read = np.array([1000, -2000, 3000]) * SCALE
    drift = warmth * [1e-3, -2e-3, 5e-4] + warmth**2 * [1e-5, 2e-5, -1e-5]
    np.testing.assert_allclose(rows[:, 1:], true_rates(found, read - drift), atol=1e-6)


def test_the_self_test_finds_a_wrong_number(document: Made, tmp_path: Path) -> None:
    header = c_header(Source.of(document()), "NAME")
    first = re.search(r"static const int32_t A\[3\]\[3\] = \{\s*\{(\d+)", header)
    assert first is not None
    wrong = header.replace(first[1], str(int(first[1]) + 4096), 1)
    rows = run(compiled(tmp_path, wrong, MAIN, "gcc", *FLAGS))
    assert rows[0][0] > 0


@pytest.mark.parametrize("scale", [1e-7, 1.5e-4, 1.06e-3, 1.0])
def test_fixed_point_never_overflows_and_keeps_its_bound(scale: float) -> None:
    rng = np.random.default_rng(3)
    limit = count_limit(scale, 2000.0)
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
        off = np.abs(np.array(steps) * 2.0**-fixed.point - wanted).max()
        assert off <= fixed.error_bound_rad_s(limit) * (1.0 + 1e-6) + 1e-9 * np.abs(wanted).max()


def test_hostile_names_stay_inside_their_comments(document: Made, tmp_path: Path) -> None:
    found = document(
        board="a_b", trust={"verdict": "limited", "reasons": ['*/ #error "x" \\', "é\n"]}
    )
    for kind in ("c", "ros", "kalibr", "px4", "ardupilot"):
        text = exported(Source.of(found), kind)
        assert "\nerror" not in text.replace("#", "")
        assert "*/ #error" not in text
    program = compiled(tmp_path, c_header(Source.of(found), "NAME"), MAIN, "gcc", *FLAGS)
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


def test_ros_parameters_applied_to_a_drivers_rates(document: Made) -> None:
    found = document()
    text = exported(Source.of(found), "ros")
    told = rcl(text)
    own = {n.removeprefix("gyro_calibration."): v for n, v in told.items()}
    correction = np.array(own["angular_velocity_correction"]).reshape(3, 3)
    read = np.random.default_rng(1).normal(size=(40, 3))
    rates = (read - own["angular_velocity_bias"]) @ correction.T
    np.testing.assert_allclose(rates, true_rates(found, read), atol=1e-12)
    assert own["time_offset"] == 0.0125
    assert own["noise_density"] == [0.0005, 0.0005, 0.00075]
    assert "bias_random_walk" not in own  # one axis of it is not known
    assert list(yaml.safe_load(exported(Source.of(found), "ros", Wishes("/imu_node")))) == [
        "/imu_node"
    ]


def px4(text: str) -> dict[str, float]:
    """Read a file as QGroundControl does: five columns between tabs, MAV_PARAM_TYPE last."""
    found = {}
    for line in text.splitlines():
        if line.startswith("#"):
            continue
        vehicle, component, name, value, kind = line.split("\t")
        assert (vehicle, component) == ("1", "1")
        assert len(name) <= 16
        found[name] = float(value) if kind == "9" else int(value)
        assert kind in ("6", "9")
    return found


def test_px4_subtracts_the_bias_and_its_drift(document: Made) -> None:
    plain = px4(exported(Source.of(document("limited")), "px4", Wishes(slot=1)))
    assert plain == dict(
        zip(("CAL_GYRO1_XOFF", "CAL_GYRO1_YOFF", "CAL_GYRO1_ZOFF"), BIAS, strict=True)
    )
    found = px4(exported(Source.of(document(parameters=WARM)), "px4", Wishes(device_id=2293762)))
    assert found["CAL_GYRO0_ID"] == found["TC_G0_ID"] == 2293762
    assert found["TC_G_ENABLE"] == 1
    assert (found["TC_G0_TMIN"], found["TC_G0_TMAX"]) == (24.5, 26.0)
    for axis in range(3):
        for degc in (10.0, 30.0, 45.0):
            # PX4: offset = X0 + X1 dT + X2 dT^2 + X3 dT^3
            warmth = degc - found["TC_G0_TREF"]
            told = sum(found[f"TC_G0_X{p}_{axis}"] * warmth**p for p in range(4))
            slope, square = (WARM[f"thermal_bias.{n}"]["value"][axis] for n in ("slope", "square"))
            assert told == pytest.approx(slope * warmth + square * warmth**2, abs=1e-12)


def test_ardupilot_subtracts_the_bias_and_its_drift(document: Made) -> None:
    text = exported(Source.of(document(parameters=WARM)), "ardupilot")
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    found = {name: float(value) for name, value in (line.split(",") for line in lines)}
    assert found["INS_GYR_CAL"] == 0
    assert [found[f"INS_GYROFFS_{a}"] for a in "XYZ"] == BIAS
    assert all(len(name) <= 16 for name in found)

    def polynomial(axis: str, degc: float) -> float:  # AP_InertialSensor_tempcal.cpp
        step = degc - 35.0
        c = [found[f"INS_TCAL1_GYR{k}_{axis}"] for k in (1, 2, 3)]
        return (c[0] + (c[1] + c[2] * step) * step) * step * 1e-6

    for axis, name in enumerate("XYZ"):
        for degc in (10.0, 24.5, 30.0, 45.0):
            told = polynomial(name, degc) - polynomial(name, found["INS_GYR1_CALTEMP"])
            slope, square = (WARM[f"thermal_bias.{n}"]["value"][axis] for n in ("slope", "square"))
            warmth = degc - 30.0
            assert told == pytest.approx(slope * warmth + square * warmth**2, abs=1e-9)
    second = exported(Source.of(document()), "ardupilot", Wishes(slot=1))
    assert "INS_GYR2OFFS_X,0.0078125" in second


def test_ardupilots_own_library_reads_the_file(
    document: Made, tmp_path: Path, capsys: Captured
) -> None:
    path = tmp_path / "gyro.parm"
    path.write_text(exported(Source.of(document(parameters=WARM)), "ardupilot"))
    found = MAVParmDict()
    assert found.load(str(path))
    assert [found[f"INS_GYROFFS_{a}"] for a in "XYZ"] == BIAS
    assert "Invalid line" not in capsys.readouterr().out  # it goes on behind what it cannot read
    assert len(found) == sum(not line.startswith("#") for line in path.read_text().splitlines())


def test_temperatures_without_a_zero_are_no_vehicles(document: Made) -> None:
    """Where a sensor's temperature counts from anywhere, TMIN and TREF would be wrong."""
    found = document(parameters=WARM, validity={"rate_rad_s": [-1.0, 1.0]})
    for kind in ("px4", "ardupilot"):
        text = exported(Source.of(found), kind)
        assert "not carried by this format: thermal_bias" in text
        assert "TC" not in text.replace("MTC", "")
    assert "a zero that is not known" in exported(Source.of(found), "c")


def test_a_polynomial_moved_to_another_reference() -> None:
    rng = np.random.default_rng(2)
    old = rng.normal(size=(3, 3))
    new = shifted(old, 20.0, 35.0)
    for degc in (-10.0, 20.0, 35.0, 60.0):
        powers = np.arange(1, 4)
        was = ((degc - 20.0) ** powers) @ old - (15.0**powers) @ old
        np.testing.assert_allclose(((degc - 35.0) ** powers) @ new, was, rtol=1e-10, atol=1e-9)


def test_json_has_the_numbers_and_the_document(document: Made) -> None:
    found = document()
    told = json.loads(exported(Source.of(found), "json"))
    read = np.random.default_rng(1).normal(size=(10, 3))
    rates = (read - told["bias_rad_s"]) @ np.array(told["inverse_gain"]).T
    np.testing.assert_allclose(rates, true_rates(found, read), atol=1e-12)
    assert told["calibration"]["schema"] == "gyrorig/calibration/1"
    nothing = json.loads(exported(Source.of(document("limited")), "json"))
    assert nothing["inverse_gain"] is None


@pytest.mark.parametrize("kind", ["c", "ros"])
def test_a_gain_that_was_not_shown_is_not_exported(document: Made, kind: str) -> None:
    with pytest.raises(InputError, match=r"leaves open .*scale"):
        exported(Source.of(document("limited")), kind)


@pytest.mark.parametrize("kind", [k for k in FORMATS if k != "json"])
def test_what_a_format_cannot_hold_is_said_or_refused(document: Made, kind: str) -> None:
    bent = {"scale_cubic": {"value": [1e-4] * 3, "std": [0.0] * 3, "unit": "s^2/rad^2"}}
    text = exported(Source.of(document(parameters=bent)), kind)
    assert "not carried by this format: scale_cubic" in text
    if kind == "kalibr":
        return  # it has a place for the next one
    force = {"g_sensitivity": {"value": [1e-4] * 9, "std": [0.0] * 9, "unit": "rad/s/(m/s^2)"}}
    with pytest.raises(InputError, match="no place for g_sensitivity"):
        exported(Source.of(document(parameters=force)), kind)


def test_every_frame_says_which_it_is(document: Made) -> None:
    for kind in ("c", "ros", "kalibr", "json"):
        stage, sensor = (
            exported(Source.of(document(), frame), kind) for frame in ("stage", "sensor")
        )
        assert "the stage's axes" in stage
        assert "the sensor's own axes" in sensor
        assert stage != sensor
    assert "rows first, columns in" in exported(Source.of(document()), "kalibr")
    assert "# (rad/s)^2, rows first" in exported(Source.of(document()), "ros")


@pytest.mark.parametrize("kind", ["px4", "ardupilot"])
def test_a_frame_that_changes_nothing_is_refused(document: Made, kind: str) -> None:
    with pytest.raises(UsageError, match=r"turns no rates.*leave out --frame"):
        exported(Source.of(document(), "sensor"), kind)


def test_wishes_that_make_no_sense_are_refused(document: Made) -> None:
    source = Source.of(document())
    for kind, wishes in (
        ("c", Wishes("1st")),
        ("px4", Wishes("x")),
        ("px4", Wishes(slot=4)),
        ("c", Wishes(slot=0)),
        ("ardupilot", Wishes(device_id=1)),
        ("matlab", Wishes()),
    ):
        with pytest.raises(UsageError):
            exported(source, kind, wishes)
    trust = {"verdict": "refused", "reasons": ["nothing turned: turn it"]}
    with pytest.raises(InputError, match=r"refused: no export: nothing turned"):
        Source.of(document(trust=trust))


def test_the_command_writes_a_file_once_or_words(
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
