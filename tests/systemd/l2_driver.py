"""Run inside the container by its service manager: install, start, kill, and write it down.

What is found goes to /out/results.json, one object; pytest judges it outside. The emulated
unit is served by this process, and outlives every daemon that talks to it.
"""

import json
import os
import shutil
import subprocess
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

REPO, OUT = Path("/repo"), Path("/out")
sys.path.insert(0, str(REPO))

from tests.systemd.rig_on_ptys import FAR, RigOnPtys  # noqa: E402

SERVICE = "gyrorigd.service"
STATE = Path("/var/lib/gyrorig")
SOCKET = Path("/run/gyrorig/gyrorigd.sock")
METRICS = Path("/run/gyrorig/metrics/gyrorig.prom")
KILLS = 6  # systemd by itself gives up at the sixth start within 10 s
CHUNK_BYTES = 2000  # of a second: what was killed has something to be recovered
DROP_IN = """
[Service]
WatchdogSec=3
TimeoutAbortSec=1
RestartSec=0.2
StandardOutput=append:/out/daemon.log
StandardError=append:/out/daemon.log
ReadWritePaths=/out
ExecStartPost=/opt/gyrorig/bin/python /repo/tests/systemd/l2_inside.py /out/inside.json
ExecStopPost=/bin/sh -c 'echo "ended by $SERVICE_RESULT"'
"""

# As shipped it yields to everything; here others must not make it late.
NIGHT = "[Service]\nNice=0\nCPUSchedulingPolicy=other\nIOSchedulingClass=best-effort\n"


def say(*words: str) -> str:
    """Run a program and return what it says."""
    ended = subprocess.run(words, capture_output=True, text=True, check=False)
    return (ended.stdout + ended.stderr).strip()


def show(unit: str, name: str) -> str:
    """Return a property of a unit."""
    return say("systemctl", "show", unit, "-p", name, "--value")


def until(holds: Callable[[], bool], limit_s: float = 60.0) -> float:
    """Wait for a condition; return how long that took, or raise."""
    begun_s = time.monotonic()
    while not holds():
        if time.monotonic() - begun_s > limit_s:
            raise TimeoutError(f"waited {limit_s} s in vain")
        time.sleep(0.02)
    return round(time.monotonic() - begun_s, 2)


def is_active(pid_is_not: str = "") -> bool:
    """True when the daemon is ready, in another process than before."""
    return show(SERVICE, "ActiveState") == "active" and show(SERVICE, "MainPID") != pid_is_not


def in_motion(rig: RigOnPtys) -> None:
    """Hand in a long move and wait until the unit turns."""
    program = OUT / "far.yaml"
    program.write_text(FAR)
    say("gyrorigd", "enqueue", "--program", str(program))
    until(lambda: rig.turns)
    began = written()
    until(lambda: written() > began + CHUNK_BYTES)


def written() -> int:
    """Return how much there is of the recording that is being written."""
    parts = (STATE / "recordings").glob("*.part")
    return max((path.stat().st_size for path in parts), default=0)


def install(rig: RigOnPtys) -> dict[str, Any]:
    """Install the files as on a Pi, with a configuration for the emulated ports."""
    output = say("/usr/bin/python3", str(REPO / "systemd/install.py"), "--only-files")
    config = rig.write_config(OUT)
    shutil.copy(config, "/etc/gyrorig/rig.yaml")
    for port in rig.ports:
        shutil.chown(port, "gyrorig", "dialout")  # as udev does for a real one
    more = Path(f"/etc/systemd/system/{SERVICE}.d")
    more.mkdir()
    (more / "test.conf").write_text(DROP_IN)
    night = Path("/etc/systemd/system/gyrorig-nightly.service.d")
    night.mkdir()
    (night / "test.conf").write_text(NIGHT)
    say("systemctl", "daemon-reload")
    return {"said": output, "again": say("/usr/bin/python3", str(REPO / "systemd/install.py"),
                                       "--only-files")}  # fmt: skip


def ready(rig: RigOnPtys) -> dict[str, Any]:
    """Start with a unit that somebody has left turning."""
    rig.order(b"PS200 PP3000 ")
    until(lambda: rig.turns)
    halts = rig.halts
    began_s = time.monotonic()
    output = say("systemctl", "restart", SERVICE)
    pid = show(SERVICE, "MainPID")
    until(METRICS.exists)
    return {
        "said": output,
        "took_s": round(time.monotonic() - began_s, 2),
        "active": show(SERVICE, "ActiveState"),
        "halted": rig.halts > halts and not rig.turns,
        "user": say("ps", "-o", "user=", "-p", pid),
        "groups": Path(f"/proc/{pid}/status").read_text().split("Groups:")[1].split("\n")[0],
        "dialout": say("getent", "group", "dialout").split(":")[2],
        "socket": say("stat", "-c", "%A %U %G", str(SOCKET)),
        "socket_folder": say("stat", "-c", "%A %U %G", str(SOCKET.parent)),
        "metrics": say("stat", "-c", "%A %U %G", str(METRICS)),
        "status": say("/usr/local/bin/gyrorigd", "status", "--once"),
        "stranger": say("setpriv", "--reuid=65534", "--regid=65534", "--clear-groups",
                        "/usr/local/bin/gyrorigd", "status", "--once"),
        "inside": json.loads((OUT / "inside.json").read_text()),
        "uid": int(say("id", "-u", "gyrorig")),
    }  # fmt: skip


def killed(rig: RigOnPtys) -> dict[str, Any]:
    """Kill every process of it in motion."""
    in_motion(rig)
    halts, pid = rig.halts, show(SERVICE, "MainPID")
    say("systemctl", "kill", "--signal=KILL", SERVICE)
    stands_s = until(lambda: not rig.turns and rig.halts > halts)
    back_s = until(lambda: is_active(pid))
    return {"stands_s": stands_s, "back_s": back_s, "turns": rig.turns}


def hung(rig: RigOnPtys) -> dict[str, Any]:
    """Stop it in motion, as a hang does."""
    in_motion(rig)
    halts, pid = rig.halts, show(SERVICE, "MainPID")
    os.kill(int(pid), 19)
    stands_s = until(lambda: not rig.turns and rig.halts > halts)
    back_s = until(lambda: is_active(pid))
    return {"stands_s": stands_s, "back_s": back_s, "log": (OUT / "daemon.log").read_text()}


def crash_loop() -> dict[str, Any]:
    """Kill it as soon as it is there again: a rig has to heal unattended."""
    for _ in range(KILLS):
        pid = show(SERVICE, "MainPID")
        if pid != "0":
            say("systemctl", "kill", "--signal=KILL", "--kill-whom=main", SERVICE)
        until(lambda pid=pid: show(SERVICE, "MainPID") not in ("0", pid))  # type: ignore[misc]
    until(is_active)
    recovered = STATE / "recordings" / "unclean"
    until(lambda: recovered.is_dir() and not written())
    return {
        "kills": KILLS,
        "restarts": int(show(SERVICE, "NRestarts")),
        "limit": show(SERVICE, "StartLimitIntervalUSec"),  # 0: the default gives up after five
    }


def stopped(rig: RigOnPtys) -> dict[str, Any]:
    """Stop it in motion."""
    in_motion(rig)
    began_s = time.monotonic()
    say("systemctl", "stop", SERVICE)
    return {
        "took_s": round(time.monotonic() - began_s, 2),
        "turns": rig.turns,
        "result": show(SERVICE, "Result"),
        "recordings": sorted(path.name for path in (STATE / "recordings").iterdir()),
        "mode": say("stat", "-c", "%A %U", str(STATE / "recordings")),
        "metrics_stay": METRICS.exists(),
    }


def night() -> dict[str, Any]:
    """The nightly run on what was recorded here, and on one session that was let alone."""
    made = say("/usr/local/bin/gyrorigd", "record", "--config", str(REPO / "config/rig.yaml"),
               "--program", "/etc/gyrorig/programs/survey-40.yaml", "--simulated-time",
               "--out", str(OUT / "made"))  # fmt: skip
    for path in (OUT / "made").glob("*.mcap"):
        shutil.copy(path, STATE / "recordings")
        shutil.chown(STATE / "recordings" / path.name, "gyrorig", "gyrorig")
    say("systemctl", "start", "gyrorig-nightly.service")
    store = STATE / "calibrations"
    return {
        "made": made,
        "log": say("journalctl", "--no-pager", "-u", "gyrorig-nightly.service")[-2000:],
        "result": show("gyrorig-nightly.service", "Result"),
        "status": int(show("gyrorig-nightly.service", "ExecMainStatus")),
        "versions": sorted(path.name for path in store.glob("calib/*/*/*/v*.yaml")),
        "page": {name: (store / "fleet" / name).is_file() for name in ("index.html", "data.js")},
        "owner": say("stat", "-c", "%U", str(store / "fleet" / "index.html")),
        "next": say("systemctl", "list-timers", "--no-legend", "gyrorig-nightly.timer"),
    }


def main() -> None:
    """Do everything, and switch the container off, whatever happens."""
    results: dict[str, Any] = {}
    try:
        with RigOnPtys() as rig:
            results["install"] = install(rig)
            results["ready"] = ready(rig)
            results["killed"] = killed(rig)
            results["hung"] = hung(rig)
            results["crash_loop"] = crash_loop()
            results["stopped"] = stopped(rig)
            results["night"] = night()
    except BaseException:
        results["fault"] = traceback.format_exc()
    finally:
        (OUT / "results.json").write_text(json.dumps(results, indent=1))
        say("systemctl", "poweroff", "--force")


if __name__ == "__main__":
    main()
