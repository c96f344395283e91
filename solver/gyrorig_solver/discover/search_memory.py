"""Memory of a search for causes: the models that it visited, and the fits that failed.

What to use when: one `SearchMemory` per search.
"""

from collections import Counter
from typing import Generic

from gyrorig_solver.discover.fit_space import FitSpace, Space


class SearchMemory(Generic[Space]):
    """The visited models, and the candidates whose full fit did not converge or gained nothing.

    In a model with other causes, such a fit can converge or gain. But it takes long, and after
    several failures it usually fails again. Therefore a candidate waits until the search has
    visited 0, 1, 3, 7 more models, or until no other cause can be added.
    """

    def __init__(self, base: Space) -> None:
        """Start with the fit of the base model."""
        self.visited: list[Space] = [base]
        self._failed: set[str] = set()  # labels of failures in the present model
        self._waiting: dict[str, int] = {}  # models until the fit is repeated, by label
        self._failures: Counter[str] = Counter()
        self._reasons: dict[str, str] = {}
        self.failed_fits = 0  # that did not converge

    @property
    def left_out(self) -> set[str]:
        """The labels of the candidates that are not fitted in the present model."""
        return self._failed | self._waiting.keys()

    def visit(self, space: Space) -> None:
        """Store a model as the present one."""
        self.visited.append(space)
        waiting = {label: count - 1 for label, count in self._waiting.items()}
        waiting |= {label: 2 ** (self._failures[label] - 1) - 1 for label in self._failed}
        self._waiting = {label: count for label, count in waiting.items() if count}
        self._failed.clear()

    def leave_out(self, label: str, space: FitSpace) -> None:
        """Leave a candidate out of the present model, because the fit `space` did not converge."""
        self.postpone(label)
        self.failed_fits += 1
        self._reasons[label] = space.convergence.reason

    def postpone(self, label: str) -> None:
        """Leave a candidate out of the present model, because its fit failed or gained nothing."""
        self._failed.add(label)
        self._failures[label] += 1

    def retry_waiting(self) -> bool:
        """Allow fits of all waiting candidates; return whether there are any."""
        has_waiting = bool(self._waiting)
        self._waiting.clear()
        return has_waiting

    def remarks(self, final: FitSpace) -> tuple[str, ...]:
        """Return a remark for each candidate without convergence that is not in the final model."""
        return tuple(
            f"the cause {label} was left out: {reason}"
            for label, reason in self._reasons.items()
            if label not in final.labels
        )
