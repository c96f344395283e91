"""Several recordings of one board, and causes beyond the base model, in one fit."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.unit.solver.made import reference_of, samples_of

from gyrorig_solver.estimate import UNIT_REMEDIES, fit_motion, free_term
from gyrorig_solver.estimate.fitted_term import fixed_term
from gyrorig_solver.estimate.motion_fit import MAX_REDUCED_CHI2, fit_recordings, solve_motion
from gyrorig_solver.estimate.thermal_order import choose_order
from gyrorig_solver.estimate.uncertainty_widening import (
    largest_reduced_chi2,
    reduced_chi2,
    widen_uncertainty,
)
from gyrorig_solver.model import BoardTemperature, RecordingContext, Site, factorise, find_term
from gyrorig_solver.model.causes.earth_rotation import EARTH_RATE_RAD_S
from gyrorig_solver.model.causes.thermal_bias import ThermalBias
from gyrorig_solver.reference import RestReference, TimeInterval

G_M_S2 = 9.80665
Simulate = Callable[..., Any]


def same_board(rig: Any, gain: np.ndarray) -> np.ndarray:
    """Rates of a rig as a board of another gain would have shown them."""
    return np.asarray((rig.rate_rad_s - rig.bias_rad_s) @ (gain @ np.linalg.inv(rig.gain)).T)


def test_information_of_two_recordings_adds_up(simulate: Simulate) -> None:
    rigs = [simulate(20), simulate(21)]
    gain = rigs[0].gain
    pairs = []
    for rig in rigs:
        rate = same_board(rig, gain) + rig.bias_rad_s
        pairs.append((samples_of(rig.time_s, rate), reference_of(rig)))
    alone = [fit_motion(samples, reference, UNIT_REMEDIES) for samples, reference in pairs]
    joint = fit_recordings(pairs, UNIT_REMEDIES)
    true = factorise(gain).as_vector()
    names = [n for n in joint.order if n.split(".")[0] not in ("bias", "time_offset")]
    at = [joint.order.index(n) for n in names]
    error = np.array([joint.value(n) for n in names]) - true
    assert error @ np.linalg.solve(joint.covariance[np.ix_(at, at)], error) < 27.9  # chi2 9, 99.9 %
    for name in names:
        # Independent evidence of one value: precisions add.
        both = (alone[0].std[name] ** -2 + alone[1].std[name] ** -2) ** -0.5
        assert joint.std[name] == pytest.approx(both, rel=0.06)
    for rig, fitted_recording in zip(rigs, joint.recordings, strict=True):
        assert np.all(
            np.abs(fitted_recording.bias_rad_s - rig.bias_rad_s) < 2e-4
        )  # it wanders by as much
        lag_s = rig.lag_s + np.sqrt(2.0) / (2.0 * np.pi * 25.0)
        assert (
            abs(fitted_recording.time_offset_s - lag_s) < 3.0 * fitted_recording.time_offset_std_s
        )
    assert joint.bias_rad_s == pytest.approx(joint.recordings[-1].bias_rad_s)


def test_a_short_recording_with_errors_widens_the_uncertainty(simulate: Simulate) -> None:
    """Pooled with a long recording, its excess would hardly show."""
    tilts = (-600, 400, 0, 500, -300, 0)
    long, short = simulate(24, tilts * 4), simulate(25, tilts[:3])
    gain = long.gain
    tilt = reference_of(short).angles_rad(short.time_s - short.lag_s)[1]
    error_rad_s = 1e-2 * np.sin(3.0 * tilt)[:, None] * np.array([1.0, 1.0, 1.0])
    rates = [
        same_board(long, gain) + long.bias_rad_s,
        same_board(short, gain) + short.bias_rad_s + error_rad_s,
    ]
    pairs = [
        (samples_of(rig.time_s, rate), reference_of(rig))
        for rig, rate in zip((long, short), rates, strict=True)
    ]
    solution = solve_motion(pairs)
    pooled = reduced_chi2(solution)
    largest, recording = largest_reduced_chi2(solution)
    assert recording == 1
    assert largest > 1.5 * pooled
    widened, factor = widen_uncertainty(solution)
    assert factor >= largest > MAX_REDUCED_CHI2 > pooled
    covariance = factor * solution.session_observability[1].covariance
    np.testing.assert_allclose(
        widened.session_observability[1].covariance[:12, :12], covariance[:12, :12]
    )
    joint = fit_recordings(pairs, UNIT_REMEDIES)
    assert any("in recording 2" in reason for reason in joint.limited_reasons)


def test_one_bad_axis_widens_as_much_as_its_own_residual_says(simulate: Simulate) -> None:
    rig = simulate(0)
    tilt = reference_of(rig).angles_rad(rig.time_s - rig.lag_s)[1]
    rate = rig.rate_rad_s.copy()
    rate[:, 0] += 1e-2 * np.sin(3.0 * tilt)
    solution = solve_motion([(samples_of(rig.time_s, rate), reference_of(rig))])
    (white,) = solution.whitened_residuals()
    (session,) = solution.sessions
    power = np.mean(white[session.used[0] & session.moving[0]] ** 2, axis=0)
    assert power[0] > 2.0
    assert np.abs(power[1:] - 1.0).max() < 0.1
    assert widen_uncertainty(solution)[1] == pytest.approx(power[0], rel=1e-3)
    assert largest_reduced_chi2(solution)[0] > reduced_chi2(solution) + 0.1


def test_no_axis_of_a_sound_rig_widens(simulate: Simulate) -> None:
    for seed in range(10):
        rig = simulate(seed)
        solution = solve_motion([(samples_of(rig.time_s, rig.rate_rad_s), reference_of(rig))])
        assert widen_uncertainty(solution)[1] == 1.0, seed
        assert largest_reduced_chi2(solution)[0] == reduced_chi2(solution), seed


def test_static_recording_only_adds_its_own_bias(simulate: Simulate) -> None:
    rig = simulate(22)
    moving = (samples_of(rig.time_s, rig.rate_rad_s), reference_of(rig))
    rng = np.random.default_rng(5)
    time_s = np.arange(6000) / 100.0
    at_rest = np.array([0.05, -0.02, 0.01]) + rng.normal(scale=2.5e-3, size=(6000, 3))
    still = (samples_of(time_s, at_rest), RestReference((TimeInterval(0.0, 60.0),)))
    alone, joint = (
        fit_motion(*moving, UNIT_REMEDIES),
        fit_recordings([still, moving], UNIT_REMEDIES),
    )
    for name in alone.order:
        assert joint.value(name) == pytest.approx(alone.value(name), abs=0.02 * alone.std[name])
        assert joint.std[name] == pytest.approx(alone.std[name], rel=0.02)
    first = joint.recordings[0]
    assert np.all(np.abs(first.bias_rad_s - [0.05, -0.02, 0.01]) < 5.0 * first.bias_std_rad_s)
    assert np.isnan(first.time_offset_s)


def test_g_sensitivity_is_estimated(simulate: Simulate) -> None:
    rig = simulate(23)
    reference = reference_of(rig)
    tilt = reference.angles_rad(rig.time_s - rig.lag_s)[1]
    force = np.column_stack([np.zeros_like(tilt), G_M_S2 * np.sin(tilt), G_M_S2 * np.cos(tilt)])
    felt = np.random.default_rng(7).normal(scale=np.radians(0.1) / G_M_S2, size=(3, 3))
    samples = samples_of(rig.time_s, rig.rate_rad_s + force @ felt.T)
    setting = RecordingContext(begin_s=float(rig.time_s[0]), end_s=float(rig.time_s[-1]))
    plain = fit_motion(samples, reference, UNIT_REMEDIES)
    fit = fit_recordings(
        [(samples, reference)],
        UNIT_REMEDIES,
        (),
        [free_term(find_term("g_sensitivity"))],
        [setting],
    )
    (cause,) = fit.causes
    assert cause.name == "g_sensitivity"
    value, std = cause.value.reshape(3, 3), cause.std.reshape(3, 3)
    assert np.isnan(value[:, 0]).all()  # no axis of the unit brings gravity onto x
    assert "g_sensitivity.sensitivity.xx" in fit.observability.unobservable
    z = (value - felt)[:, 1] / std[:, 1]
    assert np.abs(z).max() < 4.0
    # White noise of density N alone: N / sqrt(2 T) over the force's own deviation.
    least = 5.2e-4 / np.sqrt(2.0 * np.ptp(rig.time_s)) / np.std(force[:, 1])
    assert np.all((std[:, 1] > 0.9 * least) & (std[:, 1] < 2.0 * least))
    assert fit.observability.rank == 12
    pictures = [f.diagnostics for f in (plain, fit)]
    before, after = (np.nanmean(np.square(p.residual_rad_s)) for p in pictures if p is not None)
    assert after < before


def test_earth_rotation_is_removed_if_the_site_is_known(simulate: Simulate) -> None:
    """A still board at pan 0: the bias shifts by the Earth's rate at it, exactly."""
    rig = simulate(24)
    reference, site = reference_of(rig), Site(latitude_deg=30.0, heading_deg=90.0)
    samples = samples_of(rig.time_s, rig.rate_rad_s)
    setting = RecordingContext(site=site, begin_s=float(rig.time_s[0]), end_s=float(rig.time_s[-1]))
    plain = fit_motion(samples, reference, UNIT_REMEDIES)
    fit = fit_recordings(
        [(samples, reference)],
        UNIT_REMEDIES,
        (),
        [fixed_term(find_term("earth_rotation"))],
        [setting],
    )
    assert "earth_rotation" in fit.terms
    # Base z points up: the mean of pan over the program is near zero, and so is tilt's.
    shift = np.linalg.solve(plain.gain, plain.bias_rad_s - fit.bias_rad_s)
    up = EARTH_RATE_RAD_S * np.sin(np.radians(30.0))
    assert shift[2] == pytest.approx(up, rel=0.2)
    assert np.linalg.norm(shift) < 1.2 * EARTH_RATE_RAD_S


def test_thermal_bias_order_is_recovered(simulate: Simulate) -> None:
    rig = simulate(25)
    time_s = rig.time_s
    degc = 25.0 + 15.0 * np.sin(np.pi * (time_s - time_s[0]) / float(np.ptp(time_s))) ** 2
    slope = np.radians([0.03, -0.02, 0.05])
    rate = rig.rate_rad_s + np.outer(degc - degc.mean(), slope)
    temperature = BoardTemperature.of(time_s, degc)
    assert temperature is not None
    setting = replace(
        RecordingContext(begin_s=float(time_s[0]), end_s=float(time_s[-1])), temperature=temperature
    )
    fit = fit_recordings(
        [(samples_of(time_s, rate), reference_of(rig))],
        UNIT_REMEDIES,
        (),
        [free_term(ThermalBias(1))],
        [setting],
    )
    (cause,) = fit.causes
    assert np.abs((cause.value - slope) / cause.std).max() < 4.0
    assert cause.unit == "rad/s/K"


@pytest.mark.parametrize("order", [0, 1, 2])
def test_thermal_order_is_chosen_by_cross_validation(order: int) -> None:
    rng = np.random.default_rng(order)
    right = 0
    for _ in range(20):
        warmth = 30.0 + 15.0 * rng.uniform(size=40)
        unit = (warmth - 37.5) / 15.0
        bias = rng.normal(size=(40, 3))
        if order > 0:
            bias += np.outer(unit, [8.0, -6.0, 5.0])
        if order > 1:
            bias += np.outer(unit**2, [15.0, 20.0, -15.0])
        right += choose_order([warmth], bias, np.ones(3)).order == order
    assert right >= 18


def test_below_ten_kelvin_there_is_no_polynomial() -> None:
    warmth = np.linspace(20.0, 29.0, 60)
    choice = choose_order([warmth], np.outer(warmth, [1.0, 1.0, 1.0]), np.full(3, 0.1))
    assert choice.order == 0
    assert choice.span_k == pytest.approx(9.0)
