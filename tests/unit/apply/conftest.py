"""Calibrations to apply: the golden one, and others made of it."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from gyrorig_solver.calibration import CalibrationDocument, parse_calibration

GOLDEN = Path(__file__).parents[1] / "output" / "golden"


@pytest.fixture
def document() -> Callable[..., CalibrationDocument]:
    """Make the golden calibration, with parameters more or parts replaced."""

    def make(name: str = "good", *, board: str = "GY80-0007", **parts: Any) -> CalibrationDocument:
        plain = yaml.safe_load((GOLDEN / f"{name}.yaml").read_text())
        plain["board"]["id"] = board
        plain["parameters"] |= parts.pop("parameters", {})
        plain["board"]["config"] |= parts.pop("config", {})
        return parse_calibration(yaml.safe_dump(plain | parts), name)

    return make


@pytest.fixture
def golden(tmp_path: Path) -> Path:
    """The golden calibration in a file of its own."""
    return Path(shutil.copy(GOLDEN / "good.yaml", tmp_path / "v0001.yaml"))
