"""A fit combined with the posterior of its unit, against one dense Bayesian least-squares fit."""

from dataclasses import dataclass

import numpy as np
import pytest

from gyrorig_solver.data import FloatArray
from gyrorig_solver.uncertainty import UnitPosterior, default_settings
from gyrorig_solver.uncertainty.fit_linearisation import FitLinearisation
from gyrorig_solver.uncertainty.unit_marginals import UnitMarginals, unit_information
from gyrorig_solver.uncertainty.unit_values import table_covariance

SIZES = len(table_covariance(default_settings()))
FREE, FITTED, OTHER, KNOWN = 4, 2, 3, 2  # parameters; fitted sizes; causes; the unit's, left out
FITTED_POSITION, KNOWN_POSITION = [4, 7], [0, 9]


@dataclass(frozen=True)
class LinearModel:
    """y = J p + E f + B c + noise of variance one."""

    parameters: FloatArray  # (n, FREE + FITTED), the last ones of fitted sizes
    effects: FloatArray  # (n, OTHER + KNOWN)
    scale: FloatArray  # (OTHER + KNOWN,), of the sizes in `effects`

    def linearise(self, measured: FloatArray) -> FitLinearisation:
        """Return what a least-squares fit without the causes states."""
        covariance: FloatArray = np.asarray(np.linalg.inv(self.parameters.T @ self.parameters))
        estimate = covariance @ self.parameters.T @ measured
        absorbed = covariance @ self.parameters.T @ self.effects
        rest = self.effects - self.parameters @ absorbed
        positions = [-1] * OTHER + KNOWN_POSITION + FITTED_POSITION
        return FitLinearisation(
            information=rest.T @ rest,
            score=rest.T @ (measured - self.parameters @ estimate),
            influence=absorbed.T,
            covariance=covariance,
            prior_covariance=np.zeros_like(covariance),
            fitted=np.arange(FREE, FREE + FITTED),
            fitted_values=estimate[FREE:],
            unit_position=np.array(positions),
            unit_scale=np.concatenate([self.scale, np.full(FITTED, 0.5)]),
        )

    def estimate(self, measured: FloatArray) -> FloatArray:
        """Return the fit without the causes."""
        return np.asarray(np.linalg.lstsq(self.parameters, measured, rcond=None)[0])


@pytest.fixture(name="model")
def _model() -> LinearModel:
    generator = np.random.default_rng(3)
    parameters = generator.standard_normal((40, FREE + FITTED))
    effects = generator.standard_normal((40, OTHER + KNOWN))
    effects[:, :2] += parameters[:, :2]  # partly absorbed
    effects[:, 4] = parameters @ np.arange(1.0, 7.0)  # never visible
    return LinearModel(parameters, effects, np.array([1.0, 1.0, 1.0, 0.2, 0.3]))


@pytest.fixture(name="prior")
def _prior() -> UnitPosterior:
    generator = np.random.default_rng(5)
    root = 0.3 * generator.standard_normal((SIZES, SIZES))
    return UnitPosterior(0.4 * generator.standard_normal(SIZES), root @ root.T)


def dense(
    model: LinearModel, prior: UnitPosterior, measured: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return mean and covariance of (p, f, causes, the unit's sizes), all fitted with priors."""
    used = [*FITTED_POSITION, *KNOWN_POSITION]
    design = np.hstack(
        [model.parameters, model.effects[:, :OTHER], model.effects[:, OTHER:] / model.scale[OTHER:]]
    )
    unit = [*range(FREE, FREE + FITTED), *range(FREE + FITTED + OTHER, design.shape[1])]
    other = list(range(FREE + FITTED, FREE + FITTED + OTHER))
    information, score = design.T @ design, design.T @ measured
    precision = np.linalg.inv(prior.covariance[np.ix_(used, used)])
    information[np.ix_(unit, unit)] += precision
    score[unit] += precision @ prior.mean[used]
    information[other, other] += 1.0
    covariance = np.linalg.inv(information)
    return covariance @ score, covariance


def test_parameters_and_total_are_those_of_one_dense_fit(
    model: LinearModel, prior: UnitPosterior
) -> None:
    measured = np.random.default_rng(7).standard_normal(40) * 3.0
    marginals = UnitMarginals.of(model.linearise(measured), prior)
    mean, covariance = dense(model, prior, measured)
    count = FREE + FITTED
    stated = model.estimate(measured) + marginals.shift
    assert stated - marginals.expected_error == pytest.approx(mean[:count], abs=1e-9)
    assert marginals.total_covariance == pytest.approx(covariance[:count, :count], abs=1e-9)


def test_the_noise_part_is_how_the_stated_values_follow_the_data(
    model: LinearModel, prior: UnitPosterior
) -> None:
    def stated(measured: FloatArray) -> FloatArray:
        return model.estimate(measured) + UnitMarginals.of(model.linearise(measured), prior).shift

    origin = stated(np.zeros(40))
    response = np.column_stack([stated(row) - origin for row in np.eye(40)])
    marginals = UnitMarginals.of(model.linearise(np.zeros(40)), prior)
    assert marginals.noise_covariance == pytest.approx(response @ response.T, abs=1e-9)


def test_the_posterior_of_the_unit_is_that_of_one_dense_fit(
    model: LinearModel, prior: UnitPosterior
) -> None:
    measured = np.random.default_rng(8).standard_normal(40) * 3.0
    posterior = prior.updated(unit_information(model.linearise(measured), SIZES))
    mean, covariance = dense(model, prior, measured)
    rows = [*range(FREE, FREE + FITTED), *range(FREE + FITTED + OTHER, len(mean))]
    used = [*FITTED_POSITION, *KNOWN_POSITION]
    assert posterior.mean[used] == pytest.approx(mean[rows], abs=1e-9)
    assert posterior.covariance[np.ix_(used, used)] == pytest.approx(
        covariance[np.ix_(rows, rows)], abs=1e-9
    )


def test_two_recordings_in_any_order_give_the_same_posterior(
    model: LinearModel, prior: UnitPosterior
) -> None:
    first, second = (
        unit_information(model.linearise(np.random.default_rng(k).standard_normal(40)), SIZES)
        for k in (1, 2)
    )
    one_way, other_way = prior.updated(first).updated(second), prior.updated(second).updated(first)
    assert one_way.mean == pytest.approx(other_way.mean, abs=1e-9)
    assert one_way.covariance == pytest.approx(other_way.covariance, abs=1e-9)
    assert np.all(np.diag(one_way.covariance) <= np.diag(prior.covariance) + 1e-12)
    assert prior.entropy_gain(first) > 0.0


def test_an_old_posterior_widens_with_the_square_root_of_time() -> None:
    settings = default_settings()
    prior = UnitPosterior(np.zeros(SIZES), np.zeros((SIZES, SIZES)))
    after_four, after_sixteen = (
        np.sqrt(np.diag(prior.after(days, settings).covariance)) for days in (4.0, 16.0)
    )
    assert after_sixteen == pytest.approx(2.0 * after_four)
    assert after_four[0] == pytest.approx(2.0 * np.radians(0.001))
    assert np.all(after_four > 0.0)


def test_an_old_posterior_is_never_wider_than_the_table() -> None:
    """Before, a posterior of long ago gave larger uncertainties than none."""
    settings = default_settings()
    table = UnitPosterior.from_table(settings)
    stored = UnitPosterior(np.full(SIZES, 1e-3), 0.01 * table.covariance)
    year, century = (stored.after(days, settings) for days in (365.0, 36_500.0))
    ratio = np.diag(year.covariance) / np.diag(table.covariance)
    assert np.all(ratio <= 1.0 + 1e-12)
    assert 0 < np.isclose(ratio, 1.0).sum() < SIZES
    assert np.array_equal(np.isclose(year.mean, 0.0, atol=1e-15), np.isclose(ratio, 1.0))
    assert century.covariance == pytest.approx(table.covariance, abs=1e-15)
    assert century.mean == pytest.approx(0.0, abs=1e-15)


def test_what_is_known_of_a_sum_is_not_forgotten_with_its_parts() -> None:
    settings = default_settings()
    table = UnitPosterior.from_table(settings)
    covariance = table.covariance.copy()
    first, second = 9, 10  # two sizes with the same prior, whose sum was measured
    variance = table.covariance[first, first]
    assert variance == table.covariance[second, second]
    pair = np.array([[0.5, -0.5], [-0.5, 0.5]]) * variance
    covariance[np.ix_([first, second], [first, second])] = pair
    later = UnitPosterior(np.zeros(SIZES), covariance).after(30.0, settings)
    direction = np.zeros(SIZES)
    direction[[first, second]] = 1.0
    drift = 2.0 * 30.0 * np.radians(0.01) ** 2
    assert direction @ later.covariance @ direction == pytest.approx(drift)
