"""A prediction contains the pulse of a step loss as the low-pass shapes it."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.unit.solver.made import reference_of, samples_of

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate.board_fit import BoardFit
from gyrorig_solver.estimate.motion_fit import create_session
from gyrorig_solver.estimate.session_fit import SessionFit
from gyrorig_solver.model import find_term

RATE_HZ, BANDWIDTH_HZ = 200.0, 50.0
LOST_RAD = 0.0144  # 16 half steps of pan
MAX_ERROR = 1e-3  # on the grid, the form has an error of 5 to 30 %


@pytest.fixture(scope="module")
def session(simulate: Callable[..., Any]) -> SessionFit:
    rig = simulate(3, hz=RATE_HZ, bandwidth=BANDWIDTH_HZ)
    samples = replace(
        samples_of(rig.time_s, rig.rate_rad_s), metadata={"bandwidth_hz": str(BANDWIDTH_HZ)}
    )
    session = create_session(samples, reference_of(rig), None)
    BoardFit.started([session], ())
    assert session.series[0].samples_per_block == 2
    return session


def butterworth_response(time_s: FloatArray) -> FloatArray:
    """Return the impulse response of a Butterworth low-pass of order two, 1/s."""
    speed_rad_s = np.sqrt(2.0) * np.pi * BANDWIDTH_HZ
    after_s = np.maximum(time_s, 0.0)
    return np.asarray(
        2.0 * speed_rad_s * np.exp(-speed_rad_s * after_s) * np.sin(speed_rad_s * after_s)
    )


@pytest.mark.parametrize("phase", [0.0, 0.2, 0.45, 0.7])
def test_blocks_have_the_mean_of_their_samples(session: SessionFit, phase: float) -> None:
    """`phase`: of the loss, in sample periods."""
    (series,) = session.series
    (state,) = [
        session.signal_state(series, blocks, np.eye(3), exact=True)
        for blocks in series.part_slices()
    ]
    moving = np.flatnonzero(np.abs(session.rates[0][:, 2]) > 0.3)
    block = int(moving[moving.size // 3])
    event_s = float(series.time_s[2 * block]) - session.lag_s + phase / RATE_HZ
    blocks = np.arange(block - 2, block + 8)
    sample_s = series.time_s[: 2 * series.block_count].reshape(-1, 2)[blocks] - session.lag_s
    response = butterworth_response(sample_s - event_s).mean(axis=1)
    tilt_rad = session.reference.angles_rad(np.array([event_s]))[1, 0]  # type: ignore[attr-defined]
    direction = np.array([0.0, np.sin(tilt_rad), np.cos(tilt_rad)])
    expected = -LOST_RAD * response[:, None] * direction
    effect = find_term("lost_steps").effect(state, np.array([LOST_RAD, 0.0, event_s]))
    assert np.linalg.norm(effect[blocks] - expected) < MAX_ERROR * np.linalg.norm(expected)
