"""What a prior along unobservable directions does to S, T and M beyond first order."""

import numpy as np
import pytest
from scipy.stats import binomtest
from tests.bench.accuracy.board import factors as other_factors

from gyrorig_solver.estimate import analyse_observability, derive_parameters, propagate_to_factors
from gyrorig_solver.estimate.derived_parameters import DerivedParameters
from gyrorig_solver.estimate.observability import BIAS_NAMES, prior_std
from gyrorig_solver.model import FACTOR_NAMES, GAIN_NAMES, factor_jacobian, factorise
from gyrorig_solver.model.gain_matrix import factorise_near, rotation_matrix

NAMES = (*GAIN_NAMES, *BIAS_NAMES)
NOMINAL = np.concatenate([np.eye(3).ravel(), np.zeros(3)])
PRIOR = prior_std(NAMES)
TYPICAL = np.full(12, 0.1)
WORDS = {"x": "move tilt", "y": "sweep pan at two tilts", "z": "move pan"}


def information(std: np.ndarray, hidden: str = "") -> np.ndarray:
    """Return the information of independent parameters; whole columns of the gain are hidden."""
    shown = [name.startswith("bias") or name[-1] not in hidden for name in NAMES]
    return np.diag(np.where(shown, std**-2.0, 0.0))


def derived(
    estimate: np.ndarray, of_data: np.ndarray, words: dict[str, str] = WORDS
) -> DerivedParameters:
    return derive_parameters(estimate, NAMES, analyse_observability(of_data, NAMES), words)


def test_a_hidden_column_makes_null_what_depends_on_its_squares_and_products() -> None:
    """At the nominal gain no first derivative says so: scale.x = |row x|, T_zx = row z . row x."""
    analysis = analyse_observability(information(np.full(12, 3e-4), "y"), NAMES)
    factors = propagate_to_factors(NOMINAL, analysis.covariance, analysis.unobservable_covariance)
    first_order = factors.jacobian @ analysis.unobservable_covariance @ factors.jacobian.T
    second = dict(zip(FACTOR_NAMES, np.diag(factors.prior), strict=False))
    before = dict(zip(FACTOR_NAMES, np.diag(first_order), strict=False))
    # g = 0.1 z: E (g^2/2)^2 = 3/4 g^4, E (g g')^2 = g^4, with terms of g^6 beside it.
    assert before["scale.x"] == pytest.approx(0.0, abs=1e-20)
    assert second["scale.x"] == pytest.approx(0.75e-4, rel=0.05)
    assert before["nonorthogonality.zx"] == pytest.approx(0.0, abs=1e-20)
    assert second["nonorthogonality.zx"] == pytest.approx(1e-4, rel=0.1)
    report = derived(NOMINAL, information(np.full(12, 3e-4), "y")).observability
    assert {"scale.x", "nonorthogonality.zx"} <= set(report.unobservable)
    assert report.rank == 9
    assert report.reasons == ("column y of the gain: sweep pan at two tilts",)


def test_a_hidden_column_hides_nothing_that_data_know_less_well() -> None:
    """The row's length is known to 5 % only; the hidden entry changes it by less."""
    std = np.full(12, 3e-4)
    std[0] = 0.04
    factors = derived(NOMINAL, information(std, "y"))
    assert "scale.x" in factors.order
    assert factors.std["scale.x"] ** 2 == pytest.approx(0.04**2 + 0.75e-4, rel=0.01)
    assert np.linalg.eigvalsh(factors.covariance).min() > 0.0


def test_nothing_changes_where_all_is_observed() -> None:
    gain = rotation_matrix(np.array([0.05, -0.04, 0.2])) * np.array([[1.02], [0.97], [1.05]])
    estimate = np.concatenate([gain.ravel(), [0.01, 0.02, 0.03]])
    rng = np.random.default_rng(4)
    mixing = rng.normal(size=(12, 12))
    of_data = 1e6 * (mixing @ mixing.T + np.eye(12))
    analysis = analyse_observability(of_data, NAMES)
    assert analysis.rank == 12
    factors = propagate_to_factors(estimate, analysis.covariance, analysis.unobservable_covariance)
    jacobian = np.eye(12)
    jacobian[:9, :9] = factor_jacobian(factorise(gain))
    assert np.array_equal(factors.data, jacobian @ analysis.covariance @ jacobian.T)
    assert np.array_equal(factors.prior, np.zeros((12, 12)))
    assert np.array_equal(factors.values[:9], factorise(gain).as_vector())


@pytest.mark.parametrize("hidden", ["x", "y", "z", "xy"])
def test_the_quadrature_agrees_with_random_draws(hidden: str) -> None:
    """Against 20 000 draws of the prior and the bench's own factorisation."""
    rng = np.random.default_rng(len(hidden))
    gain = np.eye(3) + 0.05 * rng.normal(size=(3, 3))
    estimate = np.concatenate([gain.ravel(), np.zeros(3)])
    analysis = analyse_observability(information(np.full(12, 1e-5), hidden), NAMES)
    factors = propagate_to_factors(estimate, analysis.covariance, analysis.unobservable_covariance)
    shift = np.zeros((20_000, 3, 3))
    shift[:, :, ["xyz".index(k) for k in hidden]] = 0.1 * rng.normal(size=(20_000, 3, len(hidden)))
    change = np.array([other_factors(gain + step) for step in shift]) - other_factors(gain)
    drawn = np.mean(change**2, axis=0)
    quadrature = np.diag(factors.prior)[:9]
    # Beyond the quadratic part a tenth of prior leaves some per cent; draws leave 2 %.
    assert np.all((quadrature > 0.75 * drawn - 1e-9) & (quadrature < 1.25 * drawn + 1e-9))


def test_intervals_hold_beside_a_hidden_column() -> None:
    """Gains as the prior says, column y hidden, data of any quality: every number covers 95 %."""
    rng = np.random.default_rng(7)
    covered: dict[str, list[bool]] = {}
    for _ in range(500):
        std = np.exp(rng.uniform(np.log(1e-4), np.log(4e-2), size=12))
        of_data = information(std, "y")
        analysis = analyse_observability(of_data, NAMES)
        truth = NOMINAL + PRIOR * rng.normal(size=12)
        hidden = np.diag(analysis.unobservable_covariance) > 0.0
        estimate = np.where(hidden, NOMINAL, truth + std * rng.normal(size=12))
        factors = derived(estimate, of_data)
        true = np.concatenate([other_factors(truth[:9].reshape(3, 3)), truth[9:]])
        for name, value in zip((*FACTOR_NAMES, *BIAS_NAMES), true, strict=True):
            if name in factors.order:
                inside = abs(factors.values[name] - value) <= 1.96 * factors.std[name]
                covered.setdefault(name, []).append(bool(inside))
    assert {"scale.x", "scale.z", "nonorthogonality.zx", *BIAS_NAMES} <= set(covered)
    for name, inside in covered.items():
        low = binomtest(sum(inside), len(inside)).proportion_ci(0.999).high
        assert low >= 0.95, f"{name}: {sum(inside)} of {len(inside)}"


def test_numbers_of_good_data_beside_a_hidden_column_are_null() -> None:
    """Data as good as the paper's program gives: no factor survives on an ordinary board."""
    rng = np.random.default_rng(8)
    for _ in range(20):
        estimate = NOMINAL.copy()
        estimate[[0, 2, 3, 5, 6, 8]] += 0.03 * rng.normal(size=6)
        factors = derived(estimate, information(np.full(12, 2e-4), "y"))
        assert {"scale.x", "nonorthogonality.zx"} <= set(factors.observability.unobservable)
        assert set(BIAS_NAMES) <= set(factors.order)
        assert np.isfinite(factors.gain[:, [0, 2]]).all()


def test_every_null_factor_has_a_reason() -> None:
    """A direction spread over all nine entries has less than a tenth of prior in each of many."""
    spread = np.concatenate([np.ones(9), np.zeros(3)]) / 3.0
    keep = np.eye(12) - np.outer(spread, spread)
    of_data = keep @ np.diag((1e-3 * PRIOR) ** -2.0) @ keep
    of_data += 1e-6 * np.eye(12)
    observability = derived(NOMINAL, of_data).observability
    assert observability.rank == 11
    assert any(name in FACTOR_NAMES for name in observability.unobservable)
    assert observability.reasons


def test_a_board_that_is_turned_by_a_right_angle_has_null_factors_not_a_fault() -> None:
    """With its hidden column at the nominal value the gain is singular."""
    gain = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    gain[:, 1] = [0.0, 1.0, 0.0]
    factors = derived(
        np.concatenate([gain.ravel(), np.zeros(3)]), information(np.full(12, 1e-4), "y")
    )
    assert set(FACTOR_NAMES) <= set(factors.observability.unobservable)
    assert factors.order == BIAS_NAMES
    assert np.isfinite(factors.covariance).all()
    assert factors.observability.reasons == ("column y of the gain: sweep pan at two tilts",)


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_many_factorisations_agree_with_one(mirror: float) -> None:
    rng = np.random.default_rng(2)
    gain = np.diag([1.0, mirror, 1.0]) @ rotation_matrix(np.array([0.3, -0.2, 0.5]))
    near = factorise(gain)
    gains = gain + 0.05 * rng.normal(size=(50, 3, 3))
    each = np.array([factorise(gain_matrix).as_vector() for gain_matrix in gains])
    assert np.allclose(factorise_near(gains, near), each, atol=1e-14)
    assert np.isnan(factorise_near(-gains, near)).all()  # of the other handedness
    assert np.isnan(factorise_near(np.zeros((1, 3, 3)), near)).all()
