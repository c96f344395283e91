"""Run inside a container by its service manager: the Debian package, installed to purged.

The findings go to /out/results.json, one object; pytest judges them outside. The emulated unit is
served by this process, with packages outside of /opt/gyrorig.
"""

import json
import shutil
import subprocess
import sys
import traceback
from pathlib import Path
from typing import Any

REPO, OUT = Path("/repo"), Path("/out")
sys.path.insert(0, str(REPO))

from tests.systemd.l2_driver import SERVICE, STATE, in_motion, is_active, say, show, until  # noqa: E402
from tests.systemd.rig_on_ptys import RigOnPtys  # noqa: E402

PACKAGE = OUT / "gyrorig.deb"
NIGHTLY = "gyrorig-nightly.timer"
CONFIG = Path("/etc/gyrorig/rig.yaml")
PROGRAM = Path("/etc/gyrorig/programs/survey-130.yaml")
COMPARED = ("/etc", "/opt", "/usr", "/var/lib")
NOT_COMPARED = ("/var/lib/dpkg", "/var/lib/systemd")  # of the managers of packages and services


def tree() -> set[str]:
    """Return the paths of all files and folders that the package can change."""
    excluded = [word for path in NOT_COMPARED for word in ("-path", path, "-prune", "-o")]
    listed = subprocess.run(
        ["find", *COMPARED, *excluded, "-print"], capture_output=True, check=True
    )
    return set(listed.stdout.decode(errors="replace").splitlines())


def dpkg(*words: str) -> dict[str, Any]:
    """Run dpkg; return its exit status and what it says."""
    ended = subprocess.run(["dpkg", *words], capture_output=True, text=True, check=False)
    return {"status": ended.returncode, "said": ended.stdout + ended.stderr}


def enabled() -> list[str]:
    """Return whether the service and the timer start with the computer."""
    return [say("systemctl", "is-enabled", unit) for unit in (SERVICE, NIGHTLY)]


def beside_another_installation() -> dict[str, Any]:
    """Try it where `make install-service` has installed."""
    mark = Path("/opt/gyrorig/installed.json")
    mark.parent.mkdir(parents=True)
    mark.write_text("{}")
    refused = dpkg("-i", str(PACKAGE))
    shutil.rmtree(mark.parent)
    return refused | {"after": dpkg("--purge", "gyrorig")}


def install() -> dict[str, Any]:
    """Install it on a computer that has never had it."""
    installed = dpkg("-i", str(PACKAGE))
    return installed | {
        "verified": dpkg("-V", "gyrorig"),
        "enabled": enabled(),
        "active": [show(unit, "ActiveState") for unit in (SERVICE, NIGHTLY)],
        "version": say("gyrorig", "--version"),
        "user": say("id", "-nG", "gyrorig"),
        "state": say("stat", "-c", "%A %U", str(STATE / "queue")),
        "example": CONFIG.read_text() == (REPO / "config/rig-raspberrypi.yaml").read_text(),
        "page": say("man", "-w", "gyrorig"),
    }


def started(rig: RigOnPtys) -> dict[str, Any]:
    """Start the service with the owner's configuration."""
    shutil.copy(rig.write_config(OUT), CONFIG)
    PROGRAM.write_text(PROGRAM.read_text() + "# the owner's\n")
    for port in rig.ports:
        shutil.chown(port, "gyrorig", "dialout")  # as udev does for a real one
    output = say("systemctl", "start", SERVICE)
    return {"said": output, "status": say("gyrorigd", "status", "--once")}


def updated(rig: RigOnPtys) -> dict[str, Any]:
    """Install it again in motion."""
    in_motion(rig)
    halts, pid = rig.halts, show(SERVICE, "MainPID")
    say("systemctl", "disable", NIGHTLY)
    result = dpkg("-i", "--force-confold", str(PACKAGE))
    return result | {
        "halted": rig.halts > halts and not rig.turns,
        "back_s": until(lambda: is_active(pid)),
        "enabled": enabled(),
        "nightly": show(NIGHTLY, "ActiveState"),
        "config": CONFIG.read_text() == (OUT / "rig.yaml").read_text(),
        "program": PROGRAM.read_text().endswith("# the owner's\n"),
    }


def removed(rig: RigOnPtys) -> dict[str, Any]:
    """Remove it in motion."""
    say("gyrorigd", "clear")
    in_motion(rig)
    halts = rig.halts
    result = dpkg("-r", "gyrorig")
    return result | {
        "halted": rig.halts > halts and not rig.turns,
        "opt": Path("/opt/gyrorig").exists(),
        "loaded": show(SERVICE, "LoadState"),
        "config": CONFIG.exists() and PROGRAM.exists(),
        "recordings": len(list((STATE / "recordings").glob("*.mcap"))),
    }


def returned() -> dict[str, Any]:
    """Install it again after the removal, and remove it again."""
    result = dpkg("-i", "--force-confold", str(PACKAGE))
    units = {"enabled": enabled(), "nightly": show(NIGHTLY, "ActiveState")}
    return result | units | {"removed": dpkg("-r", "gyrorig")}


def purged(before: set[str]) -> dict[str, Any]:
    """Purge it with recordings, and once more without."""
    result = dpkg("--purge", "gyrorig")
    recording_count = len(list((STATE / "recordings").glob("*.mcap")))
    shutil.rmtree(STATE)
    again = dpkg("-i", str(PACKAGE))["status"], dpkg("--purge", "gyrorig")["status"]
    return result | {
        "config": CONFIG.parent.exists(),
        "recordings": recording_count,
        "again": again,
        "more": sorted(tree() - before),
        "fewer": sorted(before - tree()),
    }


def main() -> None:
    """Do everything, and switch the container off, whatever happens."""
    results: dict[str, Any] = {}
    try:
        before = tree()
        results["refused"] = beside_another_installation()
        results["installed"] = install()
        with RigOnPtys() as rig:
            results["started"] = started(rig)
            results["updated"] = updated(rig)
            results["removed"] = removed(rig)
        results["returned"] = returned()
        results["purged"] = purged(before)
    except BaseException:
        results["fault"] = traceback.format_exc()
    finally:
        (OUT / "results.json").write_text(json.dumps(results, indent=1))
        say("systemctl", "poweroff", "--force")


if __name__ == "__main__":
    main()
