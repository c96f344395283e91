"""The section `uncertainty` of a calibration: totals, intervals, budget, verdict and words."""

import math
from dataclasses import replace
from statistics import NormalDist
from types import MappingProxyType

import numpy as np
import pytest

from gyrorig_solver.calibration import CalibrationDocument, Parameter, parse_calibration
from gyrorig_solver.calibration.calibration_document import (
    BoardRecord,
    BoardSettings,
    Covariance,
    Matrices,
    ObservabilityRecord,
    Quality,
    SolverRecord,
    Trust,
    Units,
    Validity,
    calibration_as_yaml,
)
from gyrorig_solver.calibration.calibration_summary import calibration_summary
from gyrorig_solver.calibration.total_uncertainty import with_total_uncertainty
from gyrorig_solver.discover import CALIBRATION_PARAMETERS
from gyrorig_solver.model.catalogue import catalogue
from gyrorig_solver.report import ReportData, render_calibration
from gyrorig_solver.uncertainty import UncertaintyBudget, default_settings
from gyrorig_solver.uncertainty.mixture_interval import ErrorMixture
from gyrorig_solver.uncertainty.uncertainty_budget import BudgetEntry

UNKNOWN: list[list[float | None]] = [[None] * 3] * 3
SIZE = len(CALIBRATION_PARAMETERS)


def document() -> CalibrationDocument:
    """A good calibration; the third bias has no value."""
    ones: list[float | None] = [1.0, 1.0, 1.0]
    zeros: list[float | None] = [0.0, 0.0, 0.0]
    small: list[float | None] = [1e-4, 1e-4, 1e-4]
    return CalibrationDocument(
        schema="gyrorig/calibration/1",
        board=BoardRecord("B-1", "uid", "L3G4200D", BoardSettings()),
        version=1,
        created="2026-01-31T02:30:00Z",
        inputs=[],
        solver=SolverRecord("1", "likelihood", [], ""),
        units=Units(),
        model="",
        parameters={
            "bias": Parameter([0.1, 0.2, None], [1e-4, 1e-4, None], "rad/s"),
            "scale": Parameter(ones, small, "1"),
            "nonorthogonality": Parameter(zeros, small, "1"),
            "misalignment": Parameter(zeros, small, "rad"),
            "time_offset": Parameter(0.01, 1e-3, "s"),
        },
        matrices=Matrices(UNKNOWN, UNKNOWN, UNKNOWN, UNKNOWN),
        covariance=Covariance([], []),
        observability=ObservabilityRecord(12, 12, [], 2.0),
        noise={},
        quality=Quality(1.0, []),
        trust=Trust("good", []),
        validity=Validity([-1.0, 1.0]),
    )


def budget(misalignment_y: float, error: float = 0.0) -> UncertaintyBudget:
    """Of one cause that moves misalignment.y."""
    std, expected = np.zeros(SIZE), np.zeros(SIZE)
    y = CALIBRATION_PARAMETERS.index("misalignment.y")
    std[y], expected[y] = misalignment_y, error
    entry = BudgetEntry(catalogue()["axis_nonorthogonality"], None, std)
    return UncertaintyBudget(np.diag(std**2), expected, (entry,), default_settings())


def test_std_stays_type_a_and_the_total_stands_beside_it() -> None:
    made = with_total_uncertainty(document(), budget(3e-4))
    assert made.parameters == document().parameters
    assert made.uncertainty is not None
    y = made.uncertainty.parameters["misalignment.y"]
    assert y.type_a == 1e-4
    assert y.type_b == pytest.approx(3e-4)
    assert y.total == pytest.approx(math.sqrt(10.0) * 1e-4)
    assert y.interval == pytest.approx([-2.0 * y.total, 2.0 * y.total])
    assert made.trust.verdict == "good"


def test_a_value_that_is_null_has_no_uncertainty() -> None:
    made = with_total_uncertainty(document(), budget(3e-4))
    assert made.uncertainty is not None
    assert "bias.z" not in made.uncertainty.parameters
    assert len(made.uncertainty.parameters) == SIZE - 1


def test_an_expected_error_that_is_not_corrected_adds_its_square() -> None:
    made = with_total_uncertainty(document(), budget(3e-4, error=-4e-4))
    assert made.uncertainty is not None
    assert made.uncertainty.parameters["misalignment.y"].type_b == pytest.approx(5e-4)


def test_an_expected_error_widens_the_interval_on_both_sides() -> None:
    """A value that is probably 0.4 mrad too small: the interval about it contains the true one."""
    made = with_total_uncertainty(document(), budget(3e-4, error=-4e-4))
    assert made.uncertainty is not None
    std = math.sqrt(10.0) * 1e-4
    low, high = made.uncertainty.parameters["misalignment.y"].interval
    assert low == pytest.approx(-high)
    error = NormalDist(-4e-4, std)
    assert error.cdf(high) - error.cdf(low) == pytest.approx(0.9545, abs=1e-4)


def test_the_interval_of_a_rare_cause_is_narrower_than_two_totals() -> None:
    y = CALIBRATION_PARAMETERS.index("misalignment.y")
    variance = np.zeros((2, SIZE))
    variance[1, y] = 0.01**2
    rare = ErrorMixture(np.array([0.98, 0.02]), np.zeros((2, SIZE)), variance)
    made = with_total_uncertainty(document(), replace(budget(math.sqrt(0.02) * 0.01), mixture=rare))
    assert made.uncertainty is not None
    assert made.uncertainty.coverage_probability == pytest.approx(0.9545, abs=1e-4)
    entry = made.uncertainty.parameters["misalignment.y"]
    assert entry.total == pytest.approx(1.4e-3, rel=0.02)
    assert 2e-4 < entry.interval[1] < 4e-4
    assert entry.interval[0] == pytest.approx(-entry.interval[1])


def test_the_budget_names_cause_share_and_motion() -> None:
    made = with_total_uncertainty(document(), budget(3e-4))
    assert made.uncertainty is not None
    (row,) = made.uncertainty.budget
    assert (row.parameter, row.place) == ("misalignment.y", None)
    assert row.cause == "axis_nonorthogonality"
    assert row.share == pytest.approx(0.9)
    assert row.remedy == catalogue()["axis_nonorthogonality"].excitation


def test_a_total_above_its_limit_makes_a_result_limited() -> None:
    made = with_total_uncertainty(document(), budget(0.02))
    assert made.trust.verdict == "limited"
    (reason,) = made.trust.reasons
    assert "misalignment.y is 1.15 deg, above the limit of 0.500 deg" in reason
    assert "axis nonorthogonality" in reason
    assert catalogue()["axis_nonorthogonality"].excitation in reason


def test_noise_above_the_limit_asks_for_more_data() -> None:
    noisy = document()
    noisy.parameters["time_offset"] = Parameter(0.01, 0.008, "s")
    made = with_total_uncertainty(noisy, budget(0.0))
    (reason,) = made.trust.reasons
    assert "time_offset is 8.00 ms" in reason
    assert "largest contribution is noise" in reason


def test_a_user_can_change_the_limit() -> None:
    wider = {**default_settings().limits, "misalignment": 0.1}
    settings = replace(default_settings(), limits=MappingProxyType(wider))
    made = with_total_uncertainty(document(), replace(budget(0.02), settings=settings))
    assert made.trust.verdict == "good"


def test_the_document_reads_back() -> None:
    made = with_total_uncertainty(document(), budget(3e-4))
    assert parse_calibration(calibration_as_yaml(made), "v0001.yaml") == made


def test_a_document_without_the_section_reads_as_before() -> None:
    text = calibration_as_yaml(document())
    assert "uncertainty" not in text
    assert parse_calibration(text, "v0001.yaml").uncertainty is None


def test_the_terminal_shows_totals_and_the_largest_contribution() -> None:
    lines = calibration_summary(with_total_uncertainty(document(), budget(3e-4))).splitlines()
    (row,) = [line for line in lines if line.startswith("  misalignment.y")]
    assert row.endswith("total ± 0.018")
    (largest,) = [line for line in lines if "largest contributions" in line]
    assert "misalignment.y: axis nonorthogonality ± 0.017 deg; to reduce it: pan sweeps" in largest


def test_the_page_has_the_budget() -> None:
    page = render_calibration(ReportData(with_total_uncertainty(document(), budget(3e-4))))
    assert "Uncertainty budget" in page
    assert "axis nonorthogonality 0.017 (90 %)" in page
    assert "Uncertainty budget" not in render_calibration(ReportData(document()))
