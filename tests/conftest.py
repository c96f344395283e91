"""Where tests find what is not committed: measured data and the contracts."""

import os
import signal
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

ROOT = Path(__file__).resolve().parents[1]

# Before numpy is loaded, as the commands do: threads of two workers wait for one another.
for library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

# Some containers set this variable. Then every worker, and each of the several hundred processes
# that the tests start, compiles the same modules again.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# A shell that starts the tests in the background lets them and their processes ignore Ctrl-C.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# An example's time says how busy a machine is, and nothing of what is tested.
settings.register_profile(
    "gyrorig",
    parent=settings(),
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("gyrorig")


WAITING = ("system", "systemd")  # folders of tests that mostly wait for processes


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Spread the files that mostly wait between those that compute, so that no core is idle."""
    files: dict[Path, list[pytest.Item]] = {}
    for item in items:
        files.setdefault(item.path, []).append(item)
    waiting = [path for path in files if path.parent.name in WAITING]
    computing = [path for path in files if path.parent.name not in WAITING]
    place = {path: k / len(group) for group in (waiting, computing) for k, path in enumerate(group)}
    items[:] = [item for path in sorted(files, key=place.__getitem__) for item in files[path]]


@pytest.fixture(scope="session")
def measured_data() -> Path:
    """The folder of real measurements, from $GYRORIG_DATA or beside the checkout."""
    named = os.environ.get("GYRORIG_DATA")
    folder = Path(named) if named else ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"no measured data at {folder}: set GYRORIG_DATA to its folder")
    return folder


@pytest.fixture(scope="session")
def contracts() -> Path:
    """The folder of the published contracts, with the sample recording."""
    folder = ROOT.parent / "shared" / "contracts"
    if not folder.is_dir():
        pytest.skip(f"no contracts at {folder}: this test compares with the published ones")
    return folder


@pytest.fixture(scope="session")
def contract_judge() -> Path:
    """The independent judge of recordings and result documents."""
    judge = ROOT.parent / "shared" / "tools" / "check_contract.py"
    if not judge.is_file():
        pytest.skip(f"no contract judge at {judge}")
    return judge
