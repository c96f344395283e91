"""Housekeeping: recovery and retention; a recording that a calibration references is kept."""

import os
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from gyrorig_daemon.config.service_settings import ServiceSettings
from gyrorig_daemon.service.housekeeping import Housekeeping
from gyrorig_daemon.service.state_folder import StateFolder


@pytest.fixture
def keeper_of(
    tmp_path: Path,
) -> Callable[[ServiceSettings], tuple[Housekeeping, StateFolder, list[str]]]:
    def make(settings: ServiceSettings) -> tuple[Housekeeping, StateFolder, list[str]]:
        state, log_lines = StateFolder(tmp_path), list[str]()
        state.recordings.mkdir()
        return (
            Housekeeping(state, lambda: settings, time.time, log_lines.append),
            state,
            log_lines,
        )

    return make


def recordings(folder: Path, count: int) -> list[Path]:
    """Files of a kilobyte, a day apart."""
    paths = [folder / f"r{number}.mcap" for number in range(count)]
    for number, path in enumerate(paths):
        path.write_bytes(bytes([number]) * 1_000_000)
        os.utime(path, (1.79e9 + 86_400 * number, 1.79e9 + 86_400 * number))
    return paths


def wait_for(condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + 90.0
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.02)


Maker = Callable[[ServiceSettings], tuple[Housekeeping, StateFolder, list[str]]]


def test_temporary_files_of_killed_processes_are_removed(tmp_path: Path, keeper_of: Maker) -> None:
    _, state, log_lines = keeper_of(ServiceSettings())
    folders = [state.root, state.queue, state.queue / "done", state.recordings / "unclean"]
    written = ["rig.json", "survey.yaml", "survey.result.json", "a.mcap.part.json"]
    for folder, name in zip(folders, written, strict=True):
        folder.mkdir(exist_ok=True)
        for path in (folder / f".{name}.a1b2c3d4", folder / name):
            path.touch()
            os.utime(path, (1e9, 1e9))
    metrics = tmp_path / "metrics" / "gyrorig.prom"
    metrics.parent.mkdir()
    (metrics.parent / ".gyrorig.prom.a1b2c3d4").touch()
    os.utime(metrics.parent / ".gyrorig.prom.a1b2c3d4", (1e9, 1e9))
    keeper = Housekeeping(state, ServiceSettings, time.time, log_lines.append, metrics)
    keeper.start()
    wait_for(lambda: not list(tmp_path.rglob(".*.a1b2c3d4")))
    keeper.close()
    assert all((folder / name).exists() for folder, name in zip(folders, written, strict=True))


def test_nothing_is_deleted_without_a_rule(keeper_of: Maker) -> None:
    keeper, state, log_lines = keeper_of(ServiceSettings())
    paths = recordings(state.recordings, 5)
    keeper.free_space()
    assert all(path.exists() for path in paths)
    assert log_lines == []


def test_the_oldest_go_and_what_is_cited_stays(keeper_of: Maker) -> None:
    keeper, state, log_lines = keeper_of(ServiceSettings(keep_mb=3))
    paths = recordings(state.recordings, 6)
    store = state.root / "calibrations" / "B-1"
    store.mkdir(parents=True)
    (store / "v0001.yaml").write_text("inputs:\n  - recording: r1.mcap\n")
    keeper.free_space()
    names = [path.name for path in paths if path.exists()]
    assert names == ["r1.mcap", "r4.mcap", "r5.mcap"]
    assert (keeper.counts.deleted, keeper.counts.deleted_bytes) == (3, 3_000_000)
    assert keeper.counts.kept_for_calibrations == 1
    assert log_lines == [
        "Deleted 3 recordings (3.0 MB) by the retention rules of the rig's configuration."
    ]


def test_an_empty_store_in_the_state_folder_does_not_stop_the_deleting(keeper_of: Maker) -> None:
    keeper, state, log_lines = keeper_of(ServiceSettings(keep_mb=1))
    (state.root / "calibrations").mkdir()
    keeper.free_space()
    assert log_lines == []
    assert keeper.counts.retention_failures == 0


def test_a_store_that_is_not_mounted_stops_all_deleting(keeper_of: Maker) -> None:
    keeper, state, log_lines = keeper_of(ServiceSettings(keep_mb=1, stores=("/none/there",)))
    paths = recordings(state.recordings, 3)
    keeper.free_space()
    assert all(path.exists() for path in paths)
    assert keeper.counts.retention_failures == 1
    assert "No recording was deleted" in log_lines[0]


def test_calibrations_that_have_disappeared_stop_all_deleting(keeper_of: Maker) -> None:
    keeper, state, log_lines = keeper_of(ServiceSettings(keep_mb=2))
    paths = recordings(state.recordings, 2)
    store = state.root / "calibrations"
    store.mkdir()
    (store / "v0001.yaml").write_text("inputs:\n  - recording: r0.mcap\n")
    keeper.free_space()
    store.rename(state.root / "elsewhere")
    paths += recordings(state.recordings, 5)
    keeper.free_space()
    assert all(path.exists() for path in paths)
    assert keeper.counts.retention_failures == 1
    assert "does not exist" in log_lines[0]


def test_room_is_made_only_where_that_was_allowed(
    keeper_of: Maker, monkeypatch: pytest.MonkeyPatch
) -> None:
    keeper, state, _ = keeper_of(ServiceSettings())
    assert keeper.storage_problem() == ""
    monkeypatch.setattr(state, "free_bytes", lambda: 1000)
    assert "GB are needed" in keeper.storage_problem()
    keeper.start()
    keeper.close()
    full = ServiceSettings(delete_when_full=True)
    other = Housekeeping(state, lambda: full, time.time, lambda _: None)
    assert "GB are needed" in other.storage_problem()
    assert other._wake.is_set()


def test_what_a_crash_left_is_finished_by_a_child(keeper_of: Maker) -> None:
    keeper, state, log_lines = keeper_of(ServiceSettings(reserve_mb=0))
    (state.recordings / "torn.mcap.part").write_bytes(b"\x89MCAP0\r\n" + b"\0" * 50)
    keeper.start()
    wait_for(lambda: bool(log_lines))
    keeper.close()
    assert keeper.counts.recovered == 0
    assert keeper.counts.recovered_lost_bytes == 58
    assert not (state.recordings / "torn.mcap.part").exists()
    assert "torn.mcap.part" in log_lines[0]


def test_a_recovery_that_cannot_be_read_is_counted(
    keeper_of: Maker, monkeypatch: pytest.MonkeyPatch
) -> None:
    keeper, state, log_lines = keeper_of(ServiceSettings())
    (state.recordings / "torn.mcap.part").write_bytes(b"")
    monkeypatch.setattr("sys.executable", "/bin/false")
    keeper._recover()
    assert keeper.counts.not_recovered == 1
    assert "recordings failed" in log_lines[0]
