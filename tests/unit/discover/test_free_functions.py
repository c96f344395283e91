"""Free functions of a covariate: their chances in noise, their evidence, what they are."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tests.support.board_fits import fit_base_model

from gyrorig_solver.discover.checks import residual_dependence
from gyrorig_solver.discover.checks.residual_dependence import (
    VARIANCE_GRID,
    choose_detail,
    residual_dependence_tests,
    smooth_function_evidence,
)
from gyrorig_solver.discover.checks.smooth_alternatives import smooth_families
from gyrorig_solver.estimate import NuisanceProjector, ScoreStatistics

N, DRAWS = 200, 1500


def _looked(white: np.ndarray, residual: np.ndarray) -> ScoreStatistics:
    gram = white @ white.T
    return ScoreStatistics(gram, white @ residual, np.diag(gram).copy(), np.zeros((len(white), 1)))


@pytest.mark.parametrize("strong_signals", [0, 2])
def test_the_best_detail_is_judged_by_chance(strong_signals: int) -> None:
    rng = np.random.default_rng(11)
    detail = np.arange(1.0, 25.0)
    white = rng.standard_normal((strong_signals + detail.size, N))
    # What comes first is no surprise, however large it is.
    strong_part = rng.standard_normal(strong_signals) * 30.0 @ white[:strong_signals]
    p_values = []
    for _ in range(DRAWS):
        judged = choose_detail(
            _looked(white, rng.standard_normal(N) + strong_part), detail, strong_signals
        )
        assert judged is not None
        p_values.append(judged.p_value)
    # Three nested sets, paid for as if they were apart: never too often.
    for level in (0.1, 0.01):
        share = float(np.mean(np.array(p_values) < level))
        assert share < level + 3.5 * np.sqrt(level / DRAWS)
        assert share > level / 3.0


def test_a_smooth_function_is_found_by_its_few_degrees_of_freedom() -> None:
    rng = np.random.default_rng(12)
    detail = np.arange(1.0, 25.0)
    white = rng.standard_normal((detail.size, N))
    judged = choose_detail(_looked(white, 0.5 * white[1] + rng.standard_normal(N)), detail)
    assert judged is not None
    assert judged.degrees_of_freedom == 3


def test_evidence_is_the_ratio_of_two_normal_densities() -> None:
    rng = np.random.default_rng(13)
    detail = np.array([1.0, 2.0, 3.0, 4.0])
    white = rng.standard_normal((4, N))
    residual = rng.standard_normal(N) + 0.3 * white[0]
    looked = _looked(white, residual)
    width = 1.0 / (detail * np.sqrt(looked.energy))
    largest = float(np.linalg.eigvalsh(looked.information * np.outer(width, width)).max())
    nats = []
    for size in VARIANCE_GRID / largest:
        covariance = np.eye(N) + size * (white.T * width**2) @ white
        sign, log_det = np.linalg.slogdet(covariance)
        assert sign > 0.0
        likelihood = -0.5 * (log_det + residual @ np.linalg.solve(covariance, residual))
        nats.append(likelihood + 0.5 * residual @ residual)
    assert smooth_function_evidence(looked, detail) == pytest.approx(max(nats), abs=1e-6)


def test_the_right_one_of_two_alike_has_more_evidence() -> None:
    rng = np.random.default_rng(14)
    x = np.linspace(0.0, 1.0, N)
    y = x + 0.1 * np.sin(9.0 * x)
    detail = np.arange(1.0, 9.0)
    waves = [np.cos(np.pi * detail[:, None] * t / t.max()) for t in (x, y)]
    won = 0
    for _ in range(50):
        truth = 4.0 * rng.standard_normal(3) @ waves[0][1:4] + rng.standard_normal(N)
        first, second = (smooth_function_evidence(_looked(w, truth), detail) for w in waves)
        won += first > second
    assert won > 40


@pytest.fixture(scope="module")
def plain(hidden: Callable[..., Any]) -> NuisanceProjector:
    session = hidden(seed=7)
    return NuisanceProjector.at_fit(fit_base_model([session.recording], session.board))


def test_every_family_is_of_one_covariate_and_whole(plain: NuisanceProjector) -> None:
    every = list(smooth_families(plain.states))
    assert {test.covariate for test in every} == {
        "time", "bias_time", "speed", "own_rate", "pan_angle", "tilt_angle", "bias_pan",
        "bias_tilt", "pan_transient", "tilt_transient", "move_gain", "move_delay",
    }  # fmt: skip
    for test in every:
        white = test.whitened(plain).dense()
        assert white.shape == (test.detail.size, plain.residual.size)
        assert np.isfinite(white).all()
        assert test.detail.min() >= 1.0


def test_noise_depends_on_nothing(plain: NuisanceProjector) -> None:
    tests = residual_dependence_tests(plain)
    assert min(test.p_value for test in tests) > 0.01
    assert max(test.log_evidence for test in tests) < 5.0


def test_the_first_look_at_moves_resembles_the_exact_one(plain: NuisanceProjector) -> None:
    looked_at = 0
    for family in smooth_families(plain.states):
        screened = family.screen(plain)
        if screened is None:
            continue
        looked_at += 1
        exact = family.statistics(plain)
        energy, exact_energy = np.diag(screened.information), np.diag(exact.information)
        tolerance = 0.01 if family.covariate == "move_delay" else 0.15
        assert energy == pytest.approx(exact_energy, rel=tolerance)
        deviation = (screened.score - exact.score) / np.sqrt(exact_energy)
        assert np.abs(deviation).max() < 0.5
    assert looked_at == 2


def test_a_stated_p_value_of_moves_is_of_the_exact_signals(
    plain: NuisanceProjector, monkeypatch: pytest.MonkeyPatch
) -> None:
    families = {family.description: family for family in smooth_families(plain.states)}
    monkeypatch.setattr(residual_dependence, "EXACT_BELOW_P", np.inf)
    stated = [test for test in residual_dependence_tests(plain) if test.covariate == "move_delay"]
    family = families[stated[0].description]
    exact = choose_detail(family.statistics(plain), family.detail)
    assert exact is not None
    assert stated[0].statistic == exact.statistic
