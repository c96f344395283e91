"""Fit one board by the best reference that its recordings have.

`criticised_fit` fits several boards that were on one unit at the same time.
"""

from collections.abc import Sequence
from dataclasses import replace

from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.estimate import FittedTerm, GyroFit
from gyrorig_solver.pipeline.board_data import load_board


def solve_recordings(
    recordings: Sequence[Recording],
    board: str,
    extend: Sequence[str] = (),
    named_terms: Sequence[FittedTerm] = (),
) -> GyroFit:
    """Calibrate one board by the best reference of its recordings.

    Args:
        recordings: in any order.
        board: in each of them.
        extend: causes of the catalogue to fit in addition to the base model, if the reference gives
            the rate at each time.
        named_terms: causes that a search named, to be fitted too; with a unit or at rest.

    Raises:
        InputError: the board is not in a recording, or there is no reference of any kind.
        UsageError: the recordings cannot be solved together, or a cause is unknown.
    """
    data = load_board(recordings, board)
    fit = data.kind.fit(data, extend, named_terms)
    return replace(fit, warnings=(*data.missing, *fit.warnings))
