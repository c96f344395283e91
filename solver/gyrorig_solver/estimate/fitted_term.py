"""Terms of the catalogue with their values in a fit, in addition to gain, bias and time offset.

What to use when: `free_term` for a cause whose sizes are estimated; `fixed_term` for a cause with a
known size (the Earth's rotation); `GaussianPrior` for a cause that other boards on the unit have
measured too. `cascade` combines the effects of several terms.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.model import Term, value_indices, value_labels, value_parameters


@dataclass(frozen=True, slots=True, eq=False)
class GaussianPrior:
    """Gaussian prior on a term's fitted values, from the other boards on the same unit."""

    values: FloatArray  # (free,)
    information: FloatArray  # (free, free), inverse covariance; can be singular

    def score(self, current: FloatArray) -> FloatArray:
        """Return the score of the prior at some values, (free,)."""
        return np.asarray(self.information @ (self.values - current), dtype=np.float64)

    def cost(self, current: FloatArray) -> float:
        """Return the negative logarithm of the prior at some values (free,), nats."""
        return 0.5 * float((self.values - current) @ self.score(current))


@dataclass(frozen=True, slots=True, eq=False)
class FittedTerm:
    """One cause with its current values."""

    term: Term
    values: FloatArray  # (k,), of all its parameters
    free_indices: IntArray  # indices of the fitted values
    other_boards_prior: GaussianPrior | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the fitted values: cause, parameter, component."""
        names = value_labels(self.term)
        return tuple(names[index] for index in self.free_indices)

    @property
    def free_sizes(self) -> list[int]:
        """The indices of the fitted sizes among all values."""
        sizes = value_indices(self.term, role="size")
        return [int(index) for index in self.free_indices if index in sizes]

    @property
    def prior_std(self) -> FloatArray:
        """The prior standard deviations of the fitted values, shape (free,)."""
        parameters = value_parameters(self.term)
        return np.array(
            [parameters[index].prior_std for index in self.free_indices], dtype=np.float64
        )

    @property
    def is_active(self) -> bool:
        """Whether any size is not zero."""
        return bool(np.any(self.values[value_indices(self.term, role="size")]))

    def prior_cost(self) -> float:
        """Return the negative logarithm of the other boards' prior, nats; 0 without one."""
        if self.other_boards_prior is None:
            return 0.0
        return self.other_boards_prior.cost(self.values[self.free_indices])

    def with_step(self, step: FloatArray) -> Self:
        """Return the cause with its fitted values changed, each clipped to its range."""
        parameters = value_parameters(self.term)
        values = self.values.copy()
        values[self.free_indices] += step
        lower_bounds = np.array([parameter.lower for parameter in parameters])
        upper_bounds = np.array([parameter.upper for parameter in parameters])
        return replace(self, values=np.clip(values, lower_bounds, upper_bounds))


def free_term(term: Term) -> FittedTerm:
    """Return a cause with free sizes, and shapes at their start values."""
    values, sizes = _start_values(term), np.array(value_indices(term, role="size"), dtype=np.int64)
    if term.starts_at_typical_size:
        values[sizes] = [value_parameters(term)[k].typical_size for k in sizes]
    return FittedTerm(term, values, sizes)


def fixed_term(term: Term) -> FittedTerm:
    """Return a cause with all values fixed at their start values."""
    return FittedTerm(term, _start_values(term), np.zeros(0, dtype=np.int64))


def _start_values(term: Term) -> FloatArray:
    return np.array([p.start for p in value_parameters(term)], dtype=np.float64)
