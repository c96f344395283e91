"""The budget of a cause that needs more memory than the limit."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gyrorig_solver.estimate import ScoreStatistics
from gyrorig_solver.uncertainty import uncertainty_budget


def test_one_cause_above_the_memory_limit_keeps_its_statistics(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(uncertainty_budget, "whitened_effects", lambda *_: None)
    monkeypatch.setattr(uncertainty_budget, "MAX_JOINT_VALUES", 10)
    given = ScoreStatistics(np.eye(3), np.ones(3), np.ones(3), np.ones((3, 13)))
    projector: Any = SimpleNamespace(
        residual=np.zeros(10), board_parameters=13, score_statistics=lambda _: given
    )
    cause: Any = SimpleNamespace(signal_count=3)
    result = uncertainty_budget._joint_statistics(projector, [cause])
    assert result.absorbed.any()
