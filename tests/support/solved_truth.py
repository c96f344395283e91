"""A solved recording against the truth of its simulated session.

What to use when: `check_solved` after an import.
"""

from pathlib import Path

import numpy as np
from tests.support.simulated_attitudes import SimulatedAttitudes

from gyrorig_solver import cli
from gyrorig_solver.calibration import parse_calibration

FARTHEST_SIGMA = 4.0
MAX_GAIN_ERROR = 5e-4
MAX_DELAY_ERROR_S = 2e-4


def check_solved(recording: Path, session: SimulatedAttitudes, folder: Path) -> None:
    """Solve a recording and compare the matrix, the bias and the delay with the truth."""
    assert cli.run(["solve", str(recording), "--out", str(folder), "--extend", "none"]) == 0
    (document,) = folder.rglob("v0001.yaml")
    result = parse_calibration(document.read_bytes(), document.name)
    assert result.trust.verdict == "good"
    gain = np.array(result.matrices.STM)
    assert np.abs(gain - session.gain).max() < MAX_GAIN_ERROR
    bias = result.parameters["bias"]
    off = (np.array(bias.value) - session.bias_rad_s) / np.array(bias.std)
    assert np.abs(off).max() < FARTHEST_SIGMA
    delay_s = result.parameters["time_offset"].value
    assert isinstance(delay_s, float)
    assert abs(delay_s - session.lag_s) < MAX_DELAY_ERROR_S
