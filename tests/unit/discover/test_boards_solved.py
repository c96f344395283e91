"""`solve --extend` for boards on one unit: what is the unit's is fitted once, for all of them."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gyrorig_protocol.identity import BoardId
from gyrorig_solver.pipeline import AUTO, CriticisedFit, fit_together

pytestmark = pytest.mark.long

BOARDS = [BoardId("GY80-1"), BoardId("GY80-2")]
LENGTH_S = 0.03
FAR = 4.0  # standard deviations


@pytest.fixture(scope="module")
def recording(hidden: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Two boards on a unit that rounds its ramps."""
    config = tmp_path_factory.mktemp("rig") / "rig.yaml"
    boards = "".join(
        f"  - {{id: {name}, port: emulated, baud: 460800, format: gcb1}}\n" for name in BOARDS
    )
    config.write_text(
        "schema: gyrorig/rig/1\nrig: two\nptu: {port: emulated, baud: 115200}\n"
        f"boards:\n{boards}emulator: {{seed: 1, dialect: e46, odr_hz: 100, bandwidth_hz: 25.0}}\n",
        encoding="utf-8",
    )
    session = hidden(f"s_curve:{LENGTH_S}", seed=3, program="quick", config=Path(config))
    return session.recording


@pytest.mark.parametrize("asked", [AUTO, "axis_nonorthogonality"])
def test_the_units_cause_has_one_size(recording: Any, asked: str) -> None:
    fits = fit_together([recording], BOARDS, extend=(asked,))
    assert list(fits) == BOARDS
    sizes, together = [], []
    for board_fit in fits.values():
        assert isinstance(board_fit, CriticisedFit)
        name = "s_curve" if asked == AUTO else asked
        assert name in board_fit.fit.terms
        (cause,) = (each for each in board_fit.fit.causes if each.name.startswith(name))
        values, stds = cause.value, cause.std
        sizes.append((values, stds))
        together.append(board_fit.fit.sharing.fitted_together)
        assert (board_fit.explanation is not None) == (asked == AUTO)
        if asked == AUTO:
            assert np.all(np.abs(values - LENGTH_S) < FAR * stds)
    (one_size, one_std), (other, other_std) = sizes
    if asked == AUTO:  # what bends the motion: each fit was told what the other board knows
        assert np.all(np.abs(one_size - other) < 0.2 * np.minimum(one_std, other_std))
        assert one_std == pytest.approx(other_std, rel=0.1)
    else:  # one unknown in one matrix
        assert together == [2.0, 2.0]
        assert one_size == pytest.approx(other, rel=1e-12)
        assert one_std == pytest.approx(other_std, rel=1e-6)
