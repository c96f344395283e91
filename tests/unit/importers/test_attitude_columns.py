"""Columns of reference attitudes: their convention, and stamps that jitter or arrive late."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gyrorig_protocol.documents import convert_document, parse_yaml
from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording, times_ns
from gyrorig_solver.importers import ImportMap, check_import_map, import_measurements

MAP = """
schema: gyrorig/import/1
board: "B1"
sensor: "X"
time: {{key: t, unit: s}}
gyro: {{keys: [g], unit: rad/s}}
attitude: {{keys: [q], order: xyzw, time: {{{time}}}{more}}}
"""
COUNT = 200


def imported(
    folder: Path, stamp_s: np.ndarray, time: str = "key: tq", more: str = ""
) -> tuple[Recording, Rotation]:
    turns = Rotation.from_rotvec(np.outer(np.linspace(0.0, 2.0, COUNT), [0.3, -0.5, 1.0]))
    source = folder / "in.npz"
    np.savez(
        source,
        t=1.0 + np.arange(COUNT) * 0.01,
        g=np.zeros((COUNT, 3)),
        q=turns.as_quat(),
        tq=stamp_s,
    )
    text = MAP.format(time=time, more=more)
    mapping = check_import_map(convert_document(parse_yaml(text, "m"), ImportMap, "m"), "m")
    summary = import_measurements(source, mapping, folder / "out.mcap")
    return read_recording(summary.path), turns


def test_world_to_body_is_stored_as_its_conjugate(tmp_path: Path) -> None:
    stamp_s = 1.0 + np.arange(COUNT) * 0.01
    recording, turns = imported(tmp_path, stamp_s, more=", maps: world_to_body")
    stored = Rotation.from_quat(recording.reference_attitude()["orientation"])
    assert (stored * turns).magnitude().max() < 1e-12
    assert "gyrorig.reference" not in recording.metadata


def test_arrival_stamps_are_said_in_the_recording(tmp_path: Path) -> None:
    stamp_s = 1.0 + np.arange(COUNT) // 4 * 0.04  # four at a time
    recording, _ = imported(tmp_path, stamp_s, "key: tq, stamp: arrival")
    assert recording.metadata["gyrorig.reference"] == {"stamp": "arrival"}
    assert recording.reference_attitude().size == COUNT


def test_jittered_stamps_keep_the_order_of_the_rows(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    stamp_s = 1.0 + np.arange(COUNT) * 0.01 + 0.01 * rng.normal(size=COUNT)
    recording, turns = imported(tmp_path, stamp_s)
    raw = recording.reference_attitude()
    assert np.any(np.diff(stamp_s) < 0.0)
    nanoseconds = times_ns(raw["host_time"])
    assert np.all(np.diff(nanoseconds) >= 0)
    # The mean of what is not in order moves no time by more than the disorder, and keeps sums.
    disorder_s = (np.maximum.accumulate(stamp_s) - np.minimum.accumulate(stamp_s[::-1])[::-1]).max()
    assert np.abs(1e-9 * nanoseconds - stamp_s).max() <= disorder_s
    assert abs(np.mean(1e-9 * nanoseconds) - np.mean(stamp_s)) < 1e-9
    assert (Rotation.from_quat(raw["orientation"]).inv() * turns).magnitude().max() < 1e-12


def test_times_that_go_back_by_more_than_jitter_are_refused(tmp_path: Path) -> None:
    stamp_s = 1.0 + np.arange(COUNT) * 0.01
    stamp_s[100:] -= 0.5
    with pytest.raises(InputError, match="do not increase at row 101"):
        imported(tmp_path, stamp_s)
