"""The latency of the host in an exchange, against drawn latencies and the integral of a density."""

import numpy as np
import pytest
from scipy import stats

from gyrorig_protocol.twin import Scalar, TwinLink, TwinUnit
from gyrorig_solver.twin.host_latency import (
    HostFloor,
    HostLatency,
    median_derivatives,
    median_of_sum,
)
from gyrorig_solver.twin.joint_covariance import LATENCIES, latency_covariance

MEANS = [(3e-4, 1e-4), (1e-4, 3e-4), (3e-4, 3e-4), (3e-4, 3.0001e-4), (3e-4, 1e-9)]


@pytest.mark.parametrize(("mean", "other"), MEANS)
def test_half_of_the_drawn_sums_are_below_the_median(mean: float, other: float) -> None:
    rng = np.random.default_rng(1)
    draws = rng.exponential(mean, 100_000) + rng.exponential(other, 100_000)
    below = int((draws < median_of_sum(mean, other)).sum())
    assert stats.binomtest(below, draws.size).pvalue > 1e-3


def test_the_median_of_equal_means_is_that_of_a_gamma_distribution() -> None:
    assert median_of_sum(2.0, 2.0) == pytest.approx(stats.gamma(2.0, scale=2.0).median())


def test_the_median_of_one_variable_is_that_of_an_exponential() -> None:
    assert median_of_sum(0.0, 2.0) == pytest.approx(2.0 * np.log(2.0))
    assert median_of_sum(0.0, 0.0) == 0.0


@pytest.mark.parametrize(("mean", "other"), MEANS[:4])
def test_the_derivatives_give_the_median_of_scaled_means(mean: float, other: float) -> None:
    # The median is homogeneous of degree 1 (Euler): m = mean dm/dmean + other dm/dother.
    by_mean, by_other = median_derivatives(mean, other)
    assert mean * by_mean + other * by_other == pytest.approx(median_of_sum(mean, other), rel=2e-3)


def test_draws_keep_the_median_of_the_replies() -> None:
    """Whatever jitter a draw has, its replies take as long as the measured ones."""

    def latency(value: float, std: float) -> Scalar:
        return Scalar(value, std, "s", "recording")

    host = HostLatency(1.1e-4, 0.0, 3e-4, 5e-6, 1e-4, 2.5e-5)
    reply_std_s = 4e-6
    answer_s = 5e-3
    link = TwinLink(
        floor=latency(5.5e-5, 3e-5),
        write_floor=latency(5.5e-5, 3e-5),
        jitter=latency(3e-4, 5e-6),
        write_jitter=latency(1e-4, 2.5e-5),
    )
    std_s = float(np.hypot(reply_std_s, host.exchange_std_s))
    joint = latency_covariance(TwinUnit(answer_time=latency(answer_s, std_s)), link)
    assert joint is not None
    assert joint.names == LATENCIES
    assert np.sqrt(joint.matrix[-1, -1]) == pytest.approx(std_s)
    means = [5.5e-5, 5.5e-5, 3e-4, 1e-4, answer_s]
    draws = np.random.default_rng(2).multivariate_normal(means, joint.matrix, 4000)
    replies_s = [
        answer + floor + write_floor + median_of_sum(jitter, max(write_jitter, 0.0))
        for floor, write_floor, jitter, write_jitter, answer in draws
    ]
    assert np.mean(replies_s) == pytest.approx(answer_s + host.exchange_s, abs=1e-6)
    assert np.std(replies_s) == pytest.approx(reply_std_s, rel=0.1)
    assert np.std(draws[:, -1]) > 4.0 * reply_std_s


@pytest.mark.parametrize(("write_jitter_s", "count"), [(1e-4, 100), (1e-4, 650), (3e-4, 200)])
def test_the_floor_is_below_the_shortest_exchange(write_jitter_s: float, count: int) -> None:
    """Against drawn exchanges: without the bias, floor and jitter are right on average."""
    rng = np.random.default_rng(3)
    jitter_s, floors_s = 3e-4, 1.1e-4
    estimates = []
    for _ in range(2000):
        latency_s = rng.exponential(jitter_s, count) + rng.exponential(write_jitter_s, count)
        shortest_s = float(latency_s.min())
        excess_s = float(latency_s.mean()) - shortest_s
        floor = HostFloor((floors_s + shortest_s) / 2.0, 3e-5, excess_s, 2e-5, count)
        right = floor.without_bias(jitter_s)
        estimates.append((2.0 * right.floor_s, right.excess_s - jitter_s, shortest_s))
    floor_s, write_s, bias_s = np.mean(estimates, axis=0)
    assert abs(floor_s - floors_s) < 0.2 * bias_s
    assert write_s == pytest.approx(write_jitter_s, rel=0.05)


def test_the_floor_is_not_negative() -> None:
    assert HostFloor(1e-6, 1e-6, 9e-4, 1e-5, 50).without_bias(3e-4).floor_s == 0.0
