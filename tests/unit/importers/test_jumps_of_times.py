"""Steps of the times of a log whose clock was set: no lost samples, and a remark on the import."""

import re
from pathlib import Path

import numpy as np
import pytest
from tests.unit.importers.test_import_measurements import BASE, archive, mapped

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.data.samples import load_samples
from gyrorig_solver.importers import ImportSummary, import_measurements

ARRIVAL = "unit: s, stamp: arrival, rate_hz: 200.0}"


def imported(folder: Path, time_s: np.ndarray, text: str = BASE) -> ImportSummary:
    rng = np.random.default_rng(4)
    source = archive(folder / "in.npz", t=time_s, g=rng.normal(size=(time_s.size, 3)))
    return import_measurements(source, mapped(text), folder / "out.mcap")


@pytest.mark.parametrize("jump_s", [200.0, 600.0, 86_400.0])
def test_a_jump_of_the_clock_loses_no_samples(jump_s: float, tmp_path: Path) -> None:
    """Row numbers count the samples of a file, so they never return to 0 as a board's can."""
    row = np.arange(4000)
    summary = imported(tmp_path, 1.0 + row / 200.0 + np.where(row < 3000, 0.0, jump_s))
    samples = load_samples(read_recording(summary.path), "B1")
    assert (samples.lost, samples.number.size) == (0, 4000)
    (note,) = summary.notes
    assert f"B1: the times jump by {jump_s + 0.005:.6g} s at row 3001; if the log has no" in note


def test_the_largest_of_several_jumps_is_named(tmp_path: Path) -> None:
    row = np.arange(4000)
    time_s = 1.0 + row / 200.0 + 2.0 * (row >= 1000) + 50.0 * (row >= 2000)
    (note,) = imported(tmp_path, time_s).notes
    assert "the times jump by 50.005 s at row 2001, and at 1 other rows by less" in note


def test_bursts_and_short_gaps_are_no_jumps(tmp_path: Path) -> None:
    row = np.arange(4000)
    bursts_s = 1.0 + np.ceil((row + 1) / 8) * 8 / 200.0
    text = BASE.replace("unit: s}", ARRIVAL)
    assert imported(tmp_path, bursts_s, text).notes == ()
    (tmp_path / "gap").mkdir()
    assert imported(tmp_path / "gap", 1.0 + row / 200.0 + 0.4 * (row > 99)).notes == ()


@pytest.mark.parametrize("back_s", [2.0, 8.0])
def test_rows_of_a_clock_that_was_set_back_get_a_remark(back_s: float, tmp_path: Path) -> None:
    """A bag is read in the order of its times, which mixes the rows of both times."""
    rng = np.random.default_rng(2)
    row = np.arange(6000)
    time_s = 1.0 + row / 200.0 + 1e-3 * rng.random(6000)
    time_s = np.sort(time_s - np.where(row < 3000, 0.0, back_s))
    (note,) = imported(tmp_path, time_s, BASE.replace("unit: s}", ARRIVAL)).notes
    first_s, last_s = (float(text) for text in re.findall(r"([0-9.]+) s ", note)[:2])
    assert first_s == pytest.approx(16.0 - back_s, abs=0.2)
    assert last_s == pytest.approx(16.0, abs=0.2)
    assert "twice as dense as elsewhere; if the sample rate was not changed there" in note
