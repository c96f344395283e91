"""When a search repeats a fit that was in vain."""

from dataclasses import dataclass, field
from typing import Any, cast

from gyrorig_solver.discover.search_memory import SearchMemory
from gyrorig_solver.estimate.trust_region import Convergence

MODELS = 20


@dataclass
class Model:
    """A model of a search, as far as its memory looks at it."""

    labels: frozenset[str] = frozenset()
    convergence: Convergence = field(
        default_factory=lambda: Convergence(False, 40, 5.0, "backlash.gap.pan", 3.0)
    )


def memory() -> SearchMemory[Any]:
    return SearchMemory(cast(Any, Model()))


def test_a_fit_that_fails_is_repeated_after_more_and_more_models() -> None:
    search = memory()
    tried_in = []
    for model in range(MODELS):
        if "ringing" not in search.left_out:
            tried_in.append(model)
            search.leave_out("ringing", cast(Any, Model()))
        assert "ringing" in search.left_out  # not again in the same model
        search.visit(cast(Any, Model()))
    assert tried_in == [0, 1, 3, 7, 15]


def test_a_fit_that_waits_is_repeated_where_nothing_else_is_left() -> None:
    search = memory()
    for _ in range(2):
        search.postpone("ringing")
        search.visit(cast(Any, Model()))
    assert search.left_out == {"ringing"}
    assert search.retry_waiting()
    assert search.left_out == set()
    search.postpone("ringing")
    assert not search.retry_waiting()  # once in a model


def test_only_a_fit_without_convergence_is_reported() -> None:
    search = memory()
    search.postpone("s_curve")
    search.leave_out("ringing", cast(Any, Model()))
    (remark,) = search.remarks(cast(Any, Model()))
    assert remark.startswith("the cause ringing was left out: the fit did not converge")
