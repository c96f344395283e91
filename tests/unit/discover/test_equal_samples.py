"""A sensor that always sends the same counts is refused."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data.count_columns import CountColumn
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


def test_an_axis_that_does_not_measure_is_refused(
    hidden: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    session = hidden()

    def load(*words: Any) -> GyroSamples:
        samples = load_samples(*words)
        counts = np.array(samples.counts)
        counts[:, 1] = counts[0, 1]
        return replace(
            samples, rate_rad_s=CountColumn(counts, samples.gyro.scale, samples.gyro.offset)
        )

    assert load_board([session.recording], session.board).sessions
    monkeypatch.setattr(board_data, "load_samples", load)
    data = load_board([session.recording], session.board)
    with pytest.raises(InputError, match=r"axis y of board GY80-1 keeps the same value for all"):
        _ = data.sessions
