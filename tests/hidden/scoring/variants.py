"""The finder as it ships, and finders made worse on purpose, which the goals must catch.

Nothing of the product knows of these: each takes one of its rules away from outside.

What to use when: `VARIANTS` by name; `explain` looks at recordings, `said` may change the words.
"""

import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any
from unittest.mock import patch

import numpy as np
from tests.hidden.scoring.stated import Look, Stated

from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.discover import finder
from gyrorig_solver.discover.result import Explained
from gyrorig_solver.discover.scores import sights
from gyrorig_solver.discover.search import testable, tests_of
from gyrorig_solver.estimate.likelihood import Solution
from gyrorig_solver.estimate.noise import NoiseModel, Sampling, Spectrum, fit_levels
from gyrorig_solver.estimate.projection import Looked, Projection
from gyrorig_solver.model.terms.catalogue import catalogue

WHITE = 1e-9  # of a level: as good as none, and still a logarithm
Line = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Variant:
    """One finder."""

    words: str
    explain: Look
    said: Callable[[Line, Stated], Line]


def _explain(recordings: Sequence[Recording], board: str) -> Explained:
    return finder.explain(recordings, board)


def _white_only(recordings: Sequence[Recording], board: str) -> Explained:
    """Weigh all frequencies alike: the bias of no board wanders."""

    def levels(
        spectrum: Spectrum, sampling: Sampling, before: FloatArray | None = None
    ) -> NoiseModel:
        noise = fit_levels(spectrum, sampling, before)
        white = noise.levels.copy()
        white[:, 1:] *= WHITE
        return NoiseModel(white, sampling)

    with ExitStack() as everywhere:
        for module in list(sys.modules.values()):
            if getattr(module, "fit_levels", None) is fit_levels and module.__name__ != __name__:
                everywhere.enter_context(patch.object(module, "fit_levels", levels))
        return _explain(recordings, board)


def _no_projection(recordings: Sequence[Recording], board: str) -> Explained:
    """Score causes as if the base model followed nothing."""

    def bare(projection: Projection, white: FloatArray) -> Looked:
        gram = white @ white.T
        taken = np.zeros((len(white), projection.board))
        return Looked(gram, white @ projection.residual, np.diag(gram).copy(), taken)

    with patch.object(Projection, "look", bare):
        return _explain(recordings, board)


def _top(solution: Solution) -> str:
    """Return the cause with the best score beside a fit."""
    projection = Projection.of(solution)
    taken = {one.term.cause for one in solution.extensions}
    terms = [term for term in testable(projection) if term.cause not in taken]
    return sights(projection, terms, tests_of(terms))[0].term.cause


def _as_it_is(line: Line, _stated: Stated) -> Line:
    return line


def _top_score(line: Line, stated: Stated) -> Line:
    """Say what the first pass over the base model's residual scores best, whatever it is."""
    return _named(line, [], _top(stated.explained.solution_base))


def _never_unknown(line: Line, stated: Stated) -> Line:
    """Say what comes nearest to a rest instead of that there is one."""
    if not line["unexplained"]:
        return line
    return _named(line, line["causes"], _top(stated.explained.solution_extended))


def _shuffled(line: Line, _stated: Stated) -> Line:
    """Say each cause's neighbour in the catalogue."""
    names = sorted(cause for cause, term in catalogue().items() if term.kind in ("effect", "raw"))
    other = dict(zip(names, [*names[1:], names[0]], strict=True))

    def renamed(ones: Sequence[Line]) -> list[Line]:
        return [{**one, "set": [other.get(name, name) for name in one["set"]]} for one in ones]

    return {**line, "causes": renamed(line["causes"]), "raw": renamed(line["raw"])}


def _named(line: Line, causes: Sequence[Line], cause: str) -> Line:
    own = {"set": [cause], "where": [], "values": {}, "free": 0, "sizes": []}
    return {**line, "causes": [*causes, own], "unexplained": [], "verdict": "explained"}


REAL = "real"
VARIANTS = {
    REAL: Variant("the finder as it ships", _explain, _as_it_is),
    "top-score": Variant("always names the top score", _explain, _top_score),
    "never-unknown": Variant("never admits a rest", _explain, _never_unknown),
    "white-only": Variant("takes all noise for white", _white_only, _as_it_is),
    "no-projection": Variant("takes nothing out that the base follows", _no_projection, _as_it_is),
    "shuffled": Variant("has its names exchanged", _explain, _shuffled),
}
