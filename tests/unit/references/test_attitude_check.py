"""`gyrorig check` says what reference attitudes are worth, and the commands honour the map."""

from pathlib import Path

import numpy as np
import pytest
from tests.support.simulated_attitudes import StampSettings, simulate_attitudes

from gyrorig_solver import cli

MAP = """
schema: gyrorig/import/1
board: B1
sensor: X
time: {{key: t, unit: s}}
gyro: {{keys: [g], unit: rad/s}}
attitude: {{keys: [q], order: wxyz, time: {{key: tq, unit: s{stamp}}}{maps}}}
"""


def imported(folder: Path, settings: StampSettings, stamp: str = "", maps: str = "") -> Path:
    session = simulate_attitudes(4, settings, span_s=30.0)
    np.savez(
        folder / "in.npz",
        t=session.gyro_time_s,
        g=session.gyro_rad_s,
        tq=session.stamp_s,
        q=session.orientation_xyzw[:, [3, 0, 1, 2]],
    )
    (folder / "map.yaml").write_text(MAP.format(stamp=stamp, maps=maps), encoding="utf-8")
    out = folder / "out.mcap"
    options = ["--map", str(folder / "map.yaml"), "--out", str(out)]
    assert cli.run(["import", "npz", str(folder / "in.npz"), *options]) == 0
    return out


def test_check_gives_jitter_losses_and_the_convention(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = StampSettings(1e-3, "arrival", drop_share=0.02, repeat_share=0.01, lost_s=2.0)
    cli.run(["check", str(imported(tmp_path, settings))])
    text = capsys.readouterr().out
    assert "100.00 frames per second" in text
    assert "gaps 1" in text
    assert "jitter 0.6" in text
    assert "late by a delay that changes" in text
    assert "as recorded" in text
    assert "conjugated" in text
    assert "does not prove" not in text


def test_a_map_with_arrival_stamps_is_honoured(tmp_path: Path) -> None:
    recording = imported(tmp_path, StampSettings(2e-3, "arrival"), stamp=", stamp: arrival")
    assert cli.run(["solve", str(recording), "--out", str(tmp_path), "--extend", "none"]) == 0


def test_a_conjugate_recording_is_refused_with_the_true_reason(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = imported(tmp_path, StampSettings(), maps=", maps: world_to_body")
    for command in (["solve", "--out", str(tmp_path)], ["explain", "--out", str(tmp_path / "e")]):
        assert cli.run([command[0], str(recording), *command[1:]]) == 3
        assert "the quaternions map world to body" in capsys.readouterr().err
    cli.run(["check", str(recording)])
    assert "change `maps` under `attitude`" in capsys.readouterr().out.lower()
