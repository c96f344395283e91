"""The Debian package in a container: installed, updated and removed in motion, and purged.

Building it needs a package index, or the package in $GYRORIG_DEB: `make test-packages`.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from tests.systemd.test_units_l2 import programs, results_of_container, why_not

ROOT = Path(__file__).resolve().parents[2]
SUITE = "bookworm"

pytestmark = [pytest.mark.packages, pytest.mark.timeout(1800)]


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package, for this computer's /usr/bin/python3."""
    if shutil.which("dpkg-deb") is None:
        pytest.skip("no dpkg-deb here: this is no Debian")
    if named := os.environ.get("GYRORIG_DEB"):
        return Path(named)
    folder = tmp_path_factory.mktemp("deb")
    subprocess.run([sys.executable, ROOT / "release" / "deb.py", "--out", folder], check=True)
    (path,) = folder.glob("*.deb")
    return path


@pytest.fixture(scope="module")
def observed(package: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    if why := why_not():
        pytest.skip(why)
    folder = tmp_path_factory.mktemp("container")
    programs(folder / "made", "driver")
    (folder / "out").mkdir()
    shutil.copy(package, folder / "out" / "gyrorig.deb")
    return results_of_container(
        folder,
        folder / "made",
        "/opt/driver/bin/python",
        "/repo/tests/packages/deb_driver.py",
        limit_s=900,
    )


def test_nothing_went_wrong_inside(observed: dict[str, Any]) -> None:
    assert "fault" not in observed, observed["fault"]


def test_it_refuses_a_computer_with_the_other_installation(observed: dict[str, Any]) -> None:
    refused = observed["refused"]
    assert refused["status"] != 0
    assert "make install-service ARGS=--remove" in refused["said"]
    assert refused["after"]["status"] == 0


def test_installed(observed: dict[str, Any]) -> None:
    installed = observed["installed"]
    assert installed["status"] == 0, installed["said"]
    assert installed["verified"] == {"status": 0, "said": ""}
    assert installed["enabled"] == ["enabled", "enabled"]
    assert installed["active"] == ["inactive", "active"]  # first the owner edits the configuration
    assert installed["version"].startswith("gyrorig ")
    assert "dialout" in installed["user"].split()
    assert installed["state"] == "drwxrws--T gyrorig"
    assert installed["example"]
    assert "edit /etc/gyrorig/rig.yaml" in installed["said"]
    assert installed["page"].endswith("gyrorig.1")


def test_started(observed: dict[str, Any]) -> None:
    assert observed["started"]["said"] == ""
    assert "rig l1" in observed["started"]["status"]


def test_an_update_in_motion_halts_and_starts_again(observed: dict[str, Any]) -> None:
    updated = observed["updated"]
    assert updated["status"] == 0, updated["said"]
    assert updated["halted"]
    assert updated["back_s"] < 30.0
    assert updated["enabled"] == ["enabled", "disabled"]  # as the owner has decided
    assert updated["nightly"] == "inactive"
    assert (updated["config"], updated["program"]) == (True, True)


def test_a_removal_in_motion_halts_and_keeps_data(observed: dict[str, Any]) -> None:
    removed = observed["removed"]
    assert removed["status"] == 0, removed["said"]
    assert removed["halted"]
    assert (removed["opt"], removed["loaded"], removed["config"]) == (False, "not-found", True)
    assert removed["recordings"] >= 2


def test_it_returns_with_the_units_that_were_enabled(observed: dict[str, Any]) -> None:
    returned = observed["returned"]
    assert returned["status"] == 0, returned["said"]
    assert returned["enabled"] == ["enabled", "disabled"]
    assert returned["nightly"] == "inactive"
    assert returned["removed"]["status"] == 0, returned["removed"]["said"]


def test_a_purge_leaves_recordings_only(observed: dict[str, Any]) -> None:
    purged = observed["purged"]
    assert purged["status"] == 0, purged["said"]
    assert not purged["config"]
    assert purged["recordings"] == observed["removed"]["recordings"]
    assert purged["again"] == [0, 0]
    assert (purged["more"], purged["fewer"]) == ([], [])


def test_its_dependencies_are_enough(package: Path, tmp_path: Path) -> None:
    """In a Debian without anything else: recorded, solved, in a store, on a page."""
    if os.geteuid() != 0 or shutil.which("debootstrap") is None:
        pytest.skip("debootstrap needs root, and the package debootstrap")
    root = tmp_path / "debian"
    made = subprocess.run(
        ["debootstrap", "--variant=minbase", SUITE, root],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if made.returncode != 0:
        pytest.skip(f"no Debian mirror here: {made.stdout.strip()[-200:]}")
    shutil.copy(package, root / "gyrorig.deb")
    shutil.copy("/etc/resolv.conf", root / "etc" / "resolv.conf")
    script = """
set -e
apt-get install -q -y --no-install-recommends /gyrorig.deb
test -n "$(id -u gyrorig)"
config=/opt/gyrorig/share/gyrorig/config
gyrorigd record --simulated-time --config $config/rig.yaml \
  --program $config/programs/survey-40.yaml --out /tmp/recordings
gyrorig batch --spool /tmp/recordings --store /tmp/store --workers 1
gyrorig fleet /tmp/store
find /opt/gyrorig -name '*.so*' -type f -exec ldd {} + | grep 'not found' && exit 9
dpkg --purge gyrorig
test ! -e /opt/gyrorig -a ! -e /etc/gyrorig -a ! -e /var/lib/gyrorig
"""
    mounted = f"mount -t proc proc {root}/proc && exec chroot {root} bash -c '{script}'"
    process = subprocess.run(
        ["unshare", "--mount", "--propagation", "private", "bash", "-c", mounted],
        capture_output=True, text=True, check=False,
        env={**os.environ, "DEBIAN_FRONTEND": "noninteractive", "PATH": os.defpath + ":/usr/sbin"},
    )  # fmt: skip
    assert process.returncode == 0, process.stdout[-3000:] + process.stderr[-3000:]
