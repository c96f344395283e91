"""The search for causes on a rig whose motors vibrate: noise is no cause, and hides none."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import signal

from gyrorig_solver.discover import FitExplanation, explain_fit
from gyrorig_solver.pipeline.board_data import BoardData, load_board
from gyrorig_solver.pipeline.prepare_board import fit_base

FINE = 10  # instants per sample of the simulated noise
MOVING_RAD_S = 0.003


def with_motor_noise(data: BoardData, ratio: float) -> BoardData:
    """Add white noise through the sensor's low-pass while the stage moves."""
    fit, samples = fit_base(data), data.samples[0]
    assert samples.bandwidth_hz is not None
    session, rate_hz = fit.sessions[0], 1.0 / samples.period_s
    speed = np.linalg.norm(session.rates[0], axis=1)
    moving = np.interp(samples.time_s, session.series[0].block_times_s(), speed) > MOVING_RAD_S
    low_pass = signal.butter(2, samples.bandwidth_hz, fs=rate_hz * FINE, output="sos")
    rng = np.random.default_rng(0)
    added = np.zeros((samples.time_s.size, 3))
    for axis in range(3):
        white = rng.normal(size=moving.size * FINE) * np.repeat(moving, FINE)
        level = ratio * np.sqrt(fit.noises[0].levels[axis, 0] * rate_hz * FINE / 2.0)
        added[:, axis] = level * signal.sosfilt(low_pass, white)[::FINE]
    quantum = samples.quantum_rad_s
    rate = np.rint((samples.rate_rad_s + added) / quantum) * quantum
    return replace(data, samples=(replace(samples, rate_rad_s=rate),))


def explain(session: Any, ratio: float) -> FitExplanation:
    data = with_motor_noise(load_board([session.recording], session.board), ratio)
    return explain_fit(fit_base(data), session.board)


@pytest.mark.long
def test_vibration_alone_is_no_cause(hidden: Callable[..., Any]) -> None:
    for ratio in (1.0, 2.0):
        findings = explain(hidden(seed=7), ratio).findings
        assert findings.verdict == "adequate"
        assert findings.causes == ()


@pytest.mark.long
def test_backlash_is_found_beside_vibration(hidden: Callable[..., Any]) -> None:
    findings = explain(hidden("backlash@tilt:0.0012", seed=7), 1.0).findings
    assert [cause.term.cause for cause in findings.causes] == ["backlash"]
    gap = next(value for value in findings.causes[0].values if value.name == "gap.tilt")
    assert abs(gap.value - 0.0012) < 4.0 * gap.std
