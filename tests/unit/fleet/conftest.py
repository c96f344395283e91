"""Two recordings of an emulated board, rows as a worker makes them, and a bucket in memory."""

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import fsspec  # type: ignore[import-untyped] # it has no types
import pytest
from tests.support.emulated_recordings import record_once
from tests.support.made_once import shared_folder

from gyrorig_solver.fleet.store import IndexRow
from gyrorig_solver.storage import bucket as buckets


class OneByOne:
    """fsspec's memory, whose calls come one after another, as those of an object store do.

    By itself it lets two threads take one name, and read one file from each other's place.
    """

    def __init__(self) -> None:
        self.inner = fsspec.filesystem("memory")
        self._lock = threading.RLock()

    def __getattr__(self, name: str) -> Any:
        result = getattr(self.inner, name)
        if not callable(result):
            return result

        def alone(*arguments: Any, **more: Any) -> Any:
            with self._lock:
                return result(*arguments, **more)

        return alone


@pytest.fixture(autouse=True)
def memory(monkeypatch: pytest.MonkeyPatch) -> Iterator[OneByOne]:
    """What is below `memory://` in a test, and gone after it."""
    item = OneByOne()
    monkeypatch.setitem(buckets._file_systems, "memory", item)
    yield item
    item.inner.store.clear()


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two sessions of 40 s, of two emulated boards that have one name and one uid each."""
    shared = shared_folder(tmp_path_factory)
    sessions: tuple[tuple[str, ...], ...] = ((), ("--session", "second"))
    return [record_once(shared, "survey-40", "--seed", "3", *name).path for name in sessions]


def row(key: str, board: str = "B", **more: object) -> IndexRow:
    plain: dict[str, object] = {
        "key": key,
        "status": "ok",
        "created": "2026-01-31T02:30:00Z",
        "batch": "b",
        "inputs": ["00"],
        "names": ["r.mcap"],
        "board": board,
        "version": 1,
        "parameters": {"bias_x": 0.25, "bias_x_std": 0.5},
    }
    return IndexRow(**{**plain, **more})  # type: ignore[arg-type] # as the test says
