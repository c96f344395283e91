"""`make install-service` into an empty root: what it writes, keeps, reports and removes."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

INSTALL = Path(__file__).resolve().parents[2] / "systemd" / "install.py"

pytestmark = [
    pytest.mark.skipif(os.geteuid() != 0, reason="installing needs root"),
    pytest.mark.skipif(
        shutil.which("systemd-sysusers") is None or shutil.which("systemctl") is None,
        reason="no systemd here: it comes with the package systemd",
    ),
]


def install(root: Path, *more: str, code: int = 0) -> str:
    ended = subprocess.run(
        [sys.executable, INSTALL, "--root", root, *(more or ["--only-files"])],
        capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip
    assert ended.returncode == code, ended.stdout + ended.stderr
    return ended.stdout + ended.stderr


@pytest.fixture
def root(tmp_path: Path) -> Path:
    (tmp_path / "etc").mkdir()
    return tmp_path


def test_into_an_empty_root(root: Path) -> None:
    output = install(root)
    for name in (
        "etc/systemd/system/gyrorigd.service",
        "etc/systemd/system/gyrorig-nightly.timer",
        "etc/udev/rules.d/70-gyrorig.rules",
        "etc/gyrorig/programs/survey-130.yaml",
        "etc/gyrorig/rig.yaml",
    ):
        assert (root / name).is_file(), output
        assert f"/{name}" in output
    wanted = root / "etc/systemd/system/multi-user.target.wants/gyrorigd.service"
    assert wanted.is_symlink()
    assert (root / "etc/systemd/system/timers.target.wants/gyrorig-nightly.timer").is_symlink()
    assert (root / "usr/local/bin/gyrorigd").readlink() == Path("/opt/gyrorig/bin/gyrorigd")
    assert (root / "var/lib/gyrorig/recordings").is_dir()
    assert "gyrorig" in (root / "etc/passwd").read_text()
    assert not (root / "etc/systemd/network").exists()
    assert "gyrorigd doctor" in output


def test_a_second_time_nothing_is_done(root: Path) -> None:
    install(root)
    before = {path: path.stat().st_mtime_ns for path in root.rglob("*") if path.is_file()}
    output = install(root)
    assert "No changes were needed" in output
    assert "changed  " not in output
    changed = [path.name for path, at_ns in before.items() if path.stat().st_mtime_ns != at_ns]
    assert set(changed) <= {"installed.json"}


def test_what_a_person_has_changed_stays(root: Path) -> None:
    install(root)
    rules = root / "etc/udev/rules.d/70-gyrorig.rules"
    mine = rules.read_text().replace("#ENV{ID_SERIAL_SHORT}", "ENV{ID_SERIAL_SHORT}")
    rules.write_text(mine)
    config = root / "etc/gyrorig/rig.yaml"
    config.write_text("rig: mine\n")
    output = install(root)
    assert rules.read_text() == mine
    assert config.read_text() == "rig: mine\n"
    assert "70-gyrorig.rules.new" in output
    assert "Edit" not in output
    assert "No changes were needed" in install(root)


def test_a_file_of_an_older_version_is_replaced(root: Path) -> None:
    install(root)
    unit = root / "etc/systemd/system/gyrorigd.service"
    ours = unit.read_bytes()
    notes = root / "opt/gyrorig/installed.json"
    unit.write_bytes(b"[Unit]\nDescription=older\n")
    import hashlib  # noqa: PLC0415

    notes.write_text(
        notes.read_text().replace(
            hashlib.sha256(ours).hexdigest(), hashlib.sha256(unit.read_bytes()).hexdigest()
        )
    )
    assert "wrote /etc/systemd/system/gyrorigd.service" in install(root)
    assert unit.read_bytes() == ours


def test_a_can_bus_only_when_asked_for(root: Path) -> None:
    networkd = root / "lib/systemd/system/systemd-networkd.service"
    networkd.parent.mkdir(parents=True)
    networkd.write_text("[Service]\nExecStart=/bin/true\n[Install]\nWantedBy=multi-user.target\n")
    install(root, "--only-files", "--can")
    assert (root / "etc/sysctl.d/80-gyrorig.conf").is_file()
    assert (root / "etc/systemd/network/80-gyrorig-can0.network").is_file()


def test_taken_away_again(root: Path) -> None:
    install(root)
    (root / "var/lib/gyrorig/recordings/a.mcap").write_bytes(b"a")
    output = install(root, "--remove")
    assert not (root / "etc/systemd/system/gyrorigd.service").exists()
    assert not (root / "opt/gyrorig").exists()
    assert not (root / "usr/local/bin/gyrorigd").is_symlink()
    assert (root / "var/lib/gyrorig/recordings/a.mcap").exists()
    assert (root / "etc/gyrorig/rig.yaml").exists()
    assert "are kept" in output
    install(root)  # and again


def test_an_interpreter_in_a_home_is_refused(root: Path, tmp_path: Path) -> None:
    home = Path("/root") / f".gyrorig-test-{os.getpid()}"
    home.mkdir()
    try:
        python = home / "python3"
        python.write_text(f'#!/bin/sh\nexec {sys.executable} "$@"\n')
        python.chmod(0o755)
        output = install(root, "--python", str(python), code=1)
        assert "in a home directory" in output
    finally:
        shutil.rmtree(home)
    assert "python3-venv" in install(root, "--python", "/usr/bin/no-python", code=1)


@pytest.mark.bench
@pytest.mark.timeout(600)
def test_the_programs_run_from_their_place(root: Path) -> None:
    """The whole of it, packages from the network: the daemon answers from the new place."""
    install_s = subprocess.run(
        [sys.executable, INSTALL, "--root", root], capture_output=True, text=True, check=False
    )
    assert install_s.returncode == 0, install_s.stderr
    script = (root / "opt/gyrorig/bin/gyrorigd").read_text()
    assert script.startswith("#!/opt/gyrorig/bin/python")
    ended = subprocess.run(
        [root / "opt/gyrorig/bin/python", "-m", "gyrorig_daemon", "run", "--check", "--config",
         root / "etc/gyrorig/rig.yaml"],
        capture_output=True, text=True, check=False, cwd="/",
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    assert not list((root / "opt").glob("gyrorig.*"))
