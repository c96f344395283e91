"""Causes of the catalogue as unknowns of a fit, beside gain, bias and time offset.

What to use when: `fitted` for a cause whose sizes are to be found, `known` for one whose
size is known beforehand (the Earth's rotation); `effect_of` and `columns_of` in a fit.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from gyrorig_solver.arrays import FloatArray, IntArray
from gyrorig_solver.model.terms.bound import labels
from gyrorig_solver.model.terms.protocol import Term, indices, value_parameters
from gyrorig_solver.model.terms.scene import Scene


@dataclass(frozen=True, slots=True, eq=False)
class Extension:
    """One cause with its values of now."""

    term: Term
    values: FloatArray  # (k,), of all its parameters
    free: IntArray  # which of them are fitted

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


def effect_of(extensions: Sequence[Extension], scene: Scene) -> FloatArray:
    """Return what the causes together change, (blocks, 3), sensor frame."""
    total = np.zeros((scene.blocks, 3))
    for one in extensions:
        total += one.term.effect(scene, one.values)
    return total


def columns_of(extensions: Sequence[Extension], scene: Scene) -> FloatArray:
    """Return the derivatives by all fitted values, (k, blocks, 3)."""
    found = [one.term.columns(scene, one.values)[one.free] for one in extensions if one.free.size]
    return np.concatenate(found) if found else np.zeros((0, scene.blocks, 3))


def _starts(term: Term) -> FloatArray:
    return np.array([p.start for p in value_parameters(term)], dtype=np.float64)
