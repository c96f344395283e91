"""The budget of a fit to an emulated session with a hidden cause."""

from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
from scipy.stats import norm
from tests.support.emulated_recordings import record_once
from tests.support.made_once import shared_folder

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.data import FloatArray
from gyrorig_solver.discover import CALIBRATION_PARAMETERS
from gyrorig_solver.discover.calibration_changes import CalibrationValues
from gyrorig_solver.estimate import (
    ConvergedFit,
    FittedTerm,
    NuisanceProjector,
    refit_with_terms,
)
from gyrorig_solver.model import factorise, find_term
from gyrorig_solver.pipeline.board_data import load_board
from gyrorig_solver.pipeline.prepare_board import fit_base
from gyrorig_solver.uncertainty import (
    UncertaintyBudget,
    UncertaintySettings,
    UnitPosterior,
    assess_uncertainty,
    default_settings,
    fit_linearisation,
    uncertainty_budget,
)
from gyrorig_solver.uncertainty.prior_effects import (
    unidentified_causes,
    whitened_effects,
)
from gyrorig_solver.uncertainty.uncertainty_settings import PriorSize

Y = CALIBRATION_PARAMETERS.index("misalignment.y")


@dataclass(frozen=True)
class Session:
    """A recording, its base fit, and the true factors of the sensor matrix."""

    recording: Recording
    fit: ConvergedFit
    true_factors: FloatArray  # (9,)


def emulate(shared: Path, program: str, *hide: str) -> Session:
    """Record a program on an emulated rig, and fit the base model."""
    causes = [word for cause in hide for word in ("--hide", cause)]
    emulated = record_once(shared, program, "--seed", "21", *causes)
    recording = read_recording(emulated.path)
    board = str(recording.board_ids[0])
    gain = np.array(emulated.truth["boards"][board]["STM"])
    fit = fit_base(load_board([recording], board))
    return Session(recording, fit, np.asarray(factorise(gain).as_vector()))


@pytest.fixture(scope="module")
def leaning(tmp_path_factory: pytest.TempPathFactory) -> Session:
    """Axes that are 1.3 mrad from perpendicular; the search does not find it in this motion."""
    shared = shared_folder(tmp_path_factory)
    return emulate(shared, "survey-130", "axis_nonorthogonality:0.0013")


@pytest.fixture(scope="module")
def resting(tmp_path_factory: pytest.TempPathFactory) -> Session:
    """A board that does not turn."""
    return emulate(shared_folder(tmp_path_factory), "static")


def only(**sizes: float) -> UncertaintySettings:
    """Return settings in which only these causes have a prior size."""
    priors = {cause: PriorSize(size, 1.0) for cause, size in sizes.items()}
    return replace(default_settings(), prior_sizes=MappingProxyType(priors))


@pytest.fixture(scope="module")
def budget(leaning: Session) -> UncertaintyBudget:
    """Of the base fit, with the shipped settings."""
    return assess_uncertainty(leaning.fit)


@pytest.mark.long
def test_the_total_covers_an_error_that_the_noise_does_not(
    leaning: Session, budget: UncertaintyBudget
) -> None:
    calibration = CalibrationValues.of(leaning.fit)
    error = calibration.values[:9] - leaning.true_factors
    noise = calibration.std[:9]
    total = np.hypot(noise, budget.std[:9])
    assert np.max(np.abs(error / noise)) > 20.0
    assert np.max(np.abs(error / total)) < 2.0


def test_the_cause_is_the_largest_contribution(budget: UncertaintyBudget) -> None:
    largest = max(budget.entries, key=lambda entry: entry.std[Y])
    assert largest.cause == "axis_nonorthogonality"
    assert largest.std[Y] <= budget.std[Y] * 1.5


def test_a_prior_of_zero_adds_nothing(leaning: Session) -> None:
    assert assess_uncertainty(leaning.fit, only(axis_nonorthogonality=0.0)).std == pytest.approx(0)


def test_a_tilt_zero_adds_its_prior_to_the_misalignment(leaning: Session) -> None:
    std = assess_uncertainty(leaning.fit, only(tilt_zero=0.004)).std
    x = CALIBRATION_PARAMETERS.index("misalignment.x")
    assert std[x] == pytest.approx(0.004, rel=0.03)  # of the stage's axis, not the sensor's
    assert np.max(std[:6]) < 1e-4


def test_a_cause_that_the_data_exclude_adds_next_to_nothing(leaning: Session) -> None:
    """A step of the clock of 0.1 s would be seen at once."""
    small, large = (
        assess_uncertainty(leaning.fit, only(clock_skew=size)).covariance for size in (0.01, 0.1)
    )
    noise = CalibrationValues.of(leaning.fit).std ** 2
    assert np.diag(large) == pytest.approx(np.diag(small), rel=1e-3, abs=1e-12)
    assert np.all(np.diag(large) < 0.3 * noise)


def test_the_covariance_is_that_of_a_dense_ridge_fit(leaning: Session) -> None:
    """All unknowns of the fit and the causes in one dense matrix, with all priors as rows."""
    projector = NuisanceProjector.at_fit(leaning.fit)
    settings = only(axis_nonorthogonality=0.003, tilt_sag=0.002, scale_cubic=1e-4, dead_zone=2e-3)
    causes = unidentified_causes(projector, (), settings)
    effects = whitened_effects(projector, causes).dense()
    local, base, prior = projector._local.toarray(), projector._basis, projector._prior
    information = np.block([[prior.local.toarray(), prior.cross], [prior.cross.T, prior.shared]])
    known = local.shape[0] + base.shape[0]
    rows = np.vstack([local, base, effects])
    normal = rows @ rows.T + np.diag([0.0] * known + [1.0] * len(effects))
    normal[:known, :known] += information
    scale = np.sqrt(np.diag(normal))
    covariance = np.linalg.inv(normal / np.outer(scale, scale)) / np.outer(scale, scale)
    alone = normal[:known, :known] / np.outer(scale[:known], scale[:known])
    noise_only = np.linalg.inv(alone) / np.outer(scale[:known], scale[:known])
    first = local.shape[0]
    added = (covariance[:known, :known] - noise_only)[first : first + 13, first : first + 13]
    jacobian = CalibrationValues.of(leaning.fit).jacobian
    budget = assess_uncertainty(leaning.fit, settings, projector)
    assert np.diag(budget.covariance) == pytest.approx(
        np.diag(jacobian @ added @ jacobian.T), rel=1e-3, abs=1e-14
    )


def test_a_long_recording_gives_the_same_in_batches(
    leaning: Session, budget: UncertaintyBudget, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(uncertainty_budget, "MAX_JOINT_VALUES", 70 * 38400)
    batched = assess_uncertainty(leaning.fit)
    assert batched.covariance == pytest.approx(budget.covariance, rel=1e-6, abs=1e-15)
    assert batched.expected_error == pytest.approx(budget.expected_error, rel=1e-6, abs=1e-12)
    for entry, other in zip(batched.entries, budget.entries, strict=True):
        assert entry.std == pytest.approx(other.std, rel=1e-6, abs=1e-12)


def test_fitted_sizes_take_no_part(leaning: Session) -> None:
    projector = NuisanceProjector.at_fit(leaning.fit)
    (backlash,) = unidentified_causes(projector, (), only(backlash=1e-3))
    assert backlash.places == ("pan", "tilt") * len(backlash.templates)

    class Fitted:
        term = backlash.term
        free_indices = np.array([0, 2])

    rare = replace(only(), prior_sizes=MappingProxyType({"backlash": PriorSize(1e-3, 0.02)}))
    (left,) = unidentified_causes(projector, (Fitted(),), rare)  # type: ignore[arg-type]
    (unfitted,) = unidentified_causes(projector, (), rare)
    assert set(left.places) == {"tilt"}
    # A unit with backlash of pan has the cause.
    assert left.prior.std == pytest.approx(unfitted.prior.size)
    assert unfitted.prior.std == pytest.approx(unfitted.prior.size * 0.02**0.5)


@pytest.mark.long
def test_a_board_at_rest_has_a_budget_of_its_bias(resting: Session) -> None:
    std = assess_uncertainty(resting.fit).std
    bias = [CALIBRATION_PARAMETERS.index(f"bias.{axis}") for axis in "xyz"]
    assert np.all(np.isfinite(std))
    assert np.all(std[bias] > 1e-4)  # g-sensitivity and warm-up, rad/s


@pytest.mark.long
def test_a_recording_at_rest_takes_no_templates_from_the_others(
    resting: Session, leaning: Session
) -> None:
    """Solved together, the templates come from the recording that has them."""
    data = load_board([resting.recording, leaning.recording], str(leaning.recording.board_ids[0]))
    together = assess_uncertainty(fit_base(data)).std
    alone = assess_uncertainty(leaning.fit).std
    assert together[Y] == pytest.approx(alone[Y], rel=0.5)


@pytest.mark.long
def test_a_rest_at_the_end_does_not_hide_the_error_of_the_time_offset(
    tmp_path: Path, leaning: Session
) -> None:
    """The stated time offset is that of the survey, because a rest shows none."""
    resting = emulate(tmp_path, "static")
    data = load_board([leaning.recording, resting.recording], str(leaning.recording.board_ids[0]))
    together = fit_base(data)
    assert together.offset_recording == 0
    offset = CALIBRATION_PARAMETERS.index("time_offset")
    alone = assess_uncertainty(leaning.fit).std[offset]
    assert assess_uncertainty(together).std[offset] == pytest.approx(alone, rel=0.5)


def test_the_budget_grows_with_the_residual_as_with_a_unit_prior(
    leaning: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A prior of an unknown unit has the same sizes as the table."""
    factor = 4.0
    solution = leaning.fit
    covariance = factor * solution.observability.covariance
    wide = replace(solution.observability, covariance=covariance)
    widened = replace(solution, observability=wide, session_observability=(wide,))
    plain = spread(assess_uncertainty(solution))
    monkeypatch.setattr(fit_linearisation, "widen_uncertainty", lambda _: (widened, factor))
    by_data = spread(assess_uncertainty(solution))
    prior = UnitPosterior.from_table(default_settings())
    by_unit = spread(assess_uncertainty(solution, unit_prior=prior))
    assert np.all(by_data > plain)
    without_unit = [CALIBRATION_PARAMETERS.index(name) for name in ("misalignment.z", "bias.x")]
    np.testing.assert_allclose(by_data[without_unit], by_unit[without_unit], rtol=0.2)


def spread(budget: UncertaintyBudget) -> FloatArray:
    """Return the standard deviations of a budget without its expected errors."""
    return np.sqrt(np.diag(budget.covariance))


NOISE = np.full(len(CALIBRATION_PARAMETERS), 1e-4)
KNOWN_CAUSES = {"axis_nonorthogonality": 0.003, "g_sensitivity": 2e-4, "tilt_zero": 0.004}


def with_probability(cause: str, probability: float) -> UncertaintySettings:
    """Return settings of a few causes, of which one may be absent."""
    settings = only(**KNOWN_CAUSES)
    priors = {**settings.prior_sizes, cause: PriorSize(KNOWN_CAUSES[cause], probability)}
    return replace(settings, prior_sizes=MappingProxyType(priors))


@pytest.mark.parametrize("is_unit_known", [False, True])
def test_the_interval_of_certain_causes_is_that_of_a_normal_distribution(
    leaning: Session, is_unit_known: bool
) -> None:
    settings = only(**KNOWN_CAUSES)
    unit = UnitPosterior.from_table(settings) if is_unit_known else None
    made = assess_uncertainty(leaning.fit, settings, unit_prior=unit)
    std = np.sqrt(np.diag(made.covariance) + NOISE**2)
    expanded = made.expanded_uncertainty(NOISE, 0.95)
    inside = norm.cdf(expanded, made.expected_error, std)
    inside -= norm.cdf(-expanded, made.expected_error, std)
    assert inside == pytest.approx(0.95, rel=1e-6)


@pytest.mark.parametrize("is_unit_known", [False, True])
def test_the_interval_without_an_improbable_cause_is_that_of_the_others(
    leaning: Session, is_unit_known: bool
) -> None:
    improbable = with_probability("g_sensitivity", 1e-12)
    without = only(**{**KNOWN_CAUSES, "g_sensitivity": 0.0})
    intervals = []
    for settings in (improbable, without):
        unit = UnitPosterior.from_table(settings) if is_unit_known else None
        made = assess_uncertainty(leaning.fit, settings, unit_prior=unit)
        intervals.append(made.expanded_uncertainty(NOISE, 0.95))
    assert intervals[0] == pytest.approx(intervals[1], rel=1e-4, abs=1e-9)


def test_a_rare_cause_that_no_motion_shows_hardly_widens_the_interval(leaning: Session) -> None:
    """One rig in fifty has a wrong tilt zero: 95 % of the errors are much smaller than 2 u."""
    x = CALIBRATION_PARAMETERS.index("misalignment.x")
    made = assess_uncertainty(leaning.fit, with_probability("tilt_zero", 0.02))
    expanded = made.expanded_uncertainty(NOISE, 0.95)[x]
    assert expanded < 0.5 * 1.96 * np.hypot(made.std[x], NOISE[x])


def test_a_clock_step_leaves_the_time_offset_open_by_its_size(leaning: Session) -> None:
    """A later recording can be like the part before the step or like the part after it."""
    step = FittedTerm(find_term("clock_step"), np.array([-8.8e-3, 60.0]), np.zeros(0, np.int64))
    stepped = refit_with_terms(leaning.fit, [step])
    settings = only(**KNOWN_CAUSES)
    made = assess_uncertainty(stepped, settings)
    index = CALIBRATION_PARAMETERS.index("time_offset")
    assert made.std[index] == pytest.approx(8.8e-3, rel=1e-3)
    assert made.expanded_uncertainty(NOISE, 0.95)[index] > 8.8e-3
    largest = max(made.entries, key=lambda entry: entry.std[index])
    assert (largest.cause, largest.std[index]) == ("clock_step", pytest.approx(8.8e-3))
    others = np.arange(len(CALIBRATION_PARAMETERS)) != index
    assert np.all(largest.std[others] == 0.0)


def test_a_clock_skew_leaves_the_time_offset_open_by_half_of_its_drift(leaning: Session) -> None:
    """The stated offset is that in the middle of the recording."""
    (series,) = leaning.fit.sessions[0].series
    drift_s = 40e-6 * float(series.time_s[-1] - series.time_s[0])
    skew = FittedTerm(find_term("clock_skew"), np.array([-40e-6]), np.zeros(0, np.int64))
    made = assess_uncertainty(refit_with_terms(leaning.fit, [skew]), only(**KNOWN_CAUSES))
    index = CALIBRATION_PARAMETERS.index("time_offset")
    assert made.std[index] == pytest.approx(0.5 * drift_s, rel=1e-3)
