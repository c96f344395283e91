"""The units in a container with a system manager (level 2): user, sandbox, halts, nightly run.

systemd-nspawn boots an overlay of this computer's own root; nothing of it is written to. The
driver inside (`l2_driver`) does everything once; the tests judge what it has found.
"""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
DEFAULT_LIMIT = 5  # systemd's StartLimitBurst
PACKAGES = Path(pytest.__file__).resolve().parents[1]
SYSTEM_PYTHON = Path("/usr/bin/python3")
TIMEOUT_S = 220

pytestmark = [
    pytest.mark.long,
    pytest.mark.timeout(TIMEOUT_S + 20),
]  # for the container; the tests themselves only look

OVERLAY = """
set -e
mount -t tmpfs tmpfs {work}
mkdir {work}/up {work}/wk {work}/m
mount -t overlay overlay -o lowerdir=/,upperdir={work}/up,workdir={work}/wk {work}/m
rm -f {work}/m/etc/machine-id
rm -rf {work}/m/opt/gyrorig {work}/m/etc/gyrorig {work}/m/var/lib/gyrorig
cp -a {made}/. {work}/m/
timeout {limit} systemd-nspawn -D {work}/m --register=no --keep-unit -M gyrorig-l2-{pid} \
  --private-network -b --console=pipe --bind={out}:/out --bind-ro={repo}:/repo \
  systemd.unit=multi-user.target </dev/null >{out}/boot.log 2>&1 || true
for name in payload supervisor init.scope; do
  find /sys/fs/cgroup -depth -type d -path "*/$name*" -exec rmdir {{}} + 2>/dev/null || true
done
"""
DRIVER = """
[Unit]
Description=The test's driver
After=multi-user.target
[Service]
Type=simple
Environment=OPENBLAS_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE=1
ExecStart={python} {driver}
StandardOutput=append:/out/driver.log
StandardError=append:/out/driver.log
"""


# As pip writes it: workers import it too, and must not begin the batch again.
_PROGRAM = """#!/opt/gyrorig/bin/python
from {module}.cli import main

if __name__ == "__main__":
    main()
"""


def why_not() -> str:
    """Why there can be no such container here, "" where there can."""
    if os.geteuid() != 0:
        return "systemd-nspawn needs root"
    if shutil.which("systemd-nspawn") is None:
        return "no systemd-nspawn here: it comes with the package systemd-container"
    if not SYSTEM_PYTHON.exists():
        return f"no {SYSTEM_PYTHON} here, which a service's user can start"
    process = subprocess.run(
        [SYSTEM_PYTHON, "-c", "import sys; print(*sys.version_info[:2])"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if process.stdout.split() != [str(number) for number in sys.version_info[:2]]:
        return f"{SYSTEM_PYTHON} is not of the version that these packages are for"
    return ""


def programs(made: Path, name: str = "gyrorig") -> None:
    """/opt/NAME, its interpreter the system's, its packages those of this test."""
    prefix = made / "opt" / name
    packages = prefix / "lib" / f"python3.{sys.version_info[1]}" / "site-packages"
    (prefix / "bin").mkdir(parents=True)
    packages.mkdir(parents=True)
    (prefix / "bin" / "python").symlink_to(SYSTEM_PYTHON)
    (prefix / "pyvenv.cfg").write_text("home = /usr/bin\ninclude-system-site-packages = false\n")
    paths = [Path("/repo") / folder for folder in ("daemon", "solver", "firmware_protocol")]
    paths.append(
        Path("/repo") / PACKAGES.relative_to(ROOT) if PACKAGES.is_relative_to(ROOT) else PACKAGES
    )
    (packages / "gyrorig.pth").write_text("".join(f"{path}\n" for path in paths))
    for command, module in (("gyrorigd", "gyrorig_daemon"), ("gyrorig", "gyrorig_solver")):
        script = prefix / "bin" / command
        script.write_text(_PROGRAM.format(module=module))
        script.chmod(0o755)


def results_of_container(
    folder: Path, made: Path, python: str, driver: str, limit_s: int = TIMEOUT_S
) -> dict[str, Any]:
    """Boot a container, let a driver run in it, and return what it has found.

    Args:
        folder: a new folder.
        made: the files that the container has beside those of this computer.
        python: the interpreter of the driver.
        driver: the path of the driver, inside.
        limit_s: when it is ended.
    """
    if why := why_not():
        pytest.skip(why)
    out, work = folder / "out", folder / "work"
    out.mkdir(exist_ok=True)
    out.chmod(0o777)
    work.mkdir()
    units = made / "etc" / "systemd" / "system"
    (units / "multi-user.target.wants").mkdir(parents=True)
    (units / "driver.service").write_text(DRIVER.format(python=python, driver=driver))
    (units / "multi-user.target.wants" / "driver.service").symlink_to("../driver.service")
    script = OVERLAY.format(
        work=work, made=made, out=out, repo=ROOT, limit=limit_s, pid=os.getpid()
    )
    ended = subprocess.run(
        ["unshare", "--mount", "--propagation", "private", "bash", "-c", script],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    results = out / "results.json"
    if not results.exists():
        boot = (out / "boot.log").read_text(errors="replace") if (out / "boot.log").exists() else ""
        if ended.returncode != 0 or not (out / "driver.log").exists():
            pytest.skip(f"no container boots here: {(ended.stderr + boot).strip()[-300:]}")
        pytest.fail(f"the driver said nothing: {(out / 'driver.log').read_text()}\n{boot[-1500:]}")
    loaded: dict[str, Any] = json.loads(results.read_text())
    return loaded


@pytest.fixture(scope="module")
def observed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("l2")
    programs(folder / "made")
    return results_of_container(
        folder, folder / "made", "/opt/gyrorig/bin/python", "/repo/tests/systemd/l2_driver.py"
    )


def test_nothing_went_wrong_inside(observed: dict[str, Any]) -> None:
    assert "fault" not in observed, observed["fault"]


def test_installed_on_a_running_system(observed: dict[str, Any]) -> None:
    output = observed["install"]["said"]
    assert "wrote /etc/systemd/system/gyrorigd.service" in output
    assert "gyrorigd doctor" in output
    assert "wrote" not in observed["install"]["again"]


def test_ready_as_its_own_user(observed: dict[str, Any]) -> None:
    ready = observed["ready"]
    assert (ready["said"], ready["active"], ready["user"]) == ("", "active", "gyrorig")
    assert ready["dialout"] in ready["groups"].split()  # it may open serial ports
    assert ready["halted"]
    assert ready["socket"] == "srw-rw---- gyrorig gyrorig"
    assert ready["socket_folder"] == "drwxr-x--- gyrorig gyrorig"
    assert ready["metrics"] == "-rw-r----- gyrorig gyrorig"  # its group may read them
    assert "rig l1" in ready["status"]
    assert "rig l1" not in ready["stranger"]  # who is not in its group


def test_the_sandbox(observed: dict[str, Any]) -> None:
    inside = dict(observed["ready"]["inside"])
    assert inside.pop("uid") == observed["ready"]["uid"] != 0
    assert inside == {
        "capabilities": "0000000000000000",
        "no_new_privileges": "1",
        "seccomp": "2",
        "write_etc": "EROFS",
        "write_usr": "EROFS",
        "write_state": "",
        "homes": 0,
        "root_home": "EACCES",
        "internet": "EAFNOSUPPORT",
        "netlink": "EAFNOSUPPORT",
        "unix": "",
        "write_and_run": "EPERM",
        "set_clock": "EPERM",
        "affinity": "EPERM",
        "set_uid": "EPERM",
        "namespace": "EPERM",
        "numbers": "",
    }


def test_killed_and_hung_in_motion(observed: dict[str, Any]) -> None:
    for how in ("killed", "hung"):
        assert observed[how]["stands_s"] < 12.0  # of 37 s that it would have turned
    assert not observed["killed"]["turns"]
    assert "ended by signal" in observed["hung"]["log"]
    assert "ended by watchdog" in observed["hung"]["log"]


def test_a_crash_loop_does_not_end_it(observed: dict[str, Any]) -> None:
    # one kill, one hang, and as many kills in a row as the default would not have borne
    loop = observed["crash_loop"]
    assert (loop["restarts"], loop["limit"]) == (2 + loop["kills"], "0")
    assert loop["kills"] > DEFAULT_LIMIT


def test_stopped_in_motion(observed: dict[str, Any]) -> None:
    stopped = observed["stopped"]
    assert (stopped["result"], stopped["turns"]) == ("success", False)
    assert stopped["took_s"] < 30.0
    assert stopped["mode"] == "drwxr-x--- gyrorig"
    assert stopped["metrics_stay"]  # whoever reads them sees how old they are
    assert "unclean" in stopped["recordings"]  # of the sessions that were killed
    assert not [name for name in stopped["recordings"] if name.endswith(".part")]
    assert len([name for name in stopped["recordings"] if name.endswith(".mcap")]) == 3


def test_the_nightly_run(observed: dict[str, Any]) -> None:
    night = observed["night"]
    assert night["result"] == "success", night
    assert night["status"] in (0, 5)
    assert "v0001.yaml" in night["versions"], night["log"]
    assert night["page"] == {"index.html": True, "data.js": True}, night
    assert night["owner"] == "gyrorig"
    assert "gyrorig-nightly.timer" in night["next"]
