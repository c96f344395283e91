"""A scatter that only one axis makes, or low speed alone, is no jitter of the samples."""

import numpy as np

from gyrorig_solver.discover.checks.jitter_modulation import BlockMotion, find_modulation

BLOCKS, EACH = 120, 48


def _drawn(seed: int, grows: str | None) -> float:
    """Return the chance of what speaks most against jitter, of a scatter that is drawn."""
    rng = np.random.default_rng(seed)
    where = BlockMotion(
        rng.choice([-1.0, 1.0], BLOCKS), rng.uniform(0.0, 1.5, BLOCKS), np.arange(BLOCKS) / 3.0
    )
    shape = np.exp(rng.normal(0.0, 1.0, (BLOCKS, EACH)))
    shapes = {
        "axis": where.axis_balance > 0.0,
        "slow": where.speed < 0.5,
        "time": where.time_s > 20.0,
    }
    share = np.ones(BLOCKS) if grows is None else shapes[grows] * 1.0
    variance = 1.0 + 0.2 * share[:, None] * shape
    swell = find_modulation(
        rng.normal(0.0, np.sqrt(variance)) ** 2, shape, 0.2 * share.mean(), where
    )
    assert swell is not None
    return swell.p_value


def test_jitter_is_the_same_whatever_moves() -> None:
    chances = np.array([_drawn(seed, None) for seed in range(60)])
    assert np.sum(chances < 0.05) <= 8
    assert chances.min() > 1e-4


def test_what_one_axis_does_is_none() -> None:
    assert max(_drawn(seed, "axis") for seed in range(5)) < 1e-5


def test_what_low_speed_or_a_part_of_the_time_does_is_none() -> None:
    assert max(_drawn(seed, "slow") for seed in range(5)) < 1e-5
    assert max(_drawn(seed, "time") for seed in range(5)) < 1e-5
