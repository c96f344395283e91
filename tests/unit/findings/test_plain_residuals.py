"""Nameless tests of a residual: silent on the noise that a fit assumed, loud on a shape."""

import math

import numpy as np
import pytest

from gyrorig_solver.data.arrays import FloatArray
from gyrorig_solver.discover.checks.fit_residual import findings_from_fit
from gyrorig_solver.estimate.gyro_fit import FitDiagnostics, GyroFit, ObservabilityReport

N, STEP_S, DENSITY = 1500, 0.1, 1e-8


def fit_of(left: FloatArray | None, seed: int) -> GyroFit:
    """White noise of a known density beside turns about all axes, and an effect."""
    rng = np.random.default_rng(seed)
    time_s = STEP_S * np.arange(N, dtype=np.float64)
    rate = np.stack([np.sin(0.7 * time_s), np.sin(0.31 * time_s), np.cos(0.53 * time_s)], axis=1)
    noise = math.sqrt(DENSITY / (2.0 * STEP_S)) * rng.normal(size=(N, 3))
    frequency = np.geomspace(0.003, 5.0, 30)
    data = FitDiagnostics(
        time_s=time_s,
        rate_rad_s=rate,
        reference_rad_s=rate,
        residual_rad_s=noise if left is None else noise + left,
        whitened=noise,
        moving=np.ones(N, dtype=np.bool_),
        frequency_hz=frequency,
        spectrum=np.full((30, 3), DENSITY),
        spectrum_model=np.full((30, 3), DENSITY),
    )
    return GyroFit(
        method="likelihood",
        terms=("bias", "scale"),
        gain=np.eye(3),
        gain_std=np.zeros((3, 3)),
        bias_rad_s=np.zeros(3),
        scale=np.ones(3),
        nonorthogonality=np.zeros(3),
        misalignment_rad=np.zeros(3),
        time_offset_s=0.0,
        std={},
        order=(),
        covariance=np.zeros((0, 0)),
        observability=ObservabilityReport(12, 12, 1.0, (), ()),
        noise=None,
        reduced_chi2=1.0,
        samples=N,
        lost=0,
        outliers=0,
        rate_range_rad_s=(-1.0, 1.0),
        rms_before_rad_s=0.1,
        rms_after_rad_s=0.1,
        diagnostics=data,
    )


def test_noise_alone_raises_few_alarms() -> None:
    """Four tests share 1 in 200: three in 150 by chance are rarer than 5 in 100."""
    alarms = sum(findings_from_fit(fit_of(None, k)).verdict == "unexplained" for k in range(150))
    assert alarms <= 3


@pytest.mark.parametrize("covariate", ["own_rate", "time", "bias_time"])
def test_a_shape_is_told_by_what_it_depends_on(covariate: str) -> None:
    rate = fit_of(None, 1).diagnostics
    assert rate is not None
    late = (rate.time_s > 75.0)[:, None]
    left = {
        "own_rate": 2e-4 * np.abs(rate.rate_rad_s),
        "time": 3e-4 * rate.rate_rad_s * late,
        "bias_time": 3e-4 * np.ones((N, 3)) * late,
    }[covariate]
    findings = findings_from_fit(fit_of(left, 1))
    assert findings.verdict == "unexplained"
    assert findings.unexplained is not None
    assert findings.unexplained.leading.covariate == covariate
    assert findings.causes == ()


def test_what_gain_bias_and_lag_take_is_not_seen() -> None:
    data = fit_of(None, 2).diagnostics
    assert data is not None
    slope = np.gradient(data.rate_rad_s, STEP_S, axis=0)
    left = 0.01 * data.rate_rad_s[:, ::-1] + 0.002 + 0.001 * slope
    assert findings_from_fit(fit_of(left, 2)).verdict == "adequate"
