"""A sensor that always sends the same counts is refused."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data.samples import GyroSamples, load_samples
from gyrorig_solver.pipeline import board_data, load_board


def test_a_sensor_that_does_not_measure_is_refused(
    hidden: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    session = hidden()

    def load(*words: Any) -> GyroSamples:
        samples = load_samples(*words)
        first = np.asarray(samples.rate_rad_s[:1])
        return replace(samples, rate_rad_s=np.repeat(first, len(samples.rate_rad_s), axis=0))

    assert load_board([session.recording], session.board).samples
    monkeypatch.setattr(board_data, "load_samples", load)
    with pytest.raises(InputError, match=r"all \d+ samples of board GY80-1 .* are equal"):
        load_board([session.recording], session.board)
