"""Intervals of errors by causes that are present or absent, against sums and draws."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.uncertainty.mixture_interval import (
    ErrorMixture,
    UncertainSizes,
    error_mixture,
)

TWO_STD = float(norm.cdf(2.0) - norm.cdf(-2.0))
CAUSE = np.array([0, 0, 0, 1, 2, 2, 3, 4])  # of each size


def sizes_of(
    probability: FloatArray, seed: int = 1, cause: IntArray = CAUSE, strength: float = 2.0
) -> UncertainSizes:
    """Return causes that resemble each other, with a score drawn at random; two parameters."""
    generator = np.random.default_rng(seed)
    count = cause.size
    effects = strength * generator.standard_normal((count + 2, count)) / np.sqrt(count)
    effects[:, -1] = effects[:, 0] + 0.1 * effects[:, -1]  # hardly apart from another cause
    return UncertainSizes(
        information=effects.T @ effects,
        score=effects.T @ generator.standard_normal(count + 2)
        + effects.T @ effects[:, 0] * 3.0 * (seed % 2),
        influence=generator.standard_normal((count, 2)),
        cause=cause,
        probability=probability,
        prior_covariance=np.eye(count),
        prior_mean=np.zeros(count),
    )


def all_configurations(sizes: UncertainSizes) -> ErrorMixture:
    """Return the sum over all sets of causes, each from its formula."""
    weights, means, variances = [], [], []
    for present in itertools.product([False, True], repeat=sizes.probability.size):
        chance = np.prod(np.where(present, sizes.probability, 1.0 - sizes.probability))
        if chance == 0.0:
            continue
        on = np.flatnonzero(np.array(present)[sizes.cause])
        inner = sizes.information[np.ix_(on, on)] + np.eye(on.size)
        covariance, score = np.linalg.inv(inner), sizes.score[on]
        evidence = 0.5 * score @ covariance @ score - 0.5 * np.linalg.slogdet(inner)[1]
        weights.append(np.log(chance) + evidence)
        means.append(score @ covariance @ sizes.influence[on])
        variances.append(
            np.einsum("kq,kl,lq->q", sizes.influence[on], covariance, sizes.influence[on])
        )
    weight = np.exp(np.array(weights) - max(weights))
    return ErrorMixture(weight / weight.sum(), np.stack(means), np.stack(variances))


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("chance", [0.05, 0.5])
def test_the_mixture_is_the_sum_over_all_configurations(seed: int, chance: float) -> None:
    sizes = sizes_of(np.array([chance, chance, 1.0, chance, chance]), seed)
    noise = np.array([0.1, 0.5])
    summed = error_mixture(sizes).expanded_uncertainty(noise, TWO_STD)
    exact = all_configurations(sizes).expanded_uncertainty(noise, TWO_STD)
    assert summed == pytest.approx(exact, rel=2e-3, abs=2e-3)


@pytest.mark.parametrize("seed", range(4))
def test_certain_causes_give_a_normal_distribution(seed: int) -> None:
    sizes = sizes_of(np.ones(5), seed)
    covariance = np.linalg.inv(sizes.information + np.eye(CAUSE.size))
    mean = sizes.score @ covariance @ sizes.influence
    variance = np.einsum("kq,kl,lq->q", sizes.influence, covariance, sizes.influence)
    noise = np.array([0.2, np.nan])
    expanded = error_mixture(sizes).expanded_uncertainty(noise, TWO_STD)
    std = np.sqrt(variance[0] + noise[0] ** 2)
    inside = norm.cdf(expanded[0], mean[0], std) - norm.cdf(-expanded[0], mean[0], std)
    assert inside == pytest.approx(TWO_STD, rel=1e-8)
    assert np.isnan(expanded[1])


def test_certain_causes_without_a_score_give_two_standard_uncertainties() -> None:
    sizes = replace(sizes_of(np.ones(5)), score=np.zeros(CAUSE.size))
    covariance = np.linalg.inv(sizes.information + np.eye(CAUSE.size))
    variance = np.einsum("kq,kl,lq->q", sizes.influence, covariance, sizes.influence)
    noise = np.array([0.2, 0.4])
    expanded = error_mixture(sizes).expanded_uncertainty(noise, TWO_STD)
    assert expanded == pytest.approx(2.0 * np.sqrt(variance + noise**2), rel=1e-8)


def test_a_probability_next_to_one_is_nearly_certain() -> None:
    noise = np.array([0.2, 0.2])
    nearly = error_mixture(sizes_of(np.full(5, 1.0 - 1e-9))).expanded_uncertainty(noise, TWO_STD)
    certain = error_mixture(sizes_of(np.ones(5))).expanded_uncertainty(noise, TWO_STD)
    assert nearly == pytest.approx(certain, rel=1e-6)


def test_certain_causes_have_their_own_prior() -> None:
    """Two certain sizes: a general prior is the unit prior of other sizes and another score."""
    generator = np.random.default_rng(4)
    root, mean = generator.standard_normal((2, 2)), generator.standard_normal(2)
    effects = generator.standard_normal((6, 2))
    influence, data = generator.standard_normal((2, 2)), generator.standard_normal(6)
    made = error_mixture(
        UncertainSizes(
            effects.T @ effects, effects.T @ data, influence, np.array([0, 0]), np.ones(1),
            root @ root.T, mean,
        )
    )  # fmt: skip
    design = effects @ root  # the sizes are mean + root @ others, others N(0, 1)
    covariance = np.linalg.inv(design.T @ design + np.eye(2))
    others = covariance @ design.T @ (data - effects @ mean)
    assert made.mean[0] == pytest.approx((mean + root @ others) @ influence)
    assert made.variance[0] == pytest.approx(
        np.diag(influence.T @ root @ covariance @ root.T @ influence)
    )


def test_intervals_agree_with_weighted_draws() -> None:
    """Sizes drawn from the prior, weighted by the likelihood of the data."""
    sizes = sizes_of(np.array([0.2, 0.3, 0.1, 0.4, 0.3]), seed=2, strength=1.0)
    noise = np.array([0.3, 0.6])
    generator = np.random.default_rng(9)
    count = 400_000
    present = generator.uniform(size=(count, 5)) < sizes.probability
    drawn = generator.standard_normal((count, CAUSE.size)) * present[:, CAUSE]
    log_weight = drawn @ sizes.score - 0.5 * np.sum((drawn @ sizes.information) * drawn, axis=1)
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    error = drawn @ sizes.influence + noise * generator.standard_normal((count, 2))
    expanded = error_mixture(sizes).expanded_uncertainty(noise, TWO_STD)
    effective = 1.0 / np.sum(weight**2)
    outside = weight @ (np.abs(error) > expanded)
    tail = 1.0 - TWO_STD
    assert outside == pytest.approx([tail] * 2, abs=4.0 * np.sqrt(tail / effective))


def test_intervals_hold_as_often_as_stated() -> None:
    """Causes, sizes and data drawn from the model: 300 rigs with two parameters."""
    probability = np.array([0.1, 0.2, 0.3, 0.1, 0.2])
    noise = np.array([0.05, 0.5])
    generator = np.random.default_rng(11)
    inside = []
    for _ in range(300):
        sizes = sizes_of(probability, seed=2)
        present = generator.uniform(size=5) < probability
        drawn = generator.standard_normal(CAUSE.size) * present[CAUSE]
        root = np.linalg.cholesky(sizes.information + 1e-12 * np.eye(CAUSE.size))
        score = sizes.information @ drawn + root @ generator.standard_normal(CAUSE.size)
        error = drawn @ sizes.influence + noise * generator.standard_normal(2)
        made = UncertainSizes(
            sizes.information, score, sizes.influence, CAUSE, probability,
            np.eye(CAUSE.size), np.zeros(CAUSE.size),
        )  # fmt: skip
        inside.append(np.abs(error) <= error_mixture(made).expanded_uncertainty(noise, TWO_STD))
    assert np.mean(inside, axis=0) == pytest.approx(TWO_STD, abs=4.0 * 0.012)


def unseen(probability: FloatArray, std: FloatArray) -> UncertainSizes:
    """Return causes that no data show, with one size each and one parameter."""
    count = probability.size
    return UncertainSizes(
        np.zeros((count, count)), np.zeros(count), std[:, None], np.arange(count), probability,
        np.eye(count), np.zeros(count),
    )  # fmt: skip


@pytest.mark.parametrize(("chance", "narrower"), [(0.02, True), (0.3, False)])
def test_an_unseen_cause_widens_the_interval_by_its_probability(
    chance: float, narrower: bool
) -> None:
    """The variance of a rare cause describes neither the rigs with it nor those without it."""
    mixture = error_mixture(unseen(np.array([chance]), np.array([10.0])))
    (expanded,) = mixture.expanded_uncertainty(np.ones(1), TWO_STD)
    outside = chance * 2.0 * norm.sf(expanded / np.hypot(10.0, 1.0))
    outside += (1.0 - chance) * 2.0 * norm.sf(expanded)
    assert outside == pytest.approx(1.0 - TWO_STD, rel=1e-6)
    assert bool(expanded < 2.0 * np.sqrt(1.0 + chance * 100.0)) is narrower


def test_many_unseen_causes_add_their_variances() -> None:
    chance, std = np.full(60, 0.5), np.full(60, 1.0)
    mixture = error_mixture(unseen(chance, std))
    assert mixture.weight.size <= 2**8
    (expanded,) = mixture.expanded_uncertainty(np.full(1, 1e-3), TWO_STD)
    assert expanded == pytest.approx(2.0 * np.sqrt(30.0), rel=0.01)


def test_strong_evidence_decides_between_causes() -> None:
    """A score that only one of two causes explains makes this one certain."""
    sizes = UncertainSizes(
        np.array([[400.0, 0.0], [0.0, 400.0]]), np.array([300.0, 0.0]), np.ones((2, 1)),
        np.array([0, 1]), np.array([0.05, 0.05]), np.eye(2), np.zeros(2),
    )  # fmt: skip
    (expanded,) = error_mixture(sizes).expanded_uncertainty(np.full(1, 0.01), TWO_STD)
    mean, std = 300.0 / 401.0, np.hypot(0.01, 1.0 / np.sqrt(401.0))
    assert expanded == pytest.approx(mean + norm.ppf(TWO_STD) * std, rel=0.02)


def test_rounding_below_zero_is_not_taken_for_information() -> None:
    """Large information on sizes that are nearly the same loses digits."""
    direction = np.array([[1e5, 1e5, 1e5 + 1e-6]])
    information = direction.T @ direction - 3.0 * np.eye(3)
    for probability in (0.3, 1.0):
        mixture = error_mixture(
            UncertainSizes(
                information, direction[0] * 0.2, np.ones((3, 1)), np.arange(3),
                np.full(3, probability), np.eye(3), np.zeros(3),
            )
        )  # fmt: skip
        assert np.all(mixture.variance >= 0.0)
        assert np.isfinite(mixture.expanded_uncertainty(np.ones(1), 0.95)).all()
