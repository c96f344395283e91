"""Arrays in, arrays out: against the plain formula, and the model put forward again."""

import math
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_solver import Calibration
from gyrorig_solver.apply.affine import BLOCK_SAMPLES, transform_readings
from gyrorig_solver.calibration import calibration_document as documents

DocumentFactory = Callable[..., documents.CalibrationDocument]
RNG = np.random.default_rng(20260401)
MATRIX, OFFSET = RNG.normal(size=(3, 3)), RNG.normal(size=3)


@pytest.mark.parametrize("kind", ["int16", "int32", "int64", "uint8", "float32", "float64"])
@pytest.mark.parametrize(
    "count", [0, 1, 3, 4, 5, BLOCK_SAMPLES - 1, BLOCK_SAMPLES, BLOCK_SAMPLES + 7]
)
def test_every_width_and_length_gives_the_plain_formula(kind: str, count: int) -> None:
    readings = (100.0 * RNG.normal(size=(count, 3))).astype(kind)
    wanted = readings.astype(np.float64) @ MATRIX.T + OFFSET
    np.testing.assert_allclose(
        transform_readings(readings, MATRIX, OFFSET), wanted, rtol=1e-13, atol=1e-11
    )
    single = np.empty((count, 3), dtype=np.float32)
    transform_readings(readings, MATRIX, OFFSET, single)
    np.testing.assert_allclose(single, wanted, rtol=1e-5, atol=1e-3)


def test_readings_with_strides_are_accepted() -> None:
    wide = RNG.normal(size=(100, 7))
    wanted = wide[::2, 1:4] @ MATRIX.T + OFFSET
    np.testing.assert_allclose(
        transform_readings(wide[::2, 1:4], MATRIX, OFFSET), wanted, rtol=1e-12
    )


@settings(max_examples=40, deadline=None)
@given(st.lists(st.integers(0, 99), max_size=5), st.sampled_from([math.nan, math.inf, -math.inf]))
def test_a_missing_reading_does_not_affect_others(rows: list[int], hole: float) -> None:
    readings = np.ones((100, 3))
    readings[rows, 1] = hole
    result = transform_readings(readings, MATRIX, OFFSET)
    whole = np.isfinite(readings).all(axis=1)
    assert np.isfinite(result[whole]).all()
    assert not np.isfinite(result[~whole]).any()


def test_an_unsuitable_output_array_is_rejected() -> None:
    readings = np.ones((8, 3))
    for out in (np.empty((7, 3)), np.empty((8, 3), np.int32), np.empty((8, 6))[:, ::2]):
        with pytest.raises(ValueError, match="out is"):
            transform_readings(readings, MATRIX, OFFSET, out)


def test_the_formula_of_the_conventions(document: DocumentFactory) -> None:
    result = Calibration(document())
    gain = np.array(result.document.matrices.STM, dtype=np.float64)
    bias = np.array(result.document.parameters["bias"].value, dtype=np.float64)
    rate = RNG.normal(size=(50, 3))
    reading = rate @ gain.T + bias
    scale = result.nominal_scale_rad_s
    assert scale is not None
    np.testing.assert_allclose(result.rates(reading / scale), rate, atol=1e-12)
    np.testing.assert_allclose(result.rates(reading, "rad/s"), rate, atol=1e-12)
    np.testing.assert_allclose(result.rates(np.degrees(reading), "deg/s"), rate, atol=1e-12)
    np.testing.assert_allclose(result.rates(reading[0], "rad/s"), rate[0], atol=1e-12)
    np.testing.assert_array_equal(result.times([1.0, 2.0]), [0.9875, 1.9875])


def test_the_sensors_axes_differ_by_the_rotation_alone(document: DocumentFactory) -> None:
    stage, sensor = Calibration(document()), Calibration(document(), "sensor")
    turn = np.array(stage.document.matrices.M, dtype=np.float64)
    reading = RNG.normal(size=(20, 3))
    np.testing.assert_allclose(
        sensor.rates(reading, "rad/s"), stage.rates(reading, "rad/s") @ turn.T, atol=1e-12
    )


def parameter(value: list[float] | list[list[float]], unit: str = "1") -> dict[str, object]:
    return {"value": value, "std": [0.0] * len(value), "unit": unit}


EVERY = {
    "thermal_bias.slope": parameter([1e-3, -2e-3, 5e-4], "rad/s/K"),
    "thermal_bias.square": parameter([1e-5, 2e-5, -1e-5], "rad/s/K^2"),
    "thermal_bias.reference": parameter([25.0], "degC"),
    "thermal_scale": parameter([1e-4, -2e-4, 3e-4], "1/K"),
    "thermal_scale.reference": parameter([25.0], "degC"),
    "scale_quadratic": parameter([1e-3, 2e-3, -1e-3], "s/rad"),
    "scale_cubic": parameter([1e-4, -1e-4, 2e-4], "s^2/rad^2"),
    "scale_asymmetry": parameter([2e-3, -1e-3, 1e-3], "1"),
    "g_sensitivity": parameter(
        [0.0, 1e-4, 2e-4, 0.0, -1e-4, 1e-4, 0.0, 3e-4, 1e-4], "rad/s/(m/s^2)"
    ),
    "backlash.gap": parameter([1e-3], "rad"),
    "bias_step@2.step": parameter([1e-3, 0.0, 0.0], "rad/s"),
}


WARM_RANGE = {"rate_rad_s": [-4.0, 4.0], "temperature_degc": [0.0, 70.0]}


def test_every_cause_of_the_sensor_is_corrected(document: DocumentFactory) -> None:
    """The model forward, written out here axis by axis, comes back to the rates it began with."""
    result = Calibration(document(parameters=EVERY, validity=WARM_RANGE))
    matrices = result.document.matrices
    gain, turn = (np.array(m, dtype=np.float64) for m in (matrices.STM, matrices.M))
    bias = np.array(result.document.parameters["bias"].value, dtype=np.float64)
    rate = RNG.uniform(-4.0, 4.0, size=(300, 3))
    degc = RNG.uniform(10.0, 50.0, size=300)
    force = RNG.normal(size=(300, 3)) + np.array([0.0, 0.0, 9.8])  # in the stage's axes
    values = {name: np.array(p["value"]) for name, p in EVERY.items()}
    read = np.empty_like(rate)
    for row, (omega, t, f) in enumerate(zip(rate, degc - 25.0, force, strict=True)):
        u = gain @ omega
        bent = u + values["thermal_scale"] * t * u + values["scale_quadratic"] * u**2
        bent += values["scale_cubic"] * u**3 + values["scale_asymmetry"] * np.abs(u)
        warm = values["thermal_bias.slope"] * t + values["thermal_bias.square"] * t**2
        read[row] = bent + bias + warm + values["g_sensitivity"].reshape(3, 3) @ f
    output = result.rates(read, "rad/s", temperature_degc=degc, specific_force_m_s2=force @ turn.T)
    np.testing.assert_allclose(output, rate, atol=1e-11)
    assert any("backlash" in words for words in result.not_applied)
    assert any("bias_step@2" in words for words in result.not_applied)


def test_a_single_parameter_has_the_name_of_its_cause(document: DocumentFactory) -> None:
    slope = {"thermal_bias": EVERY["thermal_bias.slope"]}
    slope |= {n: EVERY[n] for n in ("thermal_bias.reference",)}
    result = Calibration(document(parameters=slope, validity=WARM_RANGE))
    cold, warm = (result.rates([0.0, 0.0, 0.0], temperature_degc=t) for t in (25.0, 35.0))
    drift = result.correction.inverse @ [1e-2, -2e-2, 5e-3]
    np.testing.assert_allclose(cold - warm, drift, atol=1e-12)


def test_temperatures_outside_the_valid_range_are_refused_or_nan(
    document: DocumentFactory,
) -> None:
    warm = {n: p for n, p in EVERY.items() if n.startswith("thermal_bias")}
    result = Calibration(document(parameters=warm, validity=WARM_RANGE))
    with pytest.raises(InputError, match=r"valid from 0.0 to 70.0 degC, but .* 71.0 to 71.0 degC"):
        result.rates(np.ones((2, 3)), temperature_degc=[20.0, 71.0])
    output = result.rates(np.ones((3, 3)), temperature_degc=[20.0, 71.0, np.nan], outside="nan")
    assert np.isfinite(output).all(axis=1).tolist() == [True, False, False]


def test_needed_temperatures_and_forces_must_be_given(document: DocumentFactory) -> None:
    warm = {n: p for n, p in EVERY.items() if n.startswith("thermal_bias")}
    result = Calibration(document(parameters=warm))
    with pytest.raises(UsageError, match="depends on the temperature"):
        result.rates(np.ones((4, 3)))
    with pytest.raises(UsageError, match=r"temperatures \(2\) and of readings \(4\) differ"):
        result.rates(np.ones((4, 3)), temperature_degc=[1.0, 2.0])
    force = {"g_sensitivity": EVERY["g_sensitivity"]}
    with pytest.raises(UsageError, match="depends on the acceleration"):
        Calibration(document(parameters=force)).rates(np.ones((4, 3)))


def test_thermal_causes_without_a_reference_temperature_are_not_applied(
    document: DocumentFactory,
) -> None:
    result = Calibration(document(parameters={"thermal_bias.slope": parameter([1.0, 1.0, 1.0])}))
    assert result.correction.is_affine
    assert "has no reference temperature" in " ".join(result.not_applied)
    bias_only = Calibration(result.document, bias_only=True)
    assert "has no reference temperature" in " ".join(bias_only.not_applied)


def test_each_thermal_cause_has_its_reference_temperature(document: DocumentFactory) -> None:
    names = ("thermal_bias.slope", "thermal_bias.reference", "thermal_scale")
    parameters = {name: EVERY[name] for name in names}
    parameters["thermal_scale.reference"] = parameter([40.0], "degC")
    result = Calibration(document(parameters=parameters, validity=WARM_RANGE)).correction
    assert result.bias_curve is not None
    assert result.scale_curve is not None
    assert (result.bias_curve.reference_degc, result.scale_curve.reference_degc) == (25.0, 40.0)


def test_an_unobservable_gain_is_not_applied(document: DocumentFactory) -> None:
    with pytest.raises(InputError, match=r"has no value for .*scale.*Record a motion"):
        Calibration(document("limited"))
    bias = Calibration(document("limited"), bias_only=True)
    np.testing.assert_allclose(
        bias.rates([[0.0, 0.0, 0.0]], "rad/s"), [[-0.0078125, 0.015625, -0.03125]]
    )


@pytest.mark.parametrize("bias_only", [False, True])
def test_a_calibration_with_the_verdict_refused_raises_its_reason(
    document: DocumentFactory, bias_only: bool
) -> None:
    trust = {"verdict": "refused", "reasons": ["the residual is too large: check the signs"]}
    with pytest.raises(InputError, match=r"must not be applied, because .*check the signs"):
        Calibration(document(trust=trust), bias_only=bias_only)


@pytest.mark.parametrize("bad", [np.ones(4), np.ones((2, 2, 3)), np.array(["a", "b", "c"])])
def test_readings_of_another_shape_are_rejected(document: DocumentFactory, bad: np.ndarray) -> None:
    with pytest.raises(UsageError, match=r"shape \(n, 3\)"):
        Calibration(document()).rates(bad)


def test_counts_without_a_nominal_scale_are_rejected(document: DocumentFactory) -> None:
    result = Calibration(document(config={"gyro_scale_rad_s": None}))
    with pytest.raises(UsageError, match="nominal scale factor"):
        result.rates(np.ones((4, 3)))
    with pytest.raises(UsageError, match="unit 'rpm' of the readings is unknown"):
        result.rates(np.ones((4, 3)), "rpm")  # type: ignore[arg-type] # as an untyped caller


def test_missing_and_foreign_files_are_rejected(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        Calibration.load(tmp_path / "nothing.yaml")
    other = tmp_path / "other.yaml"
    other.write_text("schema: something/else\n")
    with pytest.raises(InputError, match="calibration"):
        Calibration.load(other)


def test_arrays_need_no_extra_packages(golden: Path) -> None:
    """Where scipy and jinja2 are missing, a calibration can still be applied."""
    code = (
        "import sys; sys.modules.update(dict.fromkeys(('scipy', 'jinja2')))\n"
        "from gyrorig_solver import Calibration\n"
        f"print(Calibration.load({str(golden)!r}).rates([0, 0, 0]).tolist())"
    )
    process = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert len(process.stdout.split(",")) == 3
