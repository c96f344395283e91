"""Twin of a rig: the results of its recordings, as the file of an emulated rig.

Solver and emulator share no code, only this file. Its format is in `gyrorig_protocol.twin`.

What to use when: `fit_boards`, then `build_twin` and `write_twin`; `twin_summary` for a terminal.
"""

from gyrorig_solver.twin.board_fits import BoardFits, fit_boards
from gyrorig_solver.twin.twin_builder import BuiltTwin, build_twin, check_one_rig, write_twin
from gyrorig_solver.twin.twin_text import twin_summary, twin_warnings, undetermined_values

__all__ = [
    "BoardFits",
    "BuiltTwin",
    "build_twin",
    "check_one_rig",
    "fit_boards",
    "twin_summary",
    "twin_warnings",
    "undetermined_values",
    "write_twin",
]
