"""Checks of the files in systemd/ by systemd and udev, without running them."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FILES = ROOT / "systemd"
UNITS = FILES / "system"
SERVICES = sorted(UNITS.glob("*.service"))
THRESHOLD = 10  # exposure of at most 1.0, of 10


def tool(name: str, package: str = "systemd") -> str:
    path = shutil.which(name)
    if path is None:
        pytest.skip(f"no {name} here: it comes with the package {package}")
    return path


def run(*command: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(word) for word in command],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
        timeout=100,
    )


def installed(folder: Path) -> list[Path]:
    """Copies of the units whose programs are there: /opt/gyrorig is where pytest runs from."""
    prefix = Path(sys.executable).parents[1]
    for unit in UNITS.iterdir():
        (folder / unit.name).write_text(unit.read_text().replace("/opt/gyrorig", str(prefix)))
    return sorted(folder.iterdir())


def values(unit: str, key: str) -> list[str]:
    return re.findall(rf"^{key}=(.*)$", (UNITS / unit).read_text(), re.MULTILINE)


def test_verify_has_nothing_to_say(tmp_path: Path) -> None:
    # by its output: a misspelt directive leaves the exit code 0
    ended = run(tool("systemd-analyze"), "verify", "--man=no", *installed(tmp_path))
    assert (ended.returncode, ended.stdout) == (0, "")


def test_verify_would_say_it(tmp_path: Path) -> None:
    analyze = tool("systemd-analyze")
    for unit in installed(tmp_path):
        unit.write_text(unit.read_text().replace("WatchdogSec=", "WatchdogSecs="))
    assert "WatchdogSecs" in run(analyze, "verify", "--man=no", *tmp_path.iterdir()).stdout


@pytest.mark.parametrize("service", SERVICES, ids=lambda path: path.name)
def test_exposure(service: Path) -> None:
    ended = run(
        tool("systemd-analyze"), "security", "--offline=true", f"--threshold={THRESHOLD}",
        "--no-pager", service,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stdout[-200:]


def test_the_timer_goes_off_every_night() -> None:
    (when,) = values("gyrorig-nightly.timer", "OnCalendar")
    ended = run(tool("systemd-analyze"), "calendar", "--iterations=3", when)
    assert ended.returncode == 0, ended.stdout
    nights = re.findall(r"\d{4}-\d\d-(\d\d) 02:30:00 UTC", ended.stdout)
    assert len(set(nights)) == 3


def test_the_daemon_is_halted_for_after_every_end() -> None:
    (start,) = values("gyrorigd.service", "ExecStart")
    (after,) = values("gyrorigd.service", "ExecStopPost")
    assert start.replace(" run ", " halt ") == after  # the same configuration, whoever ends
    assert values("gyrorigd.service", "Type") == ["notify"]
    assert values("gyrorigd.service", "WatchdogSec") == ["10"]
    assert values("gyrorigd.service", "StartLimitIntervalSec") == ["0"]
    assert values("gyrorigd.service", "KillMode") == ["mixed"]


def test_the_night_solves_and_then_makes_the_page_of_the_same_store() -> None:
    batch, fleet = (line.split() for line in values("gyrorig-nightly.service", "ExecStart"))
    assert (batch[1], fleet[1]) == ("batch", "fleet")
    assert batch[batch.index("--store") + 1] == fleet[2]
    assert values("gyrorig-nightly.service", "Type") == ["oneshot"]  # one after the other
    assert values("gyrorig-nightly.service", "SuccessExitStatus") == ["5"]  # or no page then


def test_udev_reads_the_rules_without_complaint() -> None:
    udevadm = tool("udevadm", "udev")
    rules = FILES / "udev" / "70-gyrorig.rules"
    if "verify" in run(udevadm, "--help").stdout:  # udev 254 and later
        ended = run(udevadm, "verify", rules)
        assert ended.returncode == 0, ended.stdout
        return
    assert complaints(udevadm, rules.read_text()) == []


def test_udev_would_complain() -> None:
    udevadm = tool("udevadm", "udev")
    warnings = complaints(udevadm, 'SUBSYTEM=="tty", ENV{X}="1"\nKERNEL=="x", GOTO="nowhere"\n')
    assert len(warnings) >= 2


def complaints(udevadm: str, rules: str) -> list[str]:
    """What an udev without `verify` says of rules that only it can see, in a /run of its own."""
    if os.geteuid() != 0 or shutil.which("unshare") is None:
        pytest.skip("udevadm has no verify here, and udevadm test needs root and unshare")
    script = (
        "mount -t tmpfs tmpfs /run && mkdir -p /run/udev/rules.d && "
        "cat > /run/udev/rules.d/70-gyrorig.rules && "
        f"exec {udevadm} test --action=add /sys/class/tty/tty 2>&1"
    )
    ended = subprocess.run(
        ["unshare", "--mount", "sh", "-c", script],
        input=rules,
        capture_output=True,
        text=True,
        check=False,
        timeout=100,
    )
    lines = [line for line in ended.stdout.splitlines() if "70-gyrorig.rules" in line]
    if not lines:
        pytest.skip(f"udevadm test does not work here: {ended.stderr.strip()[:200]}")
    assert lines[0].startswith("Reading rules file")
    return lines[1:]


def test_user_and_folders_are_made(tmp_path: Path) -> None:
    users, folders = tool("systemd-sysusers"), tool("systemd-tmpfiles")
    if os.geteuid() != 0:
        pytest.skip("systemd-sysusers and systemd-tmpfiles need root, also for another root")
    (tmp_path / "etc").mkdir()
    made = run(users, f"--root={tmp_path}", FILES / "sysusers.d" / "gyrorig.conf")
    assert made.returncode == 0, made.stdout
    assert re.search(r"^dialout:.*gyrorig$", (tmp_path / "etc/group").read_text(), re.MULTILINE)
    entry = (tmp_path / "etc/passwd").read_text().strip().split(":")
    assert (entry[0], entry[6]) == ("gyrorig", "/usr/sbin/nologin")
    ended = run(folders, f"--root={tmp_path}", "--create", FILES / "tmpfiles.d" / "gyrorig.conf")
    assert (ended.returncode, ended.stdout) == (0, "")
    for name in ("recordings", "calibrations"):
        status = (tmp_path / "var/lib/gyrorig" / name).stat()
        assert (status.st_mode & 0o777, status.st_uid) == (0o750, int(entry[2]))


def test_the_units_agree_about_the_folders() -> None:
    text = (FILES / "tmpfiles.d" / "gyrorig.conf").read_text()
    made = set(re.findall(r"^d\s+(\S+)", text, re.MULTILINE))
    for unit in SERVICES:
        named = set(re.findall(r"/(?:var/lib|etc)/gyrorig(?:/\w+)?(?=[/\s]|$)", unit.read_text()))
        assert {path for path in named if not path.endswith("rig.yaml")} <= made
