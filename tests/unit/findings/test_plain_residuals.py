"""Nameless tests of a residual: silent on the noise that a fit assumed, loud on a shape."""

import numpy as np
import pytest

from gyrorig_solver.data import FloatArray
from gyrorig_solver.discover.attitude.attitude_terms import attitude_families
from gyrorig_solver.discover.cause_findings import DependenceTest
from gyrorig_solver.discover.checks.model_check import DEPENDENCE_FALSE_ALARM_RATE
from gyrorig_solver.discover.checks.residual_dependence import dependences_on
from gyrorig_solver.discover.checks.smooth_alternatives import smooth_families
from gyrorig_solver.estimate import NoiseModel
from gyrorig_solver.estimate.attitude.attitude_projector import AttitudeProjector
from gyrorig_solver.estimate.attitude.block_segments import AttitudeState, BlockSegment
from gyrorig_solver.estimate.attitude.segment_whitening import SegmentWhitener
from gyrorig_solver.estimate.noise.noise_model import Sampling
from gyrorig_solver.model import RecordingContext

N, STEP_S, DENSITY = 1500, 0.1, 1e-8
TIME_S = STEP_S * np.arange(N, dtype=np.float64)
RATE = np.stack([np.sin(0.7 * TIME_S), np.sin(0.31 * TIME_S), np.cos(0.53 * TIME_S)], axis=1)
SLOPE = np.gradient(RATE, STEP_S, axis=0)


def significant_tests(left: FloatArray | None, seed: int) -> list[DependenceTest]:
    """Test white noise of a known density beside turns about all axes, and an effect."""
    std = np.sqrt(DENSITY / (2.0 * STEP_S))
    noise = std * np.random.default_rng(seed).normal(size=(N, 3))
    state = AttitudeState.build(
        np.append(TIME_S, N * STEP_S),
        None,
        np.ones(N, dtype=np.bool_),
        instants_per_block=1,
        intervals_per_instant=1,
        bandwidth_hz=None,
        gain=np.eye(3),
        rate_rad_s=RATE,
        context=RecordingContext(begin_s=0.0, end_s=N * STEP_S),
    )
    measured = RATE + noise + (0.0 if left is None else left)
    segment = BlockSegment(0, state, measured, RATE, RATE, SLOPE, TIME_S, N)
    sampling = Sampling(1.0 / STEP_S, 1, None, 0.0, differentiated=True)
    projector = AttitudeProjector(
        [segment],
        [SegmentWhitener(np.full((N, 3), std), np.ones(N))],
        NoiseModel(np.zeros((3, 4)), sampling),
    )
    families = [*smooth_families(projector.states), *attitude_families()]
    tests = dependences_on(projector, families, len(families))
    return [test for test in tests if test.p_value < DEPENDENCE_FALSE_ALARM_RATE]


@pytest.mark.long
def test_noise_alone_raises_few_alarms() -> None:
    """All tests share 1 in 1000: two in 150 by chance are rarer than 2 in 100."""
    assert sum(bool(significant_tests(None, k)) for k in range(150)) <= 1


@pytest.mark.parametrize("covariate", ["own_rate", "time", "bias_time"])
def test_a_shape_is_told_by_what_it_depends_on(covariate: str) -> None:
    late = (TIME_S > 75.0)[:, None]
    left = {
        "own_rate": 2e-4 * np.abs(RATE),
        "time": 3e-4 * RATE * late,
        "bias_time": 3e-4 * np.ones((N, 3)) * late,
    }[covariate]
    leading = max(significant_tests(left, 1), key=lambda test: test.log_evidence)
    assert leading.covariate == covariate


def test_what_gain_bias_and_lag_take_is_not_seen() -> None:
    assert significant_tests(0.01 * RATE[:, ::-1] + 0.002 + 0.001 * SLOPE, 2) == []
