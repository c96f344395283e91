"""The shipped solver, and deliberately degraded variants that the goals must detect.

The product does not know the variants: each one patches a single rule from outside.

What to use when: `VARIANTS` by name; `explain` explains recordings, `line_of` can change
the result.
"""

import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any
from unittest.mock import patch

import numpy as np
from tests.hidden.scoring.stated import Look, StatedExplanation
from tests.support.board_fits import explain_recordings

from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.data import FloatArray
from gyrorig_solver.discover import FitExplanation
from gyrorig_solver.discover.score_tests import scan_catalogue
from gyrorig_solver.discover.testable_terms import count_tests, testable_terms
from gyrorig_solver.estimate import (
    ConvergedFit,
    NoiseModel,
    NuisanceProjector,
    ScoreStatistics,
    Spectrum,
    WhitenedSignals,
)
from gyrorig_solver.estimate.noise.noise_model import Sampling, fit_noise_levels
from gyrorig_solver.model.catalogue import catalogue

WHITE = 1e-9  # factor on a level: negligible, but its logarithm is finite
Line = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Variant:
    """One variant of the solver."""

    words: str
    explain: Look
    line_of: Callable[[Line, StatedExplanation], Line]


def _explain(recordings: Sequence[Recording], board: str) -> FitExplanation:
    return explain_recordings(recordings, board)


def _white_only(recordings: Sequence[Recording], board: str) -> FitExplanation:
    """Weight all frequencies equally, as if the bias had no random walk."""

    def levels(
        spectrum: Spectrum, sampling: Sampling, before: FloatArray | None = None
    ) -> NoiseModel:
        noise = fit_noise_levels(spectrum, sampling, before)
        white = noise.levels.copy()
        white[:, 1:] *= WHITE
        return NoiseModel(white, sampling)

    with ExitStack() as everywhere:
        for module in list(sys.modules.values()):
            if (
                getattr(module, "fit_noise_levels", None) is fit_noise_levels
                and module.__name__ != __name__
            ):
                everywhere.enter_context(patch.object(module, "fit_noise_levels", levels))
        return _explain(recordings, board)


def _no_projection(recordings: Sequence[Recording], board: str) -> FitExplanation:
    """Score causes without projecting out the base model."""

    def bare(projection: NuisanceProjector, signals: WhitenedSignals) -> ScoreStatistics:
        white = signals.dense()
        gram = white @ white.T
        taken = np.zeros((len(white), projection.board_parameters))
        return ScoreStatistics(gram, white @ projection.residual, np.diag(gram).copy(), taken)

    with patch.object(NuisanceProjector, "score_statistics", bare):
        return _explain(recordings, board)


def _top(solution: ConvergedFit) -> str:
    """Return the cause with the best score on the residual of a fit."""
    projection = NuisanceProjector.at_fit(solution)
    taken = {fitted_term.term.cause for fitted_term in solution.fitted_terms}
    terms = [term for term in testable_terms(projection) if term.cause not in taken]
    return scan_catalogue(projection, terms, count_tests(terms))[0].term.cause


def _as_it_is(line: Line, _stated: StatedExplanation) -> Line:
    return line


def _top_score(line: Line, stated: StatedExplanation) -> Line:
    """State the cause with the best score on the base model's residual, always."""
    return _named(line, [], _top(stated.explained.solution_base))


def _never_unknown(line: Line, stated: StatedExplanation) -> Line:
    """Name the best-scoring cause instead of an unexplained rest."""
    if not line["unexplained"]:
        return line
    return _named(line, line["causes"], _top(stated.explained.solution_extended))


def _shuffled(line: Line, _stated: StatedExplanation) -> Line:
    """Replace each cause by its neighbour in the catalogue."""
    names = sorted(cause for cause, term in catalogue().items() if term.kind in ("effect", "raw"))
    other = dict(zip(names, [*names[1:], names[0]], strict=True))

    def renamed(ones: Sequence[Line]) -> list[Line]:
        return [
            {**entry, "set": [other.get(name, name) for name in entry["set"]]} for entry in ones
        ]

    return {**line, "causes": renamed(line["causes"]), "raw": renamed(line["raw"])}


def _named(line: Line, causes: Sequence[Line], cause: str) -> Line:
    named = {"set": [cause], "where": [], "values": {}, "free": 0, "sizes": []}
    return {**line, "causes": [*causes, named], "unexplained": [], "verdict": "explained"}


REAL = "real"
VARIANTS = {
    REAL: Variant("the shipped solver", _explain, _as_it_is),
    "top-score": Variant("always names the top score", _explain, _top_score),
    "never-unknown": Variant("never reports a rest", _explain, _never_unknown),
    "white-only": Variant("assumes white noise", _white_only, _as_it_is),
    "no-projection": Variant("does not project out the base model", _no_projection, _as_it_is),
    "shuffled": Variant("exchanges the names", _explain, _shuffled),
}
