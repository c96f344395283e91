"""A rest whose bias follows the temperature: solved, explained, applied and exported."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.support.simulated_soaks import Soak
from tests.unit.temperature.conftest import ImportSoak

from gyrorig_solver import Calibration, cli
from gyrorig_solver.calibration import CalibrationDocument, parse_calibration

Captured = pytest.CaptureFixture[str]
SHORT = Soak(profile="warm_up", duration_s=1500.0, thermometer_lag_s=0.0)


def solve(recordings: list[Path], out: Path, capsys: Captured, *options: str) -> dict[str, Any]:
    """Return the JSON of a solve; its exit status is 4, because the gain is not determined."""
    capsys.readouterr()
    names = [str(path) for path in recordings]
    assert cli.run(["solve", *names, "--out", str(out), "--json", *options]) == 4
    (board,) = json.loads(capsys.readouterr().out)["boards"]
    return dict(board)


def document_of(board: dict[str, Any]) -> CalibrationDocument:
    return parse_calibration(Path(board["file"]).read_bytes(), board["file"])


@pytest.mark.long
def test_a_warm_up_gives_a_curve_and_its_finding(
    import_soak: ImportSoak, tmp_path: Path, capsys: Captured
) -> None:
    recording, simulated = import_soak(SHORT)
    board = solve([recording], tmp_path / "cal", capsys)
    document = document_of(board)
    assert document.findings is not None
    assert document.findings.verdict == "explained"
    assert document.findings.causes == ["thermal_bias"]
    record = document.temperature
    assert record is not None
    assert record.bias is not None
    assert record.range_degc == pytest.approx([22.0, 51.8], abs=0.5)
    assert len(record.points) > 10
    calibration = Calibration(document, bias_only=True)
    degc = np.linspace(25.0, 50.0, 9)
    output = calibration.rates(
        np.radians(simulated.curve_dps(degc)), "rad/s", temperature_degc=degc
    )
    assert np.degrees(np.abs(output)).max() < 0.05  # of 1.1 deg/s of change
    inside = np.abs(np.degrees(output)) < 3.5 * np.degrees(_curve_std(document, degc))
    assert inside.all()
    assert cli.run(["explain", str(recording), "--out", str(tmp_path / "explained")]) == 0
    assert "temperature changes the bias" in capsys.readouterr().out


def _curve_std(document: CalibrationDocument, degc: Any) -> Any:
    """Return the stated standard uncertainty of the curve, by its published covariance."""
    record = document.temperature
    assert record is not None
    assert record.bias is not None
    rise = degc - record.reference_degc
    columns = [rise ** (p + 1) for p in range(len(record.bias.coefficients))]
    for knot in record.bias.knots_degc:
        columns.append(
            np.maximum(degc - knot, 0.0) ** 3 - max(record.reference_degc - knot, 0.0) ** 3
        )
    design = np.stack([*columns, np.ones_like(degc)], axis=1)
    covariance = np.array(record.bias.covariance)
    return np.sqrt(np.einsum("ni,aij,nj->na", design, covariance, design))


def test_a_constant_bias_is_refused_its_small_uncertainty(
    import_soak: ImportSoak, tmp_path: Path, capsys: Captured
) -> None:
    """As requested with `--extend none`: the change is in the uncertainty, with the reason."""
    recording, _ = import_soak(SHORT)
    board = solve([recording], tmp_path / "cal", capsys, "--extend", "none")
    document = document_of(board)
    assert document.temperature is None
    std_dps = np.degrees(np.array(document.parameters["bias"].std, dtype=np.float64))
    assert std_dps[0] > 0.1
    assert document.trust.verdict == "limited"
    assert any("follows the temperature" in reason for reason in document.trust.reasons)
    assert any("includes this change" in warning for warning in document.quality.warnings)


def test_a_drift_without_a_thermometer_is_in_the_uncertainty(
    import_soak: ImportSoak, tmp_path: Path, capsys: Captured
) -> None:
    recording, _ = import_soak(SHORT, thermometer=False)
    document = document_of(solve([recording], tmp_path / "cal", capsys, "--extend", "none"))
    std_dps = np.degrees(np.array(document.parameters["bias"].std, dtype=np.float64))
    assert std_dps[0] > 0.1


@pytest.mark.long
def test_a_steady_bias_has_no_curve(
    import_soak: ImportSoak, tmp_path: Path, capsys: Captured
) -> None:
    soak = Soak(profile="warm_up", duration_s=1500.0, coefficients_dps=np.zeros((1, 3)))
    recording, _ = import_soak(soak)
    document = document_of(solve([recording], tmp_path / "cal", capsys))
    assert document.temperature is None
    assert not any("temperature" in reason for reason in document.trust.reasons)


@pytest.mark.long
def test_recordings_at_several_temperatures_give_one_curve(
    import_soak: ImportSoak, tmp_path: Path, capsys: Captured
) -> None:
    recordings = []
    for k, degc in enumerate([5.0, 15.0, 25.0, 35.0, 45.0, 55.0]):
        soak = Soak(profile="constant", start_degc=degc, duration_s=120.0)
        recordings.append(import_soak(soak, 0, name=f"r{k}")[0])  # one offset: the same seed
    document = document_of(solve(recordings, tmp_path / "cal", capsys))
    record = document.temperature
    assert record is not None
    assert record.repeatability is not None
    assert record.range_degc == pytest.approx([5.0, 55.0], abs=1.0)


@pytest.mark.long
def test_a_hysteresis_is_stated_and_not_left_in_the_residual(
    import_soak: ImportSoak, tmp_path: Path, capsys: Captured
) -> None:
    recording, _ = import_soak(Soak(loop_dps=0.12), 4)
    board = solve([recording], tmp_path / "cal", capsys)
    document = document_of(board)
    record = document.temperature
    assert record is not None
    assert record.hysteresis is not None
    assert record.hysteresis.fitted
    assert np.degrees(record.hysteresis.width) == pytest.approx([0.12] * 3, abs=0.03)
    assert record.lag_std_s is not None
    assert abs(record.lag_s - 20.0) < 3.0 * record.lag_std_s
    assert document.findings is not None
    assert document.findings.verdict == "explained"
    page = Path(board["report"]).read_text(encoding="utf-8")
    assert "Hysteresis: the bias while heating" in page
    assert "temperature, °C" in page


@pytest.mark.long
def test_a_curve_is_exported_without_a_gain(
    import_soak: ImportSoak, tmp_path: Path, capsys: Captured
) -> None:
    recording, _ = import_soak(SHORT)
    board = solve([recording], tmp_path / "cal", capsys)
    calibration = Calibration.load(board["file"], bias_only=True)
    degc = np.array([25.0, 40.0, 50.0])
    ours = calibration.rates(np.zeros((3, 3)), "rad/s", temperature_degc=degc)
    capsys.readouterr()
    assert cli.run(["export", board["file"], "--format", "px4", "--device-id", "7"]) == 0
    px4 = {
        row.split("\t")[2]: float(row.split("\t")[3])
        for row in capsys.readouterr().out.splitlines()
        if not row.startswith("#")
    }
    assert cli.run(["export", board["file"], "--format", "ardupilot"]) == 0
    ardupilot = {
        row.split(",")[0]: float(row.split(",")[1])
        for row in capsys.readouterr().out.splitlines()
        if not row.startswith("#")
    }
    for k, temperature in enumerate(degc):
        for index, axis in enumerate("XYZ"):
            corrected = -px4_offset(px4, temperature, index) - px4[f"CAL_GYRO0_{axis}OFF"]
            assert corrected == pytest.approx(ours[k, index], abs=2e-5)
            corrected = ardupilot_rate(ardupilot, temperature, axis)
            assert corrected == pytest.approx(ours[k, index], abs=2e-5)


def px4_offset(parameters: dict[str, float], temperature_degc: float, axis: int) -> float:
    """Evaluate the thermal offset by PX4's documentation of TC_G0_*.

    The measured temperature is limited to TMIN and TMAX; the offset is X0 + X1 d + X2 d^2 + X3 d^3
    with d the difference to TREF, and is subtracted from the rate (rad/s).
    """
    assert parameters["TC_G_ENABLE"] == 1
    assert parameters["TC_G0_ID"] == parameters["CAL_GYRO0_ID"] == 7
    limited = min(max(temperature_degc, parameters["TC_G0_TMIN"]), parameters["TC_G0_TMAX"])
    difference = limited - parameters["TC_G0_TREF"]
    return sum(parameters[f"TC_G0_X{p}_{axis}"] * difference**p for p in range(4))


def ardupilot_rate(parameters: dict[str, float], temperature_degc: float, axis: str) -> float:
    """Correct a zero reading by ArduPilot's documentation of INS_TCAL1_* and INS_GYROFFS.

    The polynomial has no constant, its argument is the temperature above 35 degC, and coefficients
    are in 1e-6. Its value at the temperature of the offsets is added back.
    """
    assert parameters["INS_TCAL1_ENABLE"] == 1

    def polynomial(degc: float) -> float:
        low, high = parameters["INS_TCAL1_TMIN"], parameters["INS_TCAL1_TMAX"]
        d = min(max(degc, low), high) - 35.0
        first, second, third = (parameters[f"INS_TCAL1_GYR{k}_{axis}"] for k in (1, 2, 3))
        return 1e-6 * d * (first + d * (second + d * third))

    thermal = polynomial(temperature_degc) - polynomial(parameters["INS_GYR1_CALTEMP"])
    return -thermal - parameters[f"INS_GYROFFS_{axis}"]
