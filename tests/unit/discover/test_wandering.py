"""A bias that wanders is named as such, and what only made it seem to wander as what it is."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from tests.support.board_fits import explain_recordings, fit_base_model

from gyrorig_solver.discover.checks.random_walk import (
    detect_random_walk,
    has_jumps,
)
from gyrorig_solver.discover.checks.typical_noise import (
    has_typical_noise,
    limit_to_typical,
    measure_bias_walk,
)
from gyrorig_solver.discover.checks.walk_profile import (
    LEVEL_GRID_POINTS,
    MAX_LOG_LEVEL_SHIFT,
    TYPICAL_POWER_FACTOR,
    WalkProfile,
    add_profiles,
    profile_common_walks,
    profile_walks,
)
from gyrorig_solver.estimate import ConvergedFit, nominal_levels
from gyrorig_solver.numerics import chi2_quantile, chi2_upper_tail


@pytest.mark.long
def test_where_flicker_says_it_as_well_there_is_no_name(hidden: Callable[..., Any]) -> None:
    """Over 40 s the two are nearly alike: what is odd is told, and by what it depends on."""
    session = hidden("bias_random_walk:0.001")
    findings = explain_recordings([session.recording], session.board).findings
    assert findings.verdict == "unexplained"
    assert findings.unexplained is not None
    assert findings.unexplained.leading.covariate in ("bias_time", "wandering")
    assert not findings.causes


@pytest.mark.long
def test_over_longer_it_is_named(hidden: Callable[..., Any]) -> None:
    session = hidden("bias_random_walk:0.0003", program="survey-130")
    solution = fit_base_model([session.recording], session.board)
    cause = detect_random_walk(solution, tests=80)
    assert cause is not None
    assert cause.candidates == ("bias_random_walk",)
    assert all(0.0 < value.std < value.value for value in cause.values[:2])  # hardly any on z


@pytest.mark.long
def test_any_axis_might_have_been_the_one(hidden: Callable[..., Any]) -> None:
    """The walks of three axes are looked at: three chances to be odd."""
    session = hidden("bias_random_walk:0.0003", program="survey-130")
    dependence = measure_bias_walk(fit_base_model([session.recording], session.board))
    alone = chi2_upper_tail(dependence.statistic, dependence.degrees_of_freedom)
    assert 0.0 < alone < 0.1
    assert dependence.p_value == pytest.approx(min(1.0, 3.0 * alone), rel=1e-9, abs=0.0)


@pytest.mark.long
@pytest.mark.parametrize("flicker", [1.0, 2.7, 8.0])
def test_flicker_of_other_parts_is_no_random_walk(
    hidden: Callable[..., Any], flicker: float
) -> None:
    """Spectra of noise alone, 600 axes; the limit is that of a p-value of 0.2 %."""
    noises = noise_of_flicker(hidden, flicker, recordings=200)
    gains_nats = [profile.gain_nats for profile in profile_walks(noises)]
    limit_nats = 0.5 * chi2_quantile(0.004, 1)  # half of the gains are zero
    assert np.mean(np.array(gains_nats) > limit_nats) < 0.01


@pytest.mark.long
def test_many_recordings_are_no_more_degrees_of_freedom(hidden: Callable[..., Any]) -> None:
    """Before, the best gain of each recording was added, which one degree of freedom tested."""
    gains_nats = []
    for seed in range(20):
        noises = noise_of_flicker(hidden, 1.0, recordings=20, seed=seed)
        gains_nats += [profile.gain_nats for profile in profile_common_walks(noises)]
    assert np.mean(np.array(gains_nats) > 0.5 * chi2_quantile(0.05, 1)) < 0.05


def noise_of_flicker(
    hidden: Callable[..., Any], flicker: float, recordings: int, seed: int = 5
) -> ConvergedFit:
    """Return what a fit states of the noise of recordings without a random walk."""
    session = hidden(program="survey-130")
    solution = fit_base_model([session.recording], session.board)
    (noise,), (spectrum,) = solution.noises, solution.spectra
    levels = np.stack([nominal_levels(float(axis[0])) for axis in noise.levels])
    levels[:, 1] *= flicker**2
    density = spectrum.expected_density(replace(noise, levels=levels))
    rng = np.random.default_rng(seed)
    spectra = [
        replace(
            spectrum,
            density=density
            * rng.chisquare(spectrum.count[:, None], density.shape)
            / spectrum.count[:, None],
        )
        for _ in range(recordings)
    ]
    fitted = SimpleNamespace(
        spectra=spectra, noises=[replace(noise, levels=levels) for _ in spectra]
    )
    return cast("ConvergedFit", fitted)


def test_leaps_are_no_random_walk() -> None:
    """Between two values, here for 8 s on average; a walk of the same size does not leap."""
    rng = np.random.default_rng(3)
    rate_hz, n = 100.0, 13_000
    noise = 4e-3 * rng.standard_normal((n, 1))
    sides = np.cumsum(rng.random(n) < 1.0 / (8.0 * rate_hz)) % 2
    assert has_jumps(noise + 4e-3 * sides[:, None], rate_hz)
    walk = 4e-5 * np.cumsum(rng.standard_normal((n, 1)), axis=0)
    assert not has_jumps(noise + walk, rate_hz)


def test_an_ordinary_part_is_calm(hidden: Callable[..., Any]) -> None:
    session = hidden(seed=7)
    solution = fit_base_model([session.recording], session.board)
    assert has_typical_noise(solution)
    assert measure_bias_walk(solution).p_value == 1.0
    assert detect_random_walk(solution, tests=80) is None


def test_levels_are_calm_by_ratio_however_small(hidden: Callable[..., Any]) -> None:
    session = hidden(seed=7)
    solution = fit_base_model([session.recording], session.board)
    (noise,) = solution.noises
    levels = noise.levels * np.array([1.0, 1.0, 300.0, 1.0])  # of 1e-10: less than any atol
    assert not has_typical_noise(replace(solution, noises=(replace(noise, levels=levels),)))


@pytest.mark.long
def test_a_hidden_step_raises_the_levels_and_is_found(hidden: Callable[..., Any]) -> None:
    session = hidden("bias_step@y:0.002")
    solution = fit_base_model([session.recording], session.board)
    assert not has_typical_noise(solution)
    (noise,) = solution.noises
    for axis in limit_to_typical(noise).levels:
        assert axis[1] <= TYPICAL_POWER_FACTOR * nominal_levels(float(axis[0]))[1] * 1.001
    causes = explain_recordings([session.recording], session.board).findings.causes
    assert [cause.candidates for cause in causes] == [("bias_step",)]


LOG_TYPICAL = 2.0 * np.log(2e-6)  # of a walk of 2e-6 rad/s per sqrt(s)
WALK = 8e-5


def walk_profile(log_typical: float, log_limit: float, is_measured: bool) -> WalkProfile:
    """Return a profile whose levels are measured, or only limited, from `log_limit` on."""
    shifts = np.linspace(-MAX_LOG_LEVEL_SHIFT, MAX_LOG_LEVEL_SHIFT, LEVEL_GRID_POINTS)
    log_levels = log_typical + shifts
    excess = log_levels - log_limit
    nats = -20.0 * np.log1p(np.exp(excess))
    return WalkProfile(log_levels, nats - 20.0 * np.log1p(np.exp(-excess)) * is_measured)


def test_the_walk_of_one_recording_is_that_of_its_profile() -> None:
    profile = walk_profile(LOG_TYPICAL, 2.0 * np.log(WALK), True)
    assert add_profiles([profile]).posterior_level() == profile.posterior_level()


def test_recordings_that_show_no_walk_do_not_lower_it() -> None:
    """Before, the mean of the levels counted each upper limit as a measurement of a small walk."""
    measured = walk_profile(LOG_TYPICAL, 2.0 * np.log(WALK), True)
    limited = [
        walk_profile(LOG_TYPICAL + shift, 2.0 * np.log(10.0 * WALK), False)
        for shift in (-0.3, -0.1, 0.1, 0.3, 0.0)
    ]
    expected, expected_std = measured.posterior_level()
    level, std = add_profiles([*limited, measured]).posterior_level()
    assert level == pytest.approx(expected, abs=0.5 * expected_std)
    assert std == pytest.approx(expected_std, rel=0.2)


def test_equal_recordings_measure_the_walk_more_accurately() -> None:
    measured = walk_profile(LOG_TYPICAL, 2.0 * np.log(WALK), True)
    level, std = add_profiles([measured] * 4).posterior_level()
    assert level == pytest.approx(WALK, rel=0.05)
    assert std == pytest.approx(0.5 * measured.posterior_level()[1], rel=0.1)
