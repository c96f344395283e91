"""What a recording could have shown of the causes that were not found, and what it could not.

What to use when: `limits` once the search has ended.
"""

from collections.abc import Sequence

import numpy as np

from gyrorig_solver.discover.changes import PARAMETERS, Board, own_part
from gyrorig_solver.discover.result import Limit, NotTestable
from gyrorig_solver.discover.scatter_names import wandering
from gyrorig_solver.discover.scores import Sight
from gyrorig_solver.estimate.projection import Projection
from gyrorig_solver.model.terms.bound import recording_of
from gyrorig_solver.model.terms.catalogue import catalogue
from gyrorig_solver.model.terms.protocol import indices, places, value_parameters


def limits(
    projection: Projection, found: Sequence[Sight], board: Board, recordings: int
) -> tuple[tuple[Limit, ...], tuple[NotTestable, ...]]:
    """Return how large each cause may be unseen, and which could not be looked at.

    Args:
        projection: the space beside the last fit.
        found: all sights beside it.
        board: the calibration of that fit.
        recordings: how many there are.
    """
    absent: list[Limit] = []
    blind: list[NotTestable] = []
    # The calibration is the last recording's: what is another's cannot harm it.
    found = [s for s in found if recording_of(s.term) in (None, recordings - 1)]
    several = {s.term.cause for s in found if s.place is not None}
    for sight in found:
        if sight.place is None and sight.term.cause in several:
            continue  # said place by place
        own = value_parameters(sight.term)[indices(sight.term, sight.place, "size")[0]]
        shown = sight.detectable
        size = shown.detectable * own.typical
        if not np.isfinite(size) or size > max(abs(own.lower), abs(own.upper)):
            blind.append(NotTestable(sight.term.cause, sight.place, sight.term.excitation))
            continue
        moved = np.abs(board.moved(own_part(shown.moved, recordings))) / board.std
        worst = int(np.nanargmax(moved)) if np.isfinite(moved).any() else 0
        harm = float(moved[worst]) if np.isfinite(moved[worst]) else 0.0
        absent.append(
            Limit(
                sight.term.cause,
                sight.place,
                size,
                own.unit,
                own.typical,
                PARAMETERS[worst],
                harm,
            )
        )
    absent.sort(key=lambda one: -one.harm_sigma)
    return tuple(absent), (*blind, *_elsewhere(projection, found))


def _elsewhere(projection: Projection, found: Sequence[Sight]) -> list[NotTestable]:
    """Return the causes that no residual of these recordings can show, and why."""
    why: list[NotTestable] = []
    scene = projection.scenes[0]
    shown = {(s.term.cause, s.place) for s in found}
    for cause, term in catalogue().items():
        if term.kind == "gauge":
            why.append(NotTestable(cause, None, term.excitation))
        elif term.kind == "stochastic" and cause != "sample_jitter":
            why.append(NotTestable(cause, None, wandering(projection)))
        elif term.kind in ("effect", "known"):
            missing = term.missing(scene)
            if missing is not None:
                why.append(NotTestable(cause, None, missing))
            elif any(c == cause for c, _ in shown):
                gone = [p for p in places(term) if p in ("pan", "tilt", "x", "y", "z")]
                why += [
                    NotTestable(cause, place, term.excitation)
                    for place in gone
                    if len(gone) > 1
                    and (cause, place) not in shown
                    and any(p is not None for c, p in shown if c == cause)
                ]
    return why
