"""Causes of the catalogue as unknowns of a fit, beside gain, bias and time offset.

What to use when: `fitted` for a cause whose sizes are to be found, `known` for one whose
size is known beforehand (the Earth's rotation), `Told` for one that other boards of the
unit have measured too. `chain` has what several do together.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from gyrorig_solver.arrays import FloatArray, IntArray
from gyrorig_solver.model.terms.bound import labels
from gyrorig_solver.model.terms.protocol import Term, indices, value_parameters


@dataclass(frozen=True, slots=True, eq=False)
class Told:
    """What others know of a cause's fitted values: the other boards on the same unit."""

    values: FloatArray  # (free,), where they have them
    information: FloatArray  # (free, free), inverse covariance; singular where they know nothing

    def pull(self, now: FloatArray) -> FloatArray:
        """Return the score that this knowledge has at some values, (free,)."""
        return np.asarray(self.information @ (self.values - now), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Extension:
    """One cause with its values of now."""

    term: Term
    values: FloatArray  # (k,), of all its parameters
    free: IntArray  # which of them are fitted
    told: Told | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the fitted values: cause, parameter, part."""
        own = labels(self.term)
        return tuple(own[k] for k in self.free)

    @property
    def prior_std(self) -> FloatArray:
        """How far the fitted values of real rigs may lie from zero, shape (free,)."""
        own = value_parameters(self.term)
        return np.array([own[k].prior_std for k in self.free], dtype=np.float64)

    @property
    def acts(self) -> bool:
        """Whether it does anything at all: some size is not zero."""
        return bool(np.any(self.values[indices(self.term, role="size")]))

    def moved(self, step: FloatArray) -> Self:
        """Return the cause with its fitted values changed, each inside its range."""
        own = value_parameters(self.term)
        values = self.values.copy()
        values[self.free] += step
        low = np.array([p.lower for p in own])
        high = np.array([p.upper for p in own])
        return replace(self, values=np.clip(values, low, high))


def fitted(term: Term) -> Extension:
    """Return a cause with its sizes free and its shapes where they begin."""
    return Extension(term, _starts(term), np.array(indices(term, role="size"), dtype=np.int64))


def known(term: Term) -> Extension:
    """Return a cause whose values are what its parameters begin with."""
    return Extension(term, _starts(term), np.zeros(0, dtype=np.int64))


def _starts(term: Term) -> FloatArray:
    return np.array([p.start for p in value_parameters(term)], dtype=np.float64)
