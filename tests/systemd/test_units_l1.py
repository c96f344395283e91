"""The units under a real service manager (level 1): ready, watched, restarted, halted.

The manager is `systemd --user` in a namespace of its own; the unit to be turned is emulated
outside of it and goes on with its last order, whatever becomes of the daemon.
"""

import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.systemd.manager import Manager, for_a_user, why_not
from tests.systemd.rig_on_ptys import FAR, RigOnPtys

ROOT = Path(__file__).resolve().parents[2]
UNITS = ROOT / "systemd" / "system"
PREFIX = Path(sys.executable).parents[1]
SERVICE = "gyrorigd.service"
# Seconds instead of tens of them: what is tested is the order of things.
QUICK = """
[Service]
WatchdogSec=3
TimeoutAbortSec=0.3
RestartSec=0.3
StandardError=append:{log}
StandardOutput=append:{log}
ExecStopPost=/bin/sh -c 'echo "ended by $SERVICE_RESULT"'
"""


@pytest.fixture(scope="module")
def rig() -> Iterator[RigOnPtys]:
    with RigOnPtys() as served:
        yield served


@pytest.fixture(scope="module")
def manager(rig: RigOnPtys, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Manager]:
    if why := why_not():
        pytest.skip(why)
    folder = tmp_path_factory.mktemp("l1")
    config = rig.write_config(folder)
    (folder / "far.yaml").write_text(FAR)
    made = Manager(folder)
    for unit in UNITS.iterdir():
        (made.units / unit.name).write_text(for_a_user(unit.read_text(), PREFIX, config))
    more = made.units / f"{SERVICE}.d"
    more.mkdir()
    (more / "quick.conf").write_text(QUICK.format(log=folder / "daemon.log"))
    with made:
        yield made


@pytest.fixture
def started(manager: Manager) -> Manager:
    """The daemon, ready, whatever the test before has left."""
    output = manager.say(f"systemctl --user start {SERVICE}")
    assert output == "", output + log(manager)[-2000:]
    return manager


def log(manager: Manager) -> str:
    return (manager.folder / "daemon.log").read_text()


def in_motion(manager: Manager, rig: RigOnPtys) -> None:
    state = manager.show(SERVICE, "MainPID")
    assert int(state["MainPID"]) > 0
    output = manager.say(
        f"{PREFIX}/bin/gyrorigd enqueue --program {manager.folder}/far.yaml"
        f" --state {manager.folder}/config/gyrorig"
    )
    assert output.endswith("far"), output
    manager.until(lambda: rig.turns)


def test_ready_means_halted_and_identified(manager: Manager, rig: RigOnPtys) -> None:
    rig.order(b"PS200 PP3000 ")
    halts = rig.halts
    assert manager.say(f"systemctl --user start {SERVICE}") == ""  # returns when it is ready
    assert rig.halts > halts
    assert not rig.turns
    assert manager.show(SERVICE, "ActiveState")["ActiveState"] == "active"
    assert "rig l1" in manager.say(
        f"{PREFIX}/bin/gyrorigd status --once --socket /run/user/0/gyrorig/gyrorigd.sock"
    )


def test_stopped_in_motion(started: Manager, rig: RigOnPtys) -> None:
    in_motion(started, rig)
    begun = time.monotonic()
    assert started.say(f"systemctl --user stop {SERVICE}") == ""
    assert time.monotonic() - begun < 30.0  # TimeoutStopSec
    assert not rig.turns
    assert started.show(SERVICE, "Result")["Result"] == "success"
    recordings = sorted((started.folder / "config" / "gyrorig" / "recordings").iterdir())
    assert [path.suffix for path in recordings if "part" in path.name] == []
    assert recordings


def test_killed_in_motion(started: Manager, rig: RigOnPtys) -> None:
    in_motion(started, rig)
    halts = rig.halts
    started.say(f"systemctl --user kill --signal=KILL {SERVICE}")  # all of its processes
    started.until(lambda: not rig.turns, 30.0)  # of 37 s that it would have turned
    assert rig.halts > halts
    started.until(
        lambda: (
            started.show(SERVICE, "NRestarts", "ActiveState")
            == {"NRestarts": "1", "ActiveState": "active"}
        )
    )
    assert not rig.turns  # what was running is not begun again
    assert "ended by signal" in log(started)


def test_hung_in_motion(started: Manager, rig: RigOnPtys) -> None:
    in_motion(started, rig)
    halts = rig.halts
    pid = started.show(SERVICE, "MainPID")["MainPID"]
    started.say(f"kill -STOP {pid}")
    started.until(lambda: rig.halts > halts and not rig.turns, 30.0)
    started.until(lambda: "ended by watchdog" in log(started))
    started.until(lambda: started.show(SERVICE, "MainPID")["MainPID"] not in ("0", pid))
    started.until(lambda: started.show(SERVICE, "ActiveState")["ActiveState"] == "active")


def test_a_broken_configuration(started: Manager) -> None:
    config = started.folder / "rig.yaml"
    sound = config.read_text()
    config.write_text(sound + "unknown: 1\n")
    try:
        pid = started.show(SERVICE, "MainPID")["MainPID"]
        started.say(f"systemctl --user reload {SERVICE}")
        started.until(lambda: "unknown" in log(started))
        assert started.show(SERVICE, "MainPID", "ActiveState") == {
            "MainPID": pid,
            "ActiveState": "active",
        }  # the old one stays in force
        started.say(f"systemctl --user restart {SERVICE}")
        started.until(lambda: started.show(SERVICE, "ActiveState")["ActiveState"] == "failed")
        restarts = started.show(SERVICE, "NRestarts")
        state = started.show(SERVICE, "Result", "ExecMainStatus")
        assert (state["Result"], state["ExecMainStatus"]) == ("exit-code", "2")
        assert started.show(SERVICE, "NRestarts") == restarts  # a person has to mend it
    finally:
        config.write_text(sound)


def test_a_night_that_was_slept_through_is_made_up_for(manager: Manager) -> None:
    stamp = manager.folder / "data" / "systemd" / "timers" / "stamp-gyrorig-nightly.timer"
    stamp.parent.mkdir(parents=True)
    stamp.touch()
    three_days_ago_s = time.time() - 3 * 86400
    os.utime(stamp, (three_days_ago_s, three_days_ago_s))
    more = manager.units / "gyrorig-nightly.timer.d"
    more.mkdir()
    (more / "at-once.conf").write_text("[Timer]\nRandomizedDelaySec=0\n")
    nothing = manager.units / "gyrorig-nightly.service.d"
    nothing.mkdir()
    (nothing / "quick.conf").write_text("[Service]\nExecStart=\nExecStart=/bin/true\n")
    assert manager.say("systemctl --user daemon-reload") == ""
    assert manager.say("systemctl --user start gyrorig-nightly.timer") == ""
    manager.until(
        lambda: (
            manager.show("gyrorig-nightly.service", "ExecMainStartTimestamp").get(
                "ExecMainStartTimestamp", ""
            )
            != ""
        )
    )
    manager.until(
        lambda: (
            "02:30:00"
            in manager.say("systemctl --user list-timers --no-legend gyrorig-nightly.timer")
        )
    )
