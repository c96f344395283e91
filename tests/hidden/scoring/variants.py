"""The shipped solver, and deliberately degraded variants that the goals must detect.

The solver does not contain the variants: each variant patches a single rule from outside.

What to use when: `VARIANTS` by name; `explain` explains recordings, `change_line` can change the
result.
"""

import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any
from unittest.mock import patch

import numpy as np
from tests.hidden.scoring.stated import Explainer, StatedExplanation
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
from gyrorig_solver.estimate.noise.noise_levels import fit_noise_levels
from gyrorig_solver.estimate.noise.noise_model import Sampling
from gyrorig_solver.model.catalogue import catalogue

NEGLIGIBLE = 1e-9  # factor on a level: negligible, but its logarithm is finite
Line = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Variant:
    """One variant of the solver."""

    words: str
    explain: Explainer
    change_line: Callable[[Line, StatedExplanation], Line]


def _explain(recordings: Sequence[Recording], board: str) -> FitExplanation:
    return explain_recordings(recordings, board)


def _explain_white_only(recordings: Sequence[Recording], board: str) -> FitExplanation:
    """Weight all frequencies equally, as if the bias had no random walk."""

    def fit_white_levels(
        spectrum: Spectrum, sampling: Sampling, before: FloatArray | None = None
    ) -> NoiseModel:
        noise = fit_noise_levels(spectrum, sampling, before)
        white = noise.levels.copy()
        white[:, 1:] *= NEGLIGIBLE
        return NoiseModel(white, sampling)

    with ExitStack() as everywhere:
        for module in list(sys.modules.values()):
            if (
                getattr(module, "fit_noise_levels", None) is fit_noise_levels
                and module.__name__ != __name__
            ):
                everywhere.enter_context(patch.object(module, "fit_noise_levels", fit_white_levels))
        return _explain(recordings, board)


def _explain_without_projection(recordings: Sequence[Recording], board: str) -> FitExplanation:
    """Score causes without projecting out the base model."""

    def compute_bare_score(
        projection: NuisanceProjector, signals: WhitenedSignals
    ) -> ScoreStatistics:
        white = signals.dense()
        gram = white @ white.T
        taken = np.zeros((len(white), projection.board_parameters))
        return ScoreStatistics(gram, white @ projection.residual, np.diag(gram).copy(), taken)

    with patch.object(NuisanceProjector, "score_statistics", compute_bare_score):
        return _explain(recordings, board)


def _find_top_cause(solution: ConvergedFit) -> str:
    """Return the cause with the best score on the residual of a fit."""
    projection = NuisanceProjector.at_fit(solution)
    fitted_causes = {fitted_term.term.cause for fitted_term in solution.fitted_terms}
    terms = [term for term in testable_terms(projection) if term.cause not in fitted_causes]
    return scan_catalogue(projection, terms, count_tests(terms))[0].term.cause


def _keep_line(line: Line, _stated: StatedExplanation) -> Line:
    return line


def _name_top_score(line: Line, stated: StatedExplanation) -> Line:
    """State the cause with the best score on the base model's residual, always."""
    return _add_cause(line, [], _find_top_cause(stated.explanation.solution_base))


def _name_unexplained(line: Line, stated: StatedExplanation) -> Line:
    """Name the best-scoring cause instead of an unexplained rest."""
    if not line["unexplained"]:
        return line
    return _add_cause(line, line["causes"], _find_top_cause(stated.explanation.solution_extended))


def _exchange_names(line: Line, _stated: StatedExplanation) -> Line:
    """Replace each cause by its neighbour in the catalogue."""
    names = sorted(cause for cause, term in catalogue().items() if term.kind in ("effect", "raw"))
    other = dict(zip(names, [*names[1:], names[0]], strict=True))

    def rename_sets(entries: Sequence[Line]) -> list[Line]:
        return [
            {**entry, "set": [other.get(name, name) for name in entry["set"]]} for entry in entries
        ]

    return {**line, "causes": rename_sets(line["causes"]), "raw": rename_sets(line["raw"])}


def _add_cause(line: Line, causes: Sequence[Line], cause: str) -> Line:
    named = {"set": [cause], "where": [], "values": {}, "free": 0, "sizes": []}
    return {**line, "causes": [*causes, named], "unexplained": [], "verdict": "explained"}


REAL = "real"
VARIANTS = {
    REAL: Variant("the shipped solver", _explain, _keep_line),
    "top-score": Variant("always names the top score", _explain, _name_top_score),
    "never-unknown": Variant("never reports a rest", _explain, _name_unexplained),
    "white-only": Variant("assumes white noise", _explain_white_only, _keep_line),
    "no-projection": Variant(
        "does not project out the base model", _explain_without_projection, _keep_line
    ),
    "shuffled": Variant("exchanges the names", _explain, _exchange_names),
}
