"""Checks of a model after the search: one signature for all.

A check examines the model that the search found and returns a verdict. It can remove names, name
causes that the mean of the residual does not show, or explain tests of the residual. The checks run
in the order of a list (`MOTION_CHECKS`, `ATTITUDE_CHECKS`). To add a check, write a class with
`judge` in a file of this folder, and add it to a list.

What to use when: `judge_model` for the result of a search.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Generic, Protocol

from gyrorig_solver.discover.cause_findings import (
    DependenceTest,
    DetectionLimit,
    NamedCause,
    UnexplainedResidual,
    UntestableCause,
)
from gyrorig_solver.discover.cause_ranking import RankedCause
from gyrorig_solver.discover.cause_search import SearchResult
from gyrorig_solver.discover.fit_space import Space
from gyrorig_solver.discover.testable_terms import count_tests, select_testable

# Tests that do not show a change of the mean.
VARIANCE_COVARIATES = ("moving", "acceleration_scatter", "line", "wandering")
DEPENDENCE_FALSE_ALARM_RATE = 0.001  # share of recordings with an unexplained dependence by chance
Tests = Sequence[DependenceTest]


def _keep_all(tests: Tests) -> Tests:
    return tests


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """The result of a check; the default is that the model is right."""

    removed: tuple[bool, ...] = ()  # whether each cause of the search loses its name
    rejecting_tests: tuple[DependenceTest, ...] = ()  # reported as unexplained in any case
    unexplained: UnexplainedResidual | None = None  # reported if the refit shows nothing else
    named: tuple[NamedCause, ...] = ()  # causes that the fit does not contain
    detection_limits: tuple[DetectionLimit, ...] = ()
    untestable: tuple[UntestableCause, ...] = ()
    covered_causes: frozenset[str] = frozenset()  # causes without other limits than those above
    dependence_tests: tuple[DependenceTest, ...] | None = None  # in place of those of the model
    # Returns the tests that the named causes do not explain.
    explain_tests: Callable[[Tests], Tests] = _keep_all
    remarks: tuple[str, ...] = ()


class JudgedModel(Generic[Space]):
    """The model that a search found, with the verdicts so far."""

    def __init__(
        self,
        base: Space,
        result: SearchResult[Space],
        verdicts: dict["Check[Space]", Verdict] | None = None,
    ) -> None:
        """Start from the base model and the result of a search."""
        self.base, self.result, self.verdicts = base, result, verdicts or {}

    @property
    def space(self) -> Space:
        """The fit."""
        return self.result.space

    @cached_property
    def tests(self) -> int:
        """The number of tests that share the false alarms."""
        return count_tests(select_testable(self.base.terms.values(), self.result.projector))

    @property
    def fitted_causes(self) -> list[tuple[int, RankedCause]]:
        """Each fitted cause's index in the fit, with its ranking."""
        return list(zip(self.space.free_causes, self.result.ranked_causes, strict=True))

    @property
    def dependence_tests(self) -> Tests:
        """The tests of the residual, including those that named causes explain."""
        replaced = [v.dependence_tests for v in self.verdicts.values() if v.dependence_tests]
        return replaced[-1] if replaced else self._own_dependence_tests

    @cached_property
    def _own_dependence_tests(self) -> Tests:
        return self.space.dependence_tests(self.result.projector)

    @property
    def unexplained(self) -> UnexplainedResidual | None:
        """The significant tests that no named cause explains."""
        remaining = self.dependence_tests
        for verdict in self.verdicts.values():
            remaining = verdict.explain_tests(remaining)
        rejecting = [test for verdict in self.verdicts.values() for test in verdict.rejecting_tests]
        significant = {test.key: test for test in rejecting}
        significant |= {
            test.key: test for test in remaining if test.p_value < DEPENDENCE_FALSE_ALARM_RATE
        }
        if not significant:
            earlier = [v.unexplained for v in self.verdicts.values() if v.unexplained is not None]
            return earlier[0] if earlier else None
        # A dependence of the mean also increases the scatter, so it comes before tests of the
        # scatter. Several covariates can show the same effect. The one with the most evidence
        # comes first, not the one with the smallest p-value.
        ordered = sorted(
            significant.values(),
            key=lambda test: (test.covariate in VARIANCE_COVARIATES, -test.log_evidence),
        )
        named = sum(r.statistic for k, r in self.fitted_causes if self.is_named(k))
        largest = max(test.excess for test in ordered)
        share = named / (named + largest) if named > 0.0 else 0.0
        return UnexplainedResidual(ordered[0], tuple(ordered[1:]), share)

    def is_named(self, k: int) -> bool:
        """Return whether a cause of the fit is stated by its name."""
        return not self.space.fitted_terms[k].term.nameless_description

    def without(self, removed: Sequence[bool]) -> "JudgedModel[Space]":
        """Return the model without some causes, with everything else refitted.

        If the fit with the other causes does not converge, all causes are removed.

        Args:
            removed: whether each ranked cause is removed.
        """
        dropped = [k for (k, _), out in zip(self.fitted_causes, removed, strict=True) if out]
        others = self.space.terms_without(*dropped)
        space = self.base if all(removed) else self.space.refit(others).confirm()
        if not space.convergence.converged:
            space = self.base.refit(others).confirm()
        if not space.convergence.converged:
            space, removed = self.base, [True] * len(removed)
        ranked = zip(self.result.ranked_causes, removed, strict=True)
        result = replace(
            self.result,
            space=space,
            ranked_causes=tuple(cause for cause, out in ranked if not out),
            projector=space.projector(),
        )
        return JudgedModel(self.base, result, self.verdicts)


class Check(Protocol[Space]):
    """A check of a model after the search."""

    removes_names: bool  # False: the verdict is about the residual, which a removed name changes

    def judge(self, model: JudgedModel[Space]) -> Verdict:
        """Return the verdict on a model."""
        ...


def judge_model(model: JudgedModel[Space], checks: Sequence[Check[Space]]) -> JudgedModel[Space]:
    """Run checks one after the other; if a cause loses its name, refit the model without it.

    The refitted model has another residual. Therefore the earlier checks that do not remove names
    are repeated.
    """
    for check in checks:
        verdict = check.judge(model)
        if any(verdict.removed):
            model = model.without(verdict.removed)
            for earlier in model.verdicts:
                if not earlier.removes_names:
                    model.verdicts[earlier] = earlier.judge(model)
        model.verdicts[check] = verdict
    return model
