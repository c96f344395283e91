"""What several whole-system tests begin from: a browser, a scheduler, a served rig."""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import pytest
from tests.bench.fleet.browser import chromium
from tests.support.served_rig import Devices, Service

Clusters = Callable[..., AbstractContextManager[tuple[subprocess.Popen[str], str]]]


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """Chromium without a window."""
    driver = chromium(tmp_path_factory.mktemp("profile"))
    if driver is None:
        pytest.skip("no Chromium to drive: apt-get install chromium chromium-driver, selenium")
    yield driver
    driver.quit()


@pytest.fixture
def clusters(tmp_path: Path) -> Clusters:
    """Return what runs a script that says a scheduler's address, and kills it with its workers."""

    @contextmanager
    def running(
        script: str, words: Sequence[str] = (), more: Mapping[str, str] | None = None
    ) -> Iterator[tuple[subprocess.Popen[str], str]]:
        path = tmp_path / "cluster.py"
        path.write_text(script, encoding="utf-8")
        process = subprocess.Popen(
            [sys.executable, str(path), *words],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            start_new_session=True,
            cwd=tmp_path,
            env={**os.environ, **(more or {})},
        )
        assert process.stdout is not None
        try:
            yield process, process.stdout.readline().strip()
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.communicate()

    return running


@pytest.fixture
def devices() -> Iterator[Devices]:
    """Return an emulated unit and boards on pseudo-terminals, served by the test."""
    made = Devices()
    yield made
    made.close()


@pytest.fixture
def service(devices: Devices) -> Iterator[Service]:
    """Return a service on these devices; it is not started."""
    folder = Path(tempfile.mkdtemp(prefix="gyrorig"))  # a socket's path must be short
    made = Service(folder, devices)
    yield made
    made.close()
    shutil.rmtree(folder)
