"""Reject recordings of one board that contradict each other before they are fitted together.

A model with one gain has no causes for two gains. A search would try every cause, take very long,
and name a wrong one.
"""

from collections.abc import Iterable
from dataclasses import replace

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_solver.discover import explain_fit
from gyrorig_solver.estimate import ConvergedFit
from gyrorig_solver.pipeline.board_data import BoardData, has_unit
from gyrorig_solver.pipeline.prepare_board import fit_base
from gyrorig_solver.uncertainty.gain_agreement import (
    GainDisagreement,
    GainEstimate,
    compare_gains,
)

MAX_SIGMA_STATED = 1000.0


def require_agreement(data: BoardData) -> BoardData:
    """Return the data of recordings whose gains agree.

    Each recording of a unit is fitted alone. If the gains differ by more than noise, causes are
    searched in each recording alone, and the gains with these causes are compared by their total
    uncertainty.

    Args:
        data: of one board. With `allows_contradiction` a contradiction becomes a remark.

    Raises:
        UsageError: two recordings contradict each other.
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
    """Return the recordings of a board that contradict each other most, None if all agree."""
    if not any(has_unit([recording]) for recording in data.recordings):
        return None
    singles = {
        single.recordings[0].path.name: single
        for single in _split(data)
        if has_unit(single.recordings)
    }
    fits = {name: fit for name, single in singles.items() if (fit := _fit_alone(single))}
    if len(fits) < 2:
        return None
    if compare_gains([GainEstimate.of(*item, with_causes=False) for item in fits.items()]) is None:
        return None
    if compare_gains([GainEstimate.of(*item, with_causes=True) for item in fits.items()]) is None:
        return None
    explained = {name: explain_fit(fit, data.board).solution_extended for name, fit in fits.items()}
    return compare_gains(
        [
            GainEstimate.of(*item, with_causes=True)
            for item in explained.items()
            if item[1].converged
        ]
    )


def _split(data: BoardData) -> Iterable[BoardData]:
    """Return the data of each recording alone."""
    for session, samples in zip(data.sessions, data.samples, strict=True):
        yield BoardData(data.board, (session[0],), (samples,), (session,))


def _fit_alone(data: BoardData) -> ConvergedFit | None:
    """Return the fit of one recording, None if the recording cannot be fitted alone."""
    try:
        fit = fit_base(data)
    except InputError:
        return None
    return fit if fit.converged else None


def _problem(disagreement: GainDisagreement, board: str) -> str:
    unit = "" if disagreement.unit == "1" else f" {disagreement.unit}"
    sigma = f"{min(disagreement.sigma, MAX_SIGMA_STATED):.3g}"
    more = "more than " if disagreement.sigma > MAX_SIGMA_STATED else ""
    return (
        f"the recordings {disagreement.first} and {disagreement.second} contradict each other "
        f"about board {board}: {disagreement.parameter} differs by "
        f"{abs(disagreement.difference):.3g}{unit}, which is {more}{sigma} standard uncertainties"
    )
