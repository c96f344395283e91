"""The space beside a fit against a dense least-squares problem, put together by itself."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from tests.support.board_fits import fit_base_model

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate import NuisanceProjector, WhitenedSignals, join_signals
from gyrorig_solver.model import AxisBiases, Signals, SignalState, dense_signals


@pytest.fixture(scope="module")
def projection(hidden: Callable[..., Any]) -> NuisanceProjector:
    """Beside the fit of a session with nothing hidden."""
    session = hidden(seed=7)
    return NuisanceProjector.at_fit(fit_base_model([session.recording], session.board))


def dense(projection: NuisanceProjector) -> np.ndarray:
    """All derivatives, with what is known of the unknowns as further rows."""
    local, base, prior = projection._local, projection._basis, projection._prior
    information = np.block([[prior.local.toarray(), prior.cross], [prior.cross.T, prior.shared]])
    values, vectors = np.linalg.eigh(information)
    known = np.sqrt(np.clip(values, 0.0, None))[:, None] * vectors.T
    return np.vstack([np.vstack([local.toarray(), base]).T, known])


def whitened(projection: NuisanceProjector, signals: FloatArray) -> WhitenedSignals:
    """Take arbitrary values as whitened signals."""
    return WhitenedSignals.of_dense(signals, projection.channel_lengths)


def test_what_is_left_is_the_residual_of_least_squares(projection: NuisanceProjector) -> None:
    design = dense(projection)
    signal = np.random.default_rng(3).standard_normal((2, projection.residual.size))
    rows = design.shape[0] - signal.shape[1]
    padded = np.hstack([signal, np.zeros((2, rows))]).T
    best = np.linalg.lstsq(design, padded, rcond=1e-12)[0]
    left = padded - design @ best
    looked = projection.score_statistics(whitened(projection, signal))
    assert looked.information == pytest.approx(left.T @ left, rel=1e-6, abs=1e-4)
    assert projection.orthogonal_component(signal[0]) == pytest.approx(
        left[: signal.shape[1], 0], abs=1e-6
    )


def test_scores_are_standard_normal_in_noise(projection: NuisanceProjector) -> None:
    signal = np.random.default_rng(4).standard_normal((60, projection.residual.size))
    looked = projection.score_statistics(whitened(projection, signal))
    z = looked.score / np.sqrt(np.diag(looked.information))
    assert abs(np.mean(z)) < 4.0 / np.sqrt(60)
    assert np.std(z) == pytest.approx(1.0, abs=0.4)


def test_what_the_fit_follows_vanishes(projection: NuisanceProjector) -> None:
    basis = projection._basis[:12]  # gain and bias have next to no prior
    looked = projection.score_statistics(whitened(projection, basis))
    assert np.diag(looked.information) == pytest.approx(0.0, abs=1e-3 * looked.energy.max())


def test_whitening_is_one_signal_and_one_axis_at_a_time(projection: NuisanceProjector) -> None:
    blocks = projection.states[0].block_count
    signals = np.random.default_rng(5).standard_normal((4, blocks, 3))
    signals[1, :, 0] = signals[2] = 0.0
    before = signals.copy()
    together = projection.evaluate_signals(lambda scene: signals).dense()
    assert np.array_equal(signals, before)
    for signal, white in zip(signals, together, strict=True):
        sums = projection.evaluate_signals(partial(_apart, signal)).dense().sum(axis=0)
        assert white == pytest.approx(sums, rel=1e-9, abs=1e-9)
    assert not together[2].any()


def _as_given(signals: Signals, _: SignalState) -> Signals:
    return signals


def _apart(signal: FloatArray, scene: SignalState) -> FloatArray:
    """Return a signal's three axes as three signals."""
    separate = np.zeros((3, scene.block_count, 3))
    for axis in range(3):
        separate[axis, :, axis] = signal[:, axis]
    return separate


def test_many_signals_say_what_each_says_alone(projection: NuisanceProjector) -> None:
    signals = np.random.default_rng(6).standard_normal((25, projection.residual.size))
    together = projection.score_statistics(whitened(projection, signals))
    for k in (0, 11, 24):
        alone = projection.score_statistics(whitened(projection, signals[k : k + 1]))
        assert together.subset([k]).information == pytest.approx(alone.information, rel=1e-6)
        assert together.score[k] == pytest.approx(float(alone.score[0]), rel=1e-6)
        assert together.absorbed[k] == pytest.approx(alone.absorbed[0], rel=1e-6, abs=1e-12)


def test_signals_keep_their_order(projection: NuisanceProjector) -> None:
    blocks = projection.states[0].block_count
    signals = np.random.default_rng(7).standard_normal((5, blocks, 3))
    signals[0, :, 2] = signals[3, :, :2] = 0.0
    groups = [
        projection.evaluate_signals(partial(_as_given, signals[group]))
        for group in ([0, 1], [2, 3, 4])
    ]
    joined = join_signals(groups)
    dense = np.concatenate([group.dense() for group in groups])
    assert np.array_equal(joined.dense(), dense)
    assert joined.size == 2 * blocks + 3 * blocks + 3 * blocks + blocks + 3 * blocks


def test_signals_that_are_whitened_together_have_single_precision(
    projection: NuisanceProjector,
) -> None:
    blocks = projection.states[0].block_count
    signals = 1.0 + np.random.default_rng(8).standard_normal((6, blocks, 3)).cumsum(axis=1)
    functions = [partial(_as_given, signals[:4]), partial(_as_given, signals[4:])]
    together = projection.evaluate_together(functions, len(signals))
    exact = projection.evaluate_signals(partial(_as_given, signals))
    assert all(channel.rows.dtype == np.float32 for channel in together.channels)
    looked, expected = (projection.score_statistics(white) for white in (together, exact))
    assert looked.score == pytest.approx(expected.score, rel=1e-5)
    assert looked.information == pytest.approx(
        expected.information, abs=1e-5 * float(np.diag(expected.information).min())
    )


@pytest.mark.long
def test_biases_of_each_axis_are_whitened_as_dense_signals(projection: NuisanceProjector) -> None:
    blocks = projection.states[0].block_count
    biases = AxisBiases(np.random.default_rng(8).standard_normal((10, blocks)))
    dense = dense_signals(biases)
    signals = [projection.evaluate_signals(partial(_as_given, s)) for s in (biases, dense)]
    assert signals[0].dense() == pytest.approx(signals[1].dense(), rel=1e-9, abs=1e-12)
