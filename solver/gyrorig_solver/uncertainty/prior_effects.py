"""Effects of the causes that a fit has not identified, each scaled by its prior size.

A cause is represented by signals whose amplitudes are independent with mean zero and variance one.
Together they have the covariance of the cause's effect under its prior:

- each size (axis, cosine, sine) is one signal;
- a cause with an unknown shape or time, such as a time constant or the instant of a step, is
  represented by several of its templates with equal shares of the variance;
- a persistent cause of the unit is represented by the start values of its shapes, because its
  sizes must mean the same in every recording;
- a nonlinear cause (dead band, backlash) is represented by its effect at the prior size.

What to use when: `unidentified_causes` for a projector; `whitened_effects` for their signals.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.discover.testable_terms import acting_instances
from gyrorig_solver.estimate import FittedTerm, NuisanceProjector, WhitenedSignals, join_signals
from gyrorig_solver.model import (
    SignalState,
    Term,
    components_of,
    is_active_in,
    start_values,
    term_label,
    value_indices,
)
from gyrorig_solver.model.catalogue import catalogue
from gyrorig_solver.uncertainty.uncertainty_settings import PriorSize, UncertaintySettings

# Number of templates that represent a cause with unknown times, or with other unknown shapes.
EVENT_TEMPLATES, SHAPE_TEMPLATES = 3, 2


@dataclass(frozen=True, slots=True, eq=False)
class UnidentifiedCause:
    """A cause with a prior size, of which a fit has not identified some or all sizes.

    If the fit has identified one of its sizes, the cause is present: its probability is 1.
    """

    term: Term
    prior: PriorSize
    positions: tuple[int, ...]  # of the sizes that were not fitted, among all its sizes
    templates: FloatArray  # (b, k)

    @property
    def places(self) -> tuple[str | None, ...]:
        """The place of each signal: x, y, z, pan, tilt; None if it has no place."""
        sizes = value_indices(self.term, role="size")
        parts = components_of(self.term)
        places = []
        for position in self.positions:
            matching = (p for p in parts if sizes[position] in value_indices(self.term, p, "size"))
            places.append(next(matching, None))
        return tuple(places) * len(self.templates)

    @property
    def signal_count(self) -> int:
        """The number of signals that represent the cause."""
        return len(self.positions) * len(self.templates)


def unidentified_causes(
    projector: NuisanceProjector,
    fitted_terms: Sequence[FittedTerm],
    settings: UncertaintySettings,
    terms: Mapping[str, Term] | None = None,
) -> list[UnidentifiedCause]:
    """Return each cause with a prior size, without the sizes that were fitted.

    Args:
        projector: at the fit.
        fitted_terms: of the fit.
        settings: prior sizes.
        terms: all causes by id; None: those of the catalogue.
    """
    terms = catalogue() if terms is None else terms
    fitted_sizes = {
        term_label(fitted.term): set(fitted.free_indices.tolist()) for fitted in fitted_terms
    }
    causes = []
    for cause, prior in settings.prior_sizes.items():
        for term in _instances(terms[cause], projector) if prior.size > 0.0 else []:
            fitted = fitted_sizes.get(term_label(term), set())
            sizes = value_indices(term, role="size")
            positions = tuple(k for k, index in enumerate(sizes) if index not in fitted)
            templates = prior_templates(term, projector.states, prior)
            if positions and len(templates):  # a motor at rest loses no steps
                is_present = len(positions) < len(sizes)
                known = replace(prior, probability=1.0) if is_present else prior
                causes.append(UnidentifiedCause(term, known, positions, templates))
    return causes


def whitened_effects(
    projector: NuisanceProjector, causes: Sequence[UnidentifiedCause]
) -> WhitenedSignals:
    """Return the effects of causes, whitened and in units of their priors."""
    return join_signals(
        [
            projector.evaluate_signals(partial(_scaled_effects, cause), term=cause.term)
            for cause in causes
        ]
    )


def _scaled_effects(cause: UnidentifiedCause, state: SignalState) -> FloatArray:
    """Return the effects of all templates in units of their prior, (signals, blocks, 3)."""
    return np.concatenate([scaled_tangents(cause, row, state) for row in cause.templates])


def _instances(term: Term, projector: NuisanceProjector) -> list[Term]:
    """Return a cause once per recording that can have it.

    A gauge cause acts although the data never show it. A brief cause acts although the averaging of
    a long recording hides it.
    """
    if term.kind == "gauge":
        return [] if any(state.lacks_angles for state in projector.states) else [term]
    return acting_instances(term, projector)


def scaled_tangents(cause: UnidentifiedCause, row: FloatArray, state: SignalState) -> FloatArray:
    """Return the effects of one template in units of its prior, (sizes, blocks, 3)."""
    scale = cause.prior.std / len(cause.templates) ** 0.5
    tangents = cause.term.tangent_signals(state, row)[list(cause.positions)]
    return np.asarray(scale * tangents, dtype=np.float64)


def prior_templates(term: Term, states: Sequence[SignalState], prior: PriorSize) -> FloatArray:
    """Return templates (b, k) that represent the shapes of a cause, at its prior size.

    Args:
        term: the cause.
        states: of all parts of the recordings.
        prior: of its sizes.
    """
    banks = [term.template_bank(state) for state in states if is_active_in(term, state)]
    templates = np.concatenate(banks)
    sizes = value_indices(term, role="size")
    if term.is_persistent:
        shapes = value_indices(term, role="shape")
        templates[:, shapes] = start_values(term)[shapes]
    is_linear = bool((templates[:, sizes] == 0.0).all(axis=1).any())
    templates[:, sizes] = 0.0 if is_linear else prior.size
    _, first = np.unique(templates, axis=0, return_index=True)
    templates = templates[np.sort(first)]
    has_event = bool(value_indices(term, role="event"))
    count = min(EVENT_TEMPLATES if has_event else SHAPE_TEMPLATES, len(templates))
    chosen = (np.arange(count) + 0.5) * len(templates) / count
    return np.asarray(templates[chosen.astype(np.int64)], dtype=np.float64)
