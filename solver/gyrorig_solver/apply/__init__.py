"""Applying calibrations: from sensor readings to true rates.

What to use when: `board_calibration.Calibration` in Python, with arrays;
`corrected_table.apply_to_table` for a CSV file; `corrected_recording.apply_to_recording` for a
recording. `correction` has the inverse sensor model, `affine` the fast arithmetic, and
`calibration_file` reads and checks the document.
"""

from gyrorig_solver.apply.board_calibration import Calibration
from gyrorig_solver.apply.calibration_correction import LAG_NOTE
from gyrorig_solver.apply.calibration_file import read_calibration
from gyrorig_solver.apply.correction import FRAMES, Correction, Frame

__all__ = [
    "FRAMES",
    "LAG_NOTE",
    "Calibration",
    "Correction",
    "Frame",
    "read_calibration",
]
