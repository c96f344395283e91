"""Which of many similar cases `make test` runs; `make test-long` runs the others."""

from collections.abc import Collection, Iterable
from typing import Any

import pytest


def quick_cases(cases: Iterable[Any], quick: Collection[Any]) -> list[Any]:
    """Return the cases as parameters of a test; those that are not quick are marked `long`."""
    listed = list(cases)
    missing = [case for case in quick if case not in listed]
    if missing:
        raise ValueError(f"not among the cases: {missing}")
    return [case if case in quick else _long(case) for case in listed]


def _long(case: Any) -> Any:
    values = case if isinstance(case, tuple) else (case,)
    return pytest.param(*values, marks=pytest.mark.long)
