"""The requested causes of a calibration, which `gyrorig report` fits again."""

from pathlib import Path

import msgspec
import pytest

from gyrorig_solver.calibration import parse_calibration
from gyrorig_solver.calibration.calibration_builder import settings_sha256
from gyrorig_solver.pipeline.solve_board import _requested_causes, likelihood_settings

GOOD = Path(__file__).resolve().parents[1] / "output" / "golden" / "good.yaml"


@pytest.mark.parametrize(
    ("extend", "terms"),
    [
        (("g_sensitivity",), ["bias", "earth_rotation", "g_sensitivity"]),
        (("auto", "g_sensitivity"), ["bias", "earth_rotation", "backlash", "g_sensitivity"]),
    ],
)
def test_requested_causes_are_found_beside_known_and_named_ones(
    extend: tuple[str, ...], terms: list[str]
) -> None:
    document = parse_calibration(GOOD.read_bytes(), "good")
    solver = msgspec.structs.replace(
        document.solver, terms=terms, config_sha256=settings_sha256(likelihood_settings(extend))
    )
    assert _requested_causes(msgspec.structs.replace(document, solver=solver)) == extend
