"""Reject recordings of one board that contradict each other before they are fitted together.

A model with one gain has no causes for two gains. A search would try every cause, take very long,
and name a wrong one.
"""

from dataclasses import replace

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_solver.pipeline.board_data import BoardData
from gyrorig_solver.pipeline.gain_fit import GainFit
from gyrorig_solver.uncertainty.gain_agreement import GainDisagreement, compare_gains

MAX_SIGMA_STATED = 1000.0


def require_agreement(data: BoardData) -> BoardData:
    """Return the data of recordings whose gains agree.

    Each recording that determines a gain is fitted alone. If the gains differ by more than noise,
    causes are searched in each recording alone, and the gains with these causes are compared by
    their total uncertainty.

    Args:
        data: of one board. With `allows_contradiction` a contradiction becomes a remark.

    Raises:
        InputError: there is no reference.
        UsageError: two recordings contradict each other, their settings differ, or one is given
            twice.
    """
    if data.comparison is not None or len(data.recordings) < 2:
        return data
    disagreement = find_disagreement(data)
    if disagreement is None:
        return replace(data, comparison=(), changed_sessions=data.changed_sessions)
    problem = _problem(disagreement, data.board)
    if not data.allows_contradiction:
        raise UsageError(
            problem,
            "check that both recordings are of the same board on the same mount, and solve them "
            "separately. To solve them together anyway, give --allow-contradiction",
        )
    remark = f"{problem}; the recordings were solved together because --allow-contradiction is set"
    return replace(data, comparison=(remark,))


def find_disagreement(data: BoardData) -> GainDisagreement | None:
    """Return the recordings of a board that contradict each other most, None if all agree.

    Raises:
        InputError: there is no reference.
        UsageError: the settings of the board differ, or a recording is given twice.
    """
    data.check_recordings()
    # A list, because two recordings can have the same name.
    fits = [
        (name, fit) for k, name in enumerate(data.names) if (fit := _fit_alone(data, k)) is not None
    ]
    if len(fits) < 2:
        return None
    for with_causes in (False, True):
        if compare_gains([fit.estimate(name, with_causes) for name, fit in fits]) is None:
            return None
    searched = [(name, fit.searched()) for name, fit in fits]
    return compare_gains(
        [fit.estimate(name, with_causes=True) for name, fit in searched if fit.converged]
    )


def _fit_alone(data: BoardData, index: int) -> GainFit | None:
    """Return the fit of one recording, None if the recording cannot be fitted alone."""
    try:
        fit = data.kind.fit_gain(data, index)
    except InputError:
        return None
    return fit if fit is not None and fit.converged else None


def _problem(disagreement: GainDisagreement, board: str) -> str:
    unit = "" if disagreement.unit == "1" else f" {disagreement.unit}"
    sigma = f"{min(disagreement.sigma, MAX_SIGMA_STATED):.3g}"
    more = "more than " if disagreement.sigma > MAX_SIGMA_STATED else ""
    return (
        f"the recordings {disagreement.first} and {disagreement.second} contradict each other "
        f"about board {board}: {disagreement.parameter} differs by "
        f"{abs(disagreement.difference):.3g}{unit}, which is {more}{sigma} standard uncertainties"
    )
