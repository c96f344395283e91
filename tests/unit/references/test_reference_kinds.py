"""The kinds of references: which one is used, and a new one that is a single file."""

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from gyrorig_protocol.documents import convert_document, parse_yaml
from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.importers import ImportMap, check_import_map, import_measurements
from gyrorig_solver.pipeline.board_data import BoardData, load_board, reference_kinds
from gyrorig_solver.pipeline.criticised_fit import fit_criticised
from gyrorig_solver.pipeline.explain_board import explain_data

HZ, SCALE_Z = 100.0, 1.012
MAP = """
schema: gyrorig/import/1
board: "B1"
sensor: "X"
time: {key: t, unit: s}
gyro: {keys: [g], unit: rad/s}
"""
REST = "static: [{begin_s: 0.0, end_s: 55.9}]\n"
TURN = """
turns:
  - {axis: [0.0, 0.0, 1.0], angle_deg: 360.0, std_deg: 0.5, over: {begin_s: 56.0, end_s: 60.0}}
"""
# What a newcomer writes.
NEW_KIND = '''
"""A table that turns about z at a constant rate from 56 s to 60 s."""

import numpy as np

from gyrorig_solver.estimate import UNIT_REMEDIES
from gyrorig_solver.pipeline.motion_kind import MotionKind
from gyrorig_solver.reference import RestReference, TimeInterval
from gyrorig_solver.reference.reference_motion import EvaluatedMotion


class TableMotion(RestReference):
    description = "a rate table"

    def evaluate(self, edges_s, derivatives=True):
        rate = np.zeros((edges_s.size - 1, 3))
        turned_s = np.diff(np.clip(edges_s, 56.0, 60.0))
        rate[:, 2] = 2.0 * np.pi / 4.0 * turned_s / np.diff(edges_s)
        return EvaluatedMotion(rate, (), np.zeros((0, edges_s.size - 1, 3)))


class TableKind(MotionKind):
    title = "a rate table"
    preference = 25
    remedies = UNIT_REMEDIES

    def is_given(self, data):
        return all(r.path.name == "table.mcap" for r in data.recordings)

    def read_motion(self, recording, samples):
        return TableMotion((TimeInterval(0.0, 60.0),))


KIND = TableKind()
'''


def recorded(tmp_path: Path, name: str, more: str, seed: int = 1) -> Recording:
    """Return an imported recording: 56 s at rest, then a turn about z within 4 s."""
    time_s = np.arange(6000) / HZ
    rate = 1e-3 * np.random.default_rng(seed).normal(size=(time_s.size, 3)) + 0.01
    rate[:, 2] += SCALE_Z * 2.0 * np.pi / 4.0 * (time_s >= 56.0) * ("turns" in more)
    source = tmp_path / f"{name}.npz"
    np.savez(source, t=time_s, g=rate)
    import_map = check_import_map(
        convert_document(parse_yaml(MAP + more, "map"), ImportMap, "map"), "map"
    )
    path = import_measurements(source, import_map, tmp_path / f"{name}.mcap").path
    return read_recording(path)


def data_of(*recordings: Recording) -> BoardData:
    return load_board(recordings, "B1")


def test_the_kinds_stand_in_the_order_of_preference() -> None:
    titles = [kind.title for kind in reference_kinds()]
    assert titles == [
        "a pan-tilt unit",
        "reference attitudes",
        "known turns",
        "phases at rest",
        "the board's accelerometer",
    ]


def test_a_turn_counts_also_in_a_recording_that_is_mostly_at_rest(tmp_path: Path) -> None:
    data = data_of(recorded(tmp_path, "turned", REST + TURN))
    fit = fit_criticised(data, ("auto",)).fit
    assert data.kind.title == "known turns"
    assert fit.gain[2, 2] == pytest.approx(SCALE_Z, abs=3.0 * fit.gain_std[2, 2])


def test_several_recordings_at_rest_are_explained_together(tmp_path: Path) -> None:
    still = "static: [{begin_s: 0.0, end_s: 60.0}]\n"
    data = data_of(*(recorded(tmp_path, f"rest{k}", still, seed=k) for k in range(2)))
    explanation = explain_data(data)
    assert data.kind.title == "phases at rest"
    assert explanation.findings.unexplained is None


def test_a_recording_without_a_reference_is_refused_with_what_can_be_recorded(
    tmp_path: Path,
) -> None:
    data = data_of(recorded(tmp_path, "bare", ""))
    with pytest.raises(InputError) as caught:
        fit_criticised(data, ())
    assert "bare.mcap has no reference" in str(caught.value)
    for kind in reference_kinds():
        assert (kind.title in caught.value.remedy) == kind.is_suggested


@pytest.mark.parametrize("more", [REST + TURN])
def test_requested_causes_are_refused_where_no_rate_is_known(tmp_path: Path, more: str) -> None:
    with pytest.raises(UsageError, match="--extend"):
        fit_criticised(data_of(recorded(tmp_path, "turned", more)), ("scale_cubic",))


@pytest.fixture
def new_kind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Add a kind: one file in a folder of the package."""
    folder = tmp_path / "gyrorig_extensions" / "references"
    folder.mkdir(parents=True)
    (folder / "rate_table.py").write_text(NEW_KIND, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    reference_kinds.cache_clear()
    yield
    reference_kinds.cache_clear()
    for module in [name for name in sys.modules if name.startswith("gyrorig_extensions")]:
        del sys.modules[module]


@pytest.mark.usefixtures("new_kind")
def test_a_new_kind_is_one_file(tmp_path: Path) -> None:
    data = data_of(recorded(tmp_path, "table", REST + TURN))
    assert data.kind.title == "a rate table"
    criticised = fit_criticised(data, ())
    fit = criticised.fit
    assert fit.gain[2, 2] == pytest.approx(SCALE_Z, abs=4.0 * fit.gain_std[2, 2])
    assert fit.gain_std[2, 2] < 1e-4
    assert criticised.criticism is not None
    assert criticised.criticism.is_adequate
    assert data.kind.determine_observability(data).rank >= 6
