"""The curve of the bias against the temperature, from simulated rests and from tables."""

import numpy as np
import pytest
from tests.support.quick_cases import quick_cases
from tests.support.simulated_soaks import (
    CUBIC_DPS,
    Array,
    Soak,
    SoakData,
    polynomial_dps,
    simulate_soak,
)

from gyrorig_solver.estimate import TemperatureFit, fit_temperature
from gyrorig_solver.estimate.temperature import (
    BiasSeries,
    BiasTable,
    measure_bias_change,
)
from gyrorig_solver.model import BoardTemperature

STEP_S = 6.0
INNER_DEGC = np.linspace(3.0, 57.0, 11)


def windows_of(simulated: SoakData, name: str = "soak") -> BiasSeries:
    """Return the windows of a simulated rest, as the solver cuts them."""
    group = round(STEP_S)
    count = simulated.time_s.size // group
    bias = simulated.rate_dps[: count * group].reshape(count, group, 3).mean(axis=1)
    time_s = simulated.time_s[: count * group].reshape(count, group).mean(axis=1)
    temperature = BoardTemperature.of(simulated.time_s, simulated.thermometer_degc)
    assert temperature is not None
    return BiasSeries(
        name, time_s, np.radians(bias), temperature.smoothed(20.0), temperature.mean_degc
    )


def curve_errors(fit: TemperatureFit, truth_dps: Array, degc: Array) -> Array:
    """Return errors of the curve in standard uncertainties, (n, 3)."""
    estimate = np.degrees(fit.value + fit.curve.change(degc))
    return np.asarray((estimate - truth_dps) / np.degrees(fit.std(degc)), dtype=np.float64)


def fitted(soak: Soak, seed: int) -> tuple[SoakData, TemperatureFit]:
    """Return a simulated rest and its curve."""
    simulated = simulate_soak(soak, seed)
    result = fit_temperature([windows_of(simulated)], STEP_S)
    assert result is not None
    return simulated, result


def test_a_soak_gives_the_cubic_the_lag_and_no_hysteresis() -> None:
    simulated, result = fitted(Soak(), 1)
    assert result.is_significant
    assert result.basis.size >= 3
    assert abs(result.lag_s - 20.0) < 4.0 * result.lag_std_s < 12.0
    assert result.hysteresis is not None
    assert not result.hysteresis.is_fitted
    assert np.abs(curve_errors(result, simulated.curve_dps(INNER_DEGC), INNER_DEGC)).max() < 4.0
    assert np.degrees(result.std(INNER_DEGC)).max() < 0.01
    assert result.range_degc == pytest.approx((0.0, 60.0), abs=1.0)


@pytest.mark.parametrize("profile", quick_cases(["up_and_down", "up", "warm_up"], ["up"]))
def test_intervals_contain_the_curve(profile: str) -> None:
    """A small version of tests/bench/bench_temperature.py."""
    inside = []
    degc = np.linspace(25.0, 50.0, 6)
    for seed in range(6):
        simulated, result = fitted(Soak(profile=profile, walk_dps=0.0003), seed)
        assert result.is_significant
        inside.append(np.abs(curve_errors(result, simulated.curve_dps(degc), degc)) < 1.96)
    assert np.mean(inside) > 0.8


@pytest.mark.parametrize(("profile", "walk_dps"), [("up_and_down", 0.003), ("warm_up", 0.001)])
def test_a_random_walk_is_no_dependence_on_the_temperature(profile: str, walk_dps: float) -> None:
    soak = Soak(profile=profile, walk_dps=walk_dps, coefficients_dps=np.zeros((1, 3)))
    evidence = [fitted(soak, seed)[1].evidence_nats for seed in range(5)]
    assert max(evidence) < 0.0


def test_a_hysteresis_is_seen_beside_the_lag() -> None:
    _, result = fitted(Soak(loop_dps=0.06), 3)
    assert result.hysteresis is not None
    assert result.hysteresis.is_fitted
    assert np.degrees(result.hysteresis.width) == pytest.approx([0.06] * 3, abs=0.015)
    branches = {point.heating for point in result.points}
    assert branches == {True, False}


def test_one_heating_shows_no_hysteresis() -> None:
    assert fitted(Soak(profile="up"), 1)[1].hysteresis is None


def test_a_curve_that_no_cubic_describes_is_a_spline() -> None:
    soak = Soak(coefficients_dps=np.zeros((1, 3)))
    simulated = simulate_soak(soak, 2)
    series = windows_of(simulated)
    kink = np.maximum(series.die_degc(20.0) - 40.0, 0.0)[:, None] * [2e-3, -1e-3, 0.0]
    bent = BiasSeries("kink", series.time_s, series.bias + kink, series.temperature, 0.0)
    bent = BiasSeries(
        "kink", series.time_s, series.bias + kink, series.temperature, series.origin_degc
    )
    result = fit_temperature([bent], STEP_S)
    assert result is not None
    assert result.basis.knots.size > 0
    degc = np.array([10.0, 30.0, 55.0])
    change = result.curve.change(degc) - result.curve.change(np.array([30.0]))
    wanted = np.maximum(degc - 40.0, 0.0)[:, None] * [2e-3, -1e-3, 0.0]
    np.testing.assert_allclose(change, wanted, atol=1e-3)
    cubic, error = result.curve.as_cubic()
    assert not cubic.knots_degc.size
    assert 1e-4 < error.max() < 1e-2


def test_recordings_at_several_temperatures_are_pooled() -> None:
    """Each recording has its own temperature, and the bias changes from one to the next."""
    rng = np.random.default_rng(5)
    series, biases = [], []
    for k, degc in enumerate(np.linspace(0.0, 60.0, 12)):
        soak = Soak(profile="constant", start_degc=float(degc), duration_s=300.0)
        simulated = simulate_soak(soak, 100 + k)
        change = rng.normal(0.0, 0.02, 3) - simulated.offset_dps
        moved = SoakData(
            simulated.time_s,
            simulated.thermometer_degc,
            simulated.rate_dps + change,
            np.zeros(3),
        )
        series.append(windows_of(moved, f"r{k}"))
        biases.append(moved)
    result = fit_temperature(series, STEP_S)
    assert result is not None
    assert result.is_significant
    assert np.degrees(result.run_std).mean() == pytest.approx(0.02, rel=0.5)
    errors = curve_errors(result, polynomial_dps(INNER_DEGC, CUBIC_DPS), INNER_DEGC)
    assert np.abs(errors).max() < 3.5
    assert np.degrees(result.std(np.array([30.0]))).max() > 0.005  # not that of the noise alone


def test_a_table_without_times() -> None:
    rng = np.random.default_rng(6)
    degc = np.linspace(-10.0, 70.0, 17)
    value = np.radians(polynomial_dps(degc, CUBIC_DPS) + 0.1 + rng.normal(0.0, 0.01, (17, 3)))
    result = fit_temperature([], table=BiasTable(degc, value, np.zeros((17, 3))))
    assert result is not None
    assert result.is_significant
    assert result.lag_std_s == 0.0
    errors = curve_errors(result, polynomial_dps(INNER_DEGC, CUBIC_DPS) + 0.1, INNER_DEGC)
    assert np.abs(errors).max() < 3.5
    assert np.degrees(result.run_std) == pytest.approx([0.01] * 3, rel=0.5)
    noise = BiasTable(degc, np.radians(rng.normal(0.0, 0.01, (17, 3))), np.zeros((17, 3)))
    flat = fit_temperature([], table=noise)
    assert flat is not None
    assert not flat.is_significant


def test_a_constant_temperature_gives_no_curve() -> None:
    simulated = simulate_soak(Soak(profile="constant", start_degc=25.0, duration_s=600.0), 1)
    assert fit_temperature([windows_of(simulated)], STEP_S) is None


def test_the_change_of_a_bias_is_measured_beyond_white_noise() -> None:
    rng = np.random.default_rng(8)
    white = rng.normal(0.0, 1.0, (500, 3))
    assert not measure_bias_change([white]).is_significant.any()
    drift = np.linspace(-3.0, 3.0, 500)[:, None] * [1.0, 0.0, 1.0]
    change = measure_bias_change([white + drift])
    assert change.is_significant.tolist() == [True, False, True]
    assert change.std[0] == pytest.approx(np.sqrt(3.0), rel=0.1)
