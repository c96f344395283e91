"""The scripts of the Debian package with a fake systemctl: which units they enable and start."""

import os
import subprocess
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).resolve().parents[2] / "release" / "debian"
SERVICE, NIGHTLY = "gyrorigd.service", "gyrorig-nightly.timer"
# The state is one file per enabled unit; each call is a line of the log.
SYSTEMCTL = """#!/bin/sh
echo "$@" >> {root}/calls
command=$1
shift
for word in "$@"; do
  case "$command/$word" in
    */--*) ;;
    enable/*) touch {root}/enabled/"$word" ;;
    disable/*) rm -f {root}/enabled/"$word" ;;
    is-enabled/*) [ -e {root}/enabled/"$word" ] || exit 1 ;;
  esac
done
"""


class Computer:
    """A folder in which the scripts believe to be the root of a computer with systemd."""

    def __init__(self, root: Path) -> None:
        self.root = root
        for folder in ("bin", "enabled", "etc/gyrorig", "run/systemd/system"):
            (root / folder).mkdir(parents=True)
        (root / "etc/gyrorig/rig.yaml").write_text("")
        (root / "bin/systemctl").write_text(SYSTEMCTL.format(root=root))
        for name in ("systemd-sysusers", "systemd-tmpfiles"):
            (root / "bin" / name).write_text("#!/bin/sh\n")
        for path in (root / "bin").iterdir():
            path.chmod(0o755)

    def run(self, script: str, *words: str) -> list[str]:
        """Run a script with dpkg's words; return the calls of systemctl."""
        text = (SCRIPTS / script).read_text()
        for folder in ("/etc/gyrorig", "/run/", "/opt/", "/var/lib/"):
            text = text.replace(folder, f"{self.root}{folder}")
        (self.root / "calls").write_text("")
        path = f"{self.root / 'bin'}:{os.defpath}"
        subprocess.run(["sh", "-c", text, script, *words], env={"PATH": path}, check=True)
        return (self.root / "calls").read_text().splitlines()

    @property
    def enabled(self) -> set[str]:
        """The units that start with the computer."""
        return {path.name for path in (self.root / "enabled").iterdir()}


@pytest.fixture
def computer(tmp_path: Path) -> Computer:
    installed = Computer(tmp_path)
    installed.run("postinst", "configure", "")
    assert installed.enabled == {SERVICE, NIGHTLY}
    return installed


@pytest.mark.parametrize("disabled", [set(), {NIGHTLY}, {SERVICE, NIGHTLY}])
def test_after_a_removal_the_same_units_are_enabled(computer: Computer, disabled: set[str]) -> None:
    for unit in disabled:
        (computer.root / "enabled" / unit).unlink()
    computer.run("prerm", "remove")
    assert computer.enabled == set()
    computer.run("postrm", "remove")
    calls = computer.run("postinst", "configure", "0.1.0")
    assert computer.enabled == {SERVICE, NIGHTLY} - disabled
    assert (f"start {NIGHTLY}" in calls) == (NIGHTLY in computer.enabled)
    assert [path.name for path in (computer.root / "etc/gyrorig").iterdir()] == ["rig.yaml"]


def test_an_update_starts_the_timer_only_if_it_is_enabled(computer: Computer) -> None:
    computer.run("prerm", "upgrade", "0.2.0")
    assert f"start {NIGHTLY}" in computer.run("postinst", "configure", "0.1.0")
    (computer.root / "enabled" / NIGHTLY).unlink()
    computer.run("prerm", "upgrade", "0.3.0")
    assert f"start {NIGHTLY}" not in computer.run("postinst", "configure", "0.2.0")
    assert computer.enabled == {SERVICE}


def test_a_purge_leaves_no_list_of_units(computer: Computer) -> None:
    computer.run("prerm", "remove")
    computer.run("postrm", "remove")
    computer.run("postrm", "purge")
    assert not (computer.root / "etc/gyrorig").exists()
