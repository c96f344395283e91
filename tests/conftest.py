"""Where tests find what is not committed: measured data and the contracts."""

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

ROOT = Path(__file__).resolve().parents[1]

# Before numpy is loaded, as the commands do: threads of two workers wait for one another.
for library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

# An example's time says how busy a machine is, and nothing of what is tested.
settings.register_profile(
    "gyrorig",
    parent=settings(),
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("gyrorig")


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
