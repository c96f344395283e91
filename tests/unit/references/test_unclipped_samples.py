"""Samples at full scale, and recordings that are given twice, with every reference motion."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.support.reference_recordings import (
    BOARD,
    SimulatedGyro,
    record_attitudes,
    record_gravity,
    record_turns,
)

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.estimate import GyroFit
from gyrorig_solver.pipeline import fit_criticised, load_board

Record = Callable[..., Path]


class ClippedGyro(SimulatedGyro):
    """A gyroscope whose rates are at most the full scale."""

    full_scale_rad_s = 2.0

    def measure(self, *arguments):  # type: ignore[no-untyped-def]
        return np.clip(super().measure(*arguments), -self.full_scale_rad_s, self.full_scale_rad_s)


def solve(*paths: Path) -> GyroFit:
    """Return the fit of the board of some recordings."""
    return fit_criticised(load_board([read_recording(path) for path in paths], BOARD), ()).fit


def test_a_turn_at_full_scale_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="full scale"):
        solve(record_turns(tmp_path / "turns.mcap", ClippedGyro()))


@pytest.mark.parametrize(
    ("record", "full_scale_rad_s"), [(record_attitudes, 2.0), (record_gravity, 1.2)]
)
def test_samples_at_full_scale_are_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, record: Record, full_scale_rad_s: float
) -> None:
    monkeypatch.setattr(ClippedGyro, "full_scale_rad_s", full_scale_rad_s)
    gyro = ClippedGyro()
    fit = solve(record(tmp_path / "clipped.mcap", gyro))
    error = np.abs(np.diag(fit.gain) - np.diag(gyro.gain))
    assert error.max() < 1e-3  # nan, and 8e-3, with the clipped samples


@pytest.mark.parametrize("record", [record_attitudes, record_turns])
def test_a_recording_given_twice_is_refused(tmp_path: Path, record: Record) -> None:
    path = record(tmp_path / "recording.mcap", SimulatedGyro())
    with pytest.raises(UsageError, match="twice"):
        solve(path, path)
