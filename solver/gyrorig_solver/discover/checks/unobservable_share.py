"""Removes the names of causes that are confounded with the gain and have no observable size.

A relative error of the steps has the same effect as an error of the gain. Only the unit's replies
separate the two. The search can accept such a cause before other causes; after these are fitted,
its effect belongs to the gain.
"""

import numpy as np

from gyrorig_solver.discover.checks.model_check import JudgedModel, Verdict
from gyrorig_solver.discover.fit_space import FitSpace, Space
from gyrorig_solver.discover.fitted_values import value_stds


class UnobservableShareCheck:
    """Removes the names of causes whose share of the gain is not observable."""

    removes_names = True

    def judge(self, model: JudgedModel[Space]) -> Verdict:
        """Return the causes without an observable size."""
        return Verdict(tuple(_is_unobservable(model.space, k) for k, _ in model.fitted_causes))


def _is_unobservable(space: FitSpace, k: int) -> bool:
    extension = space.fitted_terms[k]
    sizes = extension.free_sizes
    if not extension.term.confounded_with_gain or not sizes:
        return False
    return bool(np.isinf(value_stds(space, k)[sizes]).all())
