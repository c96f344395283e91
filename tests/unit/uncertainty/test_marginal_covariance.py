"""The marginalised causes against dense linear algebra of the whole problem."""

import numpy as np
import pytest

from gyrorig_solver.uncertainty.marginal_covariance import MarginalCauses

PARAMETERS, CAUSES, SAMPLES = 4, 6, 60


class Toy:
    """A linear problem: parameters without a prior, causes with a unit prior, white noise."""

    def __init__(self, seed: int) -> None:
        generator = np.random.default_rng(seed)
        self.design = generator.standard_normal((SAMPLES, PARAMETERS))
        self.causes = generator.standard_normal((SAMPLES, CAUSES)) * 10.0 ** generator.uniform(
            -3.0, 1.0, CAUSES
        )
        self.data = generator.standard_normal(SAMPLES) + self.causes @ generator.standard_normal(
            CAUSES
        )

    @property
    def fit(self) -> np.ndarray:
        """The least-squares estimate without the causes."""
        return np.asarray(np.linalg.lstsq(self.design, self.data, rcond=None)[0])

    def marginal(self) -> MarginalCauses:
        """The causes' information beside the parameters, as a projector gives it."""
        pseudo_inverse = np.linalg.pinv(self.design)
        left = self.causes - self.design @ (pseudo_inverse @ self.causes)
        residual = self.data - self.design @ self.fit
        return MarginalCauses.of(left.T @ left, left.T @ residual, (pseudo_inverse @ self.causes).T)

    def ridge(self) -> tuple[np.ndarray, np.ndarray]:
        """Estimate and covariance of the parameters, all fitted at once with the priors."""
        whole = np.hstack([self.design, self.causes])
        prior = np.diag([0.0] * PARAMETERS + [1.0] * CAUSES)
        covariance = np.linalg.inv(whole.T @ whole + prior)
        estimate = covariance @ whole.T @ self.data
        return estimate[:PARAMETERS], covariance[:PARAMETERS, :PARAMETERS]


@pytest.mark.parametrize("seed", range(5))
def test_the_covariance_is_that_of_a_ridge_fit(seed: int) -> None:
    toy = Toy(seed)
    noise_only = np.linalg.inv(toy.design.T @ toy.design)
    assert noise_only + toy.marginal().parameter_covariance == pytest.approx(
        toy.ridge()[1], rel=1e-9
    )


@pytest.mark.parametrize("seed", range(5))
def test_the_expected_error_leads_to_the_ridge_estimate(seed: int) -> None:
    toy = Toy(seed)
    assert toy.fit - toy.marginal().expected_error == pytest.approx(toy.ridge()[0], rel=1e-9)


def test_an_excluded_cause_adds_nothing() -> None:
    shown = MarginalCauses.of(np.array([[1e12]]), np.zeros(1), np.array([[3.0, -2.0]]))
    assert np.diag(shown.parameter_covariance) == pytest.approx(0.0, abs=1e-11)


def test_an_unobservable_cause_adds_its_prior() -> None:
    hidden = MarginalCauses.of(np.zeros((1, 1)), np.zeros(1), np.array([[3.0, -2.0]]))
    assert np.diag(hidden.parameter_covariance) == pytest.approx([9.0, 4.0])


def test_rounding_below_zero_does_not_add_more_than_the_prior() -> None:
    hidden = MarginalCauses.of(np.array([[-1e-3]]), np.zeros(1), np.array([[2.0]]))
    assert hidden.parameter_covariance == pytest.approx(4.0)


def test_causes_that_only_together_are_seen_are_not_added_up() -> None:
    """The data show the sum of two sizes, and the parameter moves by their sum."""
    information = 1e8 * np.ones((2, 2))
    alike = MarginalCauses.of(information, np.zeros(2), np.array([[1.0], [1.0]]))
    assert alike.parameter_covariance == pytest.approx(0.0, abs=1e-7)
    opposite = MarginalCauses.of(information, np.zeros(2), np.array([[1.0], [-1.0]]))
    assert opposite.parameter_covariance == pytest.approx(2.0, rel=1e-6)


def mean_square(marginal: MarginalCauses) -> np.ndarray:
    return np.asarray(np.diag(marginal.parameter_covariance) + marginal.expected_error**2)


@pytest.mark.parametrize("seed", range(20))
def test_the_part_of_a_group_is_what_a_fit_without_it_saves(seed: int) -> None:
    toy = Toy(seed)
    whole = toy.marginal()
    group = np.array([1, 4])
    toy.causes = np.delete(toy.causes, group, axis=1)
    saved = mean_square(whole) - mean_square(toy.marginal())
    part = whole.mean_square_without(group)
    assert part == pytest.approx(np.clip(saved, 0.0, None), rel=1e-6, abs=1e-12)
    assert np.all(part <= mean_square(whole) * (1.0 + 1e-9))
