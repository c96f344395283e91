"""A parameter has one unit wherever people read it, whatever its size."""

import re

import numpy as np
import pytest

from gyrorig_solver.calibration.calibration_wording import _cause_unit
from gyrorig_solver.findings import amount_text
from gyrorig_solver.findings.findings_document import CauseEntry, SizeEntry
from gyrorig_solver.findings.findings_document import TestStatistics as Statistics
from gyrorig_solver.findings.findings_wording import main_size_text, size_text
from gyrorig_solver.model import cause_display_unit
from gyrorig_solver.model.catalogue import catalogue


@pytest.mark.parametrize(
    ("cause", "name", "unit"),
    [
        ("scale_asymmetry", "share.x", "ppm"),
        ("clock_skew", "rate", "ppm"),
        ("ringing", "share.pan", "%"),
        ("saturation", "shortfall", "%"),
        ("wrong_full_scale", "doublings", ""),
        ("bias_step", "time", "s"),
        ("clock_step", "step", "ms"),
        ("stuck_axis", "share", "%"),
    ],
)
def test_the_size_does_not_change_the_unit(cause: str, name: str, unit: str) -> None:
    si_unit = "s" if unit in ("s", "ms") else "1"
    for value in (1e-5, 3e-3, 0.2, 2.0):
        assert size_text(cause, name, SizeEntry(value, value / 10.0, si_unit)).endswith(
            f" {unit}".rstrip()
        )
    factor = {"ppm": 1e6, "%": 100.0, "ms": 1e3}.get(unit, 1.0)
    assert cause_display_unit(cause, name.partition(".")[0], si_unit) == (factor, unit)


@pytest.mark.parametrize("cause", catalogue())
def test_findings_and_calibrations_have_the_same_unit(cause: str) -> None:
    for parameter in catalogue()[cause].parameters:
        shown = cause_display_unit(cause, parameter.name, parameter.unit)
        assert _cause_unit(f"{cause}.{parameter.name}", parameter.unit) == shown
    size = next(p for p in catalogue()[cause].parameters if p.role == "size")
    unit = cause_display_unit(cause, size.name, size.unit)[1]
    assert amount_text(cause, 1e-3, size.unit).endswith(unit)


def test_the_size_of_a_wave_is_its_amplitude() -> None:
    """Its cosine and sine depend on the zero of the angle; the uncertainty is an upper bound."""
    rng = np.random.default_rng(1)
    parameters = {
        "cosine.pan": SizeEntry(-3e-3, 2e-3, "rad"),
        "sine.pan": SizeEntry(4e-3, 5e-4, "rad"),
        "oval": SizeEntry(0.5, 0.01, "1"),
    }
    evidence = Statistics(100.0, 4, 1e-9, "pan")
    cause = CauseEntry("eccentricity", "ptu", "pan", parameters, evidence, None)
    match = re.fullmatch(r"amplitude (\S+) ± (\S+) deg", main_size_text(cause))
    assert match is not None
    amplitude_deg, std_deg = map(float, match.groups())
    assert amplitude_deg == pytest.approx(np.degrees(5e-3), rel=0.05)
    for correlation in (-0.99, 0.0, 0.99):
        shared = correlation * 1e-6
        covariance = [[4e-6, shared], [shared, 2.5e-7]]
        draws = rng.multivariate_normal([-3e-3, 4e-3], np.array(covariance) * 1e-2, 20_000)
        scatter = 10.0 * np.degrees(np.hypot(*draws.T).std())  # small errors: to first order
        assert scatter < 1.05 * std_deg
    del parameters["cosine.pan"]
    assert main_size_text(cause).startswith("0.2")
