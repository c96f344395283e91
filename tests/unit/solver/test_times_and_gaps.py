"""Fits with repeated times, slow ticks, and gaps that separate the samples into several series."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats
from tests.bench.accuracy.noise import Levels
from tests.unit.solver import conftest
from tests.unit.solver.made import reference_of, samples_of

from gyrorig_solver.data.clocks import map_clock
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate import UNIT_REMEDIES, GyroFit, fit_motion
from gyrorig_solver.model import FACTOR_NAMES, factorise

Simulate = Callable[..., Any]
MAX_CHANGE = 0.05  # of a value, in standard uncertainties
WANDERING = Levels(white=5.2e-4, flicker=1e-3, walk=5e-4, quantum_rad_s=1.527e-4)
SEEDS, LOWEST_P = 8, 0.001


def fit(rig: Any, samples: GyroSamples) -> GyroFit:
    """Fit samples of a simulated rig."""
    return fit_motion(samples, reference_of(rig), UNIT_REMEDIES)


def gain_errors(rig: Any, result: GyroFit) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors of the nine factors of the gain, and their covariance."""
    factors = factorise(rig.gain)
    true = [*factors.scale, *factors.nonorthogonality, *factors.misalignment_rad]
    places = [result.order.index(name) for name in FACTOR_NAMES]
    values = np.array([result.value(name) for name in FACTOR_NAMES])
    return values - true, result.covariance[np.ix_(places, places)]


def samples_without_gaps(samples: GyroSamples, is_kept: np.ndarray) -> GyroSamples:
    """Return samples without some of them."""
    names = ("time_s", "host_s", "number", "segment", "rate_rad_s", "usable")
    return replace(samples, **{name: getattr(samples, name)[is_kept] for name in names})


@pytest.mark.parametrize("case", ["one", "many", "last"])
def test_repeated_times_change_nothing(simulate: Simulate, case: str) -> None:
    rig = simulate(3, tilts=(-600, 400))
    samples = samples_of(rig.time_s, rig.rate_rad_s)
    time_s = samples.time_s.copy()
    repeated = {"one": [1001], "many": range(1001, 3000, 50), "last": [time_s.size - 1]}[case]
    for k in repeated:
        time_s[k] = time_s[k - 1]
    clean, result = fit(rig, samples), fit(rig, replace(samples, time_s=time_s))
    for name in clean.order:
        assert abs(result.value(name) - clean.value(name)) < MAX_CHANGE * clean.std[name], name


def test_a_clock_with_slower_ticks_than_samples_is_fitted(simulate: Simulate) -> None:
    rig = simulate(3, tilts=(-600, 400), hz=1600.0, bandwidth=400.0)
    arrival_s = rig.time_s + 0.001 * np.random.default_rng(0).uniform(size=rig.time_s.size)
    ticks = np.floor(rig.time_s * 1e3).astype(np.int64)
    samples = samples_of(rig.time_s, rig.rate_rad_s, map_clock(ticks, arrival_s, 1e3, 64))
    result = fit(rig, replace(samples, metadata={"bandwidth_hz": "400"}))
    error, covariance = gain_errors(rig, result)
    assert stats.chi2.sf(error @ np.linalg.solve(covariance, error), 9) > LOWEST_P
    assert result.outliers < 0.001 * rig.time_s.size


@pytest.mark.long
def test_the_gain_is_as_uncertain_as_stated_if_a_wandering_bias_has_gaps(
    simulate: Simulate, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(conftest, "LEVELS", WANDERING)
    total = 0.0
    for seed in range(SEEDS):
        rig = simulate(seed)
        samples = samples_of(rig.time_s, rig.rate_rad_s)
        is_kept = np.ones(rig.time_s.size, dtype=np.bool_)
        for first in range(800, is_kept.size, 800):
            is_kept[first : first + 210] = False
        result = fit(rig, samples_without_gaps(samples, is_kept))
        error, covariance = gain_errors(rig, result)
        total += float(error @ np.linalg.solve(covariance, error))
    assert stats.chi2.sf(total, 9 * SEEDS) > LOWEST_P, total
