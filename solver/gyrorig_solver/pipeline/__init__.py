"""The pipeline from recordings to documents: load, prepare, fit, search for causes, store.

The command line and the batch both call these modules. `board_data.load_board` reads a board once;
every later step uses its `BoardData`. The code for each kind of reference is in `references`, one
file per kind.

What to use when: `solve_board.solve_and_store` for a calibration in a store,
`explain_board.explain_boards` for findings, `fit_board.solve_recordings` for only a fit.
"""

from gyrorig_solver.pipeline.board_data import BoardData, check_given_once, has_unit, load_board
from gyrorig_solver.pipeline.board_results import CriticisedFit
from gyrorig_solver.pipeline.criticised_fit import AUTO, fit_criticised, fit_together
from gyrorig_solver.pipeline.explain_board import WrittenFindings, explain_boards, write_explanation
from gyrorig_solver.pipeline.fit_board import solve_recordings
from gyrorig_solver.pipeline.solve_board import StoredResult, solve_and_store
from gyrorig_solver.pipeline.unit_prior import UnitKnowledge, read_unit_file

__all__ = [
    "AUTO",
    "BoardData",
    "CriticisedFit",
    "StoredResult",
    "UnitKnowledge",
    "WrittenFindings",
    "check_given_once",
    "explain_boards",
    "fit_criticised",
    "fit_together",
    "has_unit",
    "load_board",
    "read_unit_file",
    "solve_and_store",
    "solve_recordings",
    "write_explanation",
]
