"""The fit of one board, and the search for causes in it, from recordings on a pan-tilt unit."""

from collections.abc import Sequence

from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.discover import FitExplanation, explain_fit
from gyrorig_solver.estimate import ConvergedFit
from gyrorig_solver.pipeline import load_board
from gyrorig_solver.pipeline.prepare_board import fit_base


def fit_base_model(recordings: Sequence[Recording], board: str) -> ConvergedFit:
    """Fit the base model to one board's recordings."""
    return fit_base(load_board(recordings, board))


def explain_recordings(recordings: Sequence[Recording], board: str) -> FitExplanation:
    """Search for causes in one board's recordings."""
    return explain_fit(fit_base_model(recordings, board), board)
