"""Level 3: the service on a machine of its own. `make test-qemu`; minutes, root, a network once.

The unit is emulated on the host, behind the machine's USB adapter, so that its log shows
what the daemon said to it. At the end the power is cut, and what is left on the disk is
read on the host.
"""

# ruff: noqa: T201 - a program that prints what it finds
import argparse
import math
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.qemu.image import disk
from tests.qemu.machine import Machine, missing_tools, until
from tests.systemd.rig_on_ptys import RigOnPtys

from gyrorig_daemon.recorder.recovery import recover_folder
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import times_ns

BOOT_S = 600.0  # half a minute on a quiet host
STEP_S = 900.0
SAMPLES = "/board/C-1/imu_raw"
LIMIT_S = 2.0  # docs/recordings.md: a sync a second, a chunk half a second, and their turns
# An emulated processor is slower than any Pi, and the promise counts on turns of some 10 ms
# and syncs of as much. What both took on this guest is measured while it runs and added, up
# to this.
MOST_ADDED_S = 2.0
TOLD_EVERY_S = 0.2  # the guest's NOW
EXPECTED = {
    "cgroup2": "True",
    "by_id": "1",
    "latency_timer": "1",
    "modem_manager": "True",
    "owner": "dialout",
    "start": "ready",
    # Its driver says so, because the daemon has it alone (TIOCEXCL): a device that the cgroup
    # keeps shut is refused before its driver is asked, as ttyS0 is.
    "open_ttyUSB0": "Device or resource busy",
    "open_ttyS0": "Operation not permitted",
    "status_is_told": "True",
    "held": "fault",
    "steps_are_sure": "True",
    "waiting": "0",  # the session that was broken off is not begun again
    "cleared": "The motion lock is being released. `gyrorigd status` shows the result.",
    "after_the_jump": "running",
}


def main() -> int:
    """Run it; returns 1 where something was not as it should be, 0 too where it cannot be."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--images", type=Path, default=Path("qemu"), help="kept between runs")
    options = parser.parse_args()
    if missing := missing_tools():
        print(
            f"make test-qemu: not here: {', '.join(missing)}: "
            "apt install qemu-system-x86 mmdebstrap"
        )
        return 0
    began_s = time.monotonic()
    image = disk(options.images)
    print(f"image: {time.monotonic() - began_s:.0f} s", flush=True)
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        copy = folder / "disk.ext4"
        subprocess.run(["cp", "--sparse=always", str(image.disk), str(copy)], check=True)
        with (
            RigOnPtys() as rig,
            Machine(replace(image, disk=copy), rig.ports[0], folder) as machine,
        ):
            try:
                observed = watch(machine, rig)
            except (TimeoutError, RuntimeError) as fault:
                print(f"FAILED {fault}")
                shutil.copy(machine.console, options.images / "console.txt")
                return 1
        wrong = judge(observed)
        wrong += after_the_cut(copy, folder / "mount", observed)
    print(f"{time.monotonic() - began_s:.0f} s in all; {wrong} not as expected")
    return int(wrong > 0)


def watch(machine: Machine, rig: RigOnPtys) -> dict[str, str]:
    """Do to the machine what it asks for; return what it found."""
    began_s = time.monotonic()
    machine.wait_for("RESULT up_s", BOOT_S)
    print(f"booted: {time.monotonic() - began_s:.0f} s", flush=True)
    machine.wait_for("WANT unplug", STEP_S)
    until(lambda: rig.turns, STEP_S, lambda: "the unit does not turn")
    machine.unplug()
    machine.wait_for("WANT plug", STEP_S)
    halts = rig.halts
    observed = {"turns_while_away": str(rig.turns)}
    machine.plug()
    machine.wait_for("RESULT back", STEP_S)
    observed |= {"halted_on_return": str(rig.halts > halts), "stands": str(not rig.turns)}
    machine.wait_for("WANT cut", STEP_S)
    machine.cut()
    told_s: list[float] = []
    for line in machine.words():
        kind, _, rest = line.partition(" ")
        if kind == "RESULT":
            name, _, value = rest.partition(" ")
            observed[name] = value
        elif kind == "NOW":
            told_s.append(float(rest))
        elif kind == "FAULT":
            raise RuntimeError(rest)
    late_s = max(after - before for before, after in pairwise(told_s)) - TOLD_EVERY_S
    return observed | {"cut_at": repr(told_s[-1]), "latest_turn_s": f"{max(late_s, 0.0):.2f}"}


def judge(observed: dict[str, str]) -> int:
    """Print what was found; return how much of it should not be so."""
    wanted = EXPECTED | {"halted_on_return": "True", "stands": "True"}
    wrong = 0
    for name, value in observed.items():
        bad = name in wanted and wanted[name] != value
        wrong += bad
        print(f"{'WRONG' if bad else 'ok':6}{name}: {value}")
    wrong += len(missing := set(wanted) - set(observed))
    print(f"not told: {', '.join(sorted(missing)) or 'nothing'}")
    return wrong


def after_the_cut(image: Path, at: Path, observed: dict[str, str]) -> int:
    """Read what is on the disk after the power cut; return 1 where too much is missing."""
    at.mkdir()
    subprocess.run(["mount", "-o", "loop", str(image), str(at)], check=True)
    try:
        saved = at.parent / "kept"
        shutil.copytree(at / "var/lib/gyrorig/recordings", saved)
    finally:
        subprocess.run(["umount", str(at)], check=True)
    for report in recover_folder(saved):
        print(f"      recovered {report}")
    last_s = max(last_sample_s(path) for path in saved.glob("*.mcap"))
    lost_s = (
        float(observed["cut_at"]) + TOLD_EVERY_S - last_s
    )  # at most: it was cut before the next
    added_s = float(observed["latest_turn_s"]) + float(observed["sync_max_ms"]) * 1e-3
    limit_s = LIMIT_S + min(added_s, MOST_ADDED_S)
    bad = not lost_s < limit_s
    print(
        f"{'WRONG' if bad else 'ok':6}lost by the power cut: {lost_s:.2f} s, of {limit_s:.2f} s "
        f"allowed: {LIMIT_S:.1f} s promised, {added_s:.2f} s that the guest was late"
    )
    return int(bad)


def last_sample_s(path: Path) -> float:
    """Return when a recording's last sample was, on the guest's raw clock.

    By no file's date: the wall clock has jumped meanwhile.
    """
    recording = read_recording(path)
    if SAMPLES not in recording.topics:
        return -math.inf
    metadata = recording.metadata["gyrorig"]
    last_ns = int(times_ns(recording.array(SAMPLES)["host_time"][-1:])[0])
    return (
        last_ns - int(metadata["anchor_utc_ns"]) + int(metadata["anchor_monotonic_raw_ns"])
    ) * 1e-9


if __name__ == "__main__":
    sys.exit(main())
