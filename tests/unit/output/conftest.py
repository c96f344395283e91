"""A fixed fit, by hand and in closed form, for golden files and pages."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gyrorig_solver.calibration.calibration_builder import Provenance
from gyrorig_solver.calibration.calibration_document import BoardRecord, BoardSettings, SolvedInput
from gyrorig_solver.estimate import ClockQuality, FitDiagnostics, GyroFit, ObservabilityReport
from gyrorig_solver.estimate.gyro_fit import NoiseLevels
from gyrorig_solver.model.gain_matrix import GainFactors

NAMES = (
    *("bias.x", "bias.y", "bias.z", "scale.x", "scale.y", "scale.z"),
    *("nonorthogonality.xy", "nonorthogonality.zx", "nonorthogonality.zy"),
    *("misalignment.x", "misalignment.y", "misalignment.z", "time_offset"),
)
FACTORS = GainFactors(
    scale=np.array([0.98, 1.0, 1.03125]),
    nonorthogonality=np.array([0.0125, -0.0075, 0.005]),
    misalignment_rad=np.array([0.02, -0.01, 0.03]),
)


def _diagnostics() -> FitDiagnostics:
    rng = np.random.default_rng(20260131)
    time_s = np.arange(6000) / 50.0
    reference = np.stack(
        [0.2 * np.sin(time_s), 0.4 * np.sin(time_s / 3.0), np.sign(np.sin(time_s / 5.0))], axis=1
    )
    residual = 0.002 * rng.normal(size=(6000, 3))
    frequency = np.geomspace(0.01, 25.0, 60)
    density = np.full((60, 3), 0.002**2 / 25.0)
    return FitDiagnostics(
        time_s=time_s,
        rate_rad_s=reference @ FACTORS.gain.T + [0.01, -0.02, 0.03] + residual,
        reference_rad_s=reference,
        residual_rad_s=residual,
        whitened=residual / 0.002,
        moving=np.abs(reference[:, 2]) > 0.0,
        frequency_hz=frequency,
        spectrum=density * rng.chisquare(20, size=(60, 3)) / 20.0,
        spectrum_model=density,
    )


@pytest.fixture(scope="session")
def good_fit() -> GyroFit:
    """A fit with every parameter observable; numbers that are exact in binary where they can."""
    return GyroFit(
        method="likelihood",
        terms=("bias", "scale", "nonorthogonality", "misalignment", "time_offset"),
        gain=FACTORS.gain,
        gain_std=np.full((3, 3), 2.0**-12),
        bias_rad_s=np.array([0.0078125, -0.015625, 0.03125]),
        scale=FACTORS.scale,
        nonorthogonality=FACTORS.nonorthogonality,
        misalignment_rad=FACTORS.misalignment_rad,
        time_offset_s=0.0125,
        std={**dict.fromkeys(NAMES, 2.0**-12), "time_offset": 2.0**-14},
        order=NAMES,
        covariance=np.diag([2.0**-24] * 12 + [2.0**-28]),
        observability=ObservabilityReport(
            rank=12, of=12, condition=2.5, unobservable=(), reasons=()
        ),
        noise=NoiseLevels(
            angle_random_walk=np.array([0.0005, 0.0005, 0.00075]),
            bias_instability=np.array([0.0001, 0.0001, 0.0001]),
            rate_random_walk=np.array([1e-05, 1e-05, math.nan]),
            source="rests",
        ),
        reduced_chi2=1.03125,
        samples=12000,
        lost=3,
        outliers=0,
        rate_range_rad_s=(-1.0, 1.25),
        rms_before_rad_s=0.03125,
        rms_after_rad_s=0.001953125,
        temperature_range_degc=(24.5, 26.0),
        clock=ClockQuality(
            skew_ppm=-31.5,
            wander_bound_s=4e-06,
            latency_median_s=0.0011,
            latency_max_s=0.0182,
            restarts=0,
            wraps=1,
            truth="the capture clock",
        ),
        reference="The stage's rate comes from the pan-tilt unit's own answers.",
        diagnostics=_diagnostics(),
    )


@pytest.fixture(scope="session")
def limited_fit(good_fit: GyroFit) -> GyroFit:
    """A fit of a motion about pan alone: only the third column of the gain has values."""
    unknown = ("scale", "nonorthogonality", "misalignment")
    gain = good_fit.gain.copy()
    gain[:, :2] = math.nan
    none = np.full(3, math.nan)
    return replace(
        good_fit,
        gain=gain,
        scale=none,
        nonorthogonality=none,
        misalignment_rad=none,
        std={n: v for n, v in good_fit.std.items() if n.split(".")[0] not in unknown},
        order=("bias.x", "bias.y", "bias.z", "time_offset"),
        covariance=np.diag([2.0**-24] * 3 + [2.0**-28]),
        observability=ObservabilityReport(
            rank=6,
            of=12,
            condition=1.5,
            unobservable=tuple(n for n in NAMES if n.split(".")[0] in unknown),
            reasons=("columns x and y of the gain: the tilt never turned, so sweep it too",),
        ),
    )


@pytest.fixture(scope="session")
def provenance() -> Provenance:
    """A board and one recording."""
    return Provenance(
        board=BoardRecord(
            id="GY80-0007",
            uid="0123456789abcdef",
            sensor="L3G4200D",
            config=BoardSettings(
                odr_hz=100.0,
                bandwidth_hz=25.0,
                gyro_full_scale_dps=250.0,
                gyro_scale_rad_s=0.00015271630954950384,
                config_hash="c0ffee",
            ),
        ),
        inputs=[
            SolvedInput(
                name="session.mcap",
                sha256="ab" * 32,
                start="2026-01-31T02:00:00Z",
                duration_s=120.0,
                samples=12000,
                lost=3,
            )
        ],
        created="2026-01-31T02:30:00Z",
        software="0.1.0",
        settings={"method": "likelihood"},
    )
