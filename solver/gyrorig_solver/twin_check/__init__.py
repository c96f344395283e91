"""The check of a twin against measurements: a posterior predictive check.

What to use when: `check_twin_folder` for recordings and the folder of a twin; `summarise` for lines
of text, `to_plain` for the JSON object, and `render_check` for the HTML page.
"""

from gyrorig_solver.twin_check.check_page import render_check
from gyrorig_solver.twin_check.check_wording import failure_texts, summarise, to_plain
from gyrorig_solver.twin_check.twin_folder_check import (
    DEFAULT_DRAWS,
    MIN_DRAWS,
    TwinCheck,
    check_twin_folder,
)

__all__ = [
    "DEFAULT_DRAWS",
    "MIN_DRAWS",
    "TwinCheck",
    "check_twin_folder",
    "failure_texts",
    "render_check",
    "summarise",
    "to_plain",
]
