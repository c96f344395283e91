"""The space beside a fit against a dense least-squares problem, put together by itself."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.estimate.projection import Projection
from gyrorig_solver.model.terms.scene import Scene
from gyrorig_solver.on_unit import unit_solution


@pytest.fixture(scope="module")
def projection(hidden: Callable[..., Any]) -> Projection:
    """Beside the fit of a session with nothing hidden."""
    session = hidden(seed=7)
    return Projection.of(unit_solution([session.recording], session.board))


def dense(projection: Projection) -> np.ndarray:
    """All derivatives, with what is known of the unknowns as further rows."""
    local, base, prior = projection._local, projection._base, projection._prior
    information = np.block([[prior.local.toarray(), prior.cross], [prior.cross.T, prior.shared]])
    values, vectors = np.linalg.eigh(information)
    known = np.sqrt(np.clip(values, 0.0, None))[:, None] * vectors.T
    return np.vstack([np.vstack([local.toarray(), base]).T, known])


def test_what_is_left_is_the_residual_of_least_squares(projection: Projection) -> None:
    design = dense(projection)
    signal = np.random.default_rng(3).standard_normal((2, projection.residual.size))
    rows = design.shape[0] - signal.shape[1]
    padded = np.hstack([signal, np.zeros((2, rows))]).T
    best = np.linalg.lstsq(design, padded, rcond=1e-12)[0]
    left = padded - design @ best
    looked = projection.look(signal)
    assert looked.information == pytest.approx(left.T @ left, rel=1e-6, abs=1e-4)
    assert projection.left(signal[0]) == pytest.approx(left[: signal.shape[1], 0], abs=1e-6)


def test_scores_are_standard_normal_in_noise(projection: Projection) -> None:
    signal = np.random.default_rng(4).standard_normal((60, projection.residual.size))
    looked = projection.look(signal)
    z = looked.score / np.sqrt(np.diag(looked.information))
    assert abs(np.mean(z)) < 4.0 / np.sqrt(60)
    assert np.std(z) == pytest.approx(1.0, abs=0.4)


def test_what_the_fit_follows_vanishes(projection: Projection) -> None:
    own = projection._base[:12]  # gain and bias have next to no prior
    looked = projection.look(own)
    assert np.diag(looked.information) == pytest.approx(0.0, abs=1e-3 * looked.raw.max())


def test_whitening_is_one_signal_and_one_axis_at_a_time(projection: Projection) -> None:
    blocks = projection.scenes[0].blocks
    signals = np.random.default_rng(5).standard_normal((4, blocks, 3))
    signals[1, :, 0] = signals[2] = 0.0
    before = signals.copy()
    together = projection.signals(lambda scene: signals)
    assert np.array_equal(signals, before)
    for one, white in zip(signals, together, strict=True):
        sums = projection.signals(partial(_apart, one)).sum(axis=0)
        assert white == pytest.approx(sums, rel=1e-9, abs=1e-9)
    assert not together[2].any()


def _apart(one: FloatArray, scene: Scene) -> FloatArray:
    """Return a signal's three axes as three signals."""
    found = np.zeros((3, scene.blocks, 3))
    for axis in range(3):
        found[axis, :, axis] = one[:, axis]
    return found


def test_many_signals_say_what_each_says_alone(projection: Projection) -> None:
    signals = np.random.default_rng(6).standard_normal((25, projection.residual.size))
    together = projection.look(signals)
    for k in (0, 11, 24):
        alone = projection.look(signals[k : k + 1])
        assert together.part([k]).information == pytest.approx(alone.information, rel=1e-6)
        assert together.score[k] == pytest.approx(float(alone.score[0]), rel=1e-6)
        assert together.taken[k] == pytest.approx(alone.taken[0], rel=1e-6, abs=1e-12)
