"""Inside the machine: what udev did, how the service lives, and when to do what to it.

Says one line at a time on the second serial port: `RESULT name value`, `WANT what`, and
`NOW seconds` five times a second once a recording runs.
"""

import json
import os
import random
import socket
import struct
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gyrorig_daemon.service.service_client import send_command
from gyrorig_protocol.board import Hello, Sensor
from gyrorig_protocol.can import (
    CanFrame,
    gyro_frame,
    hello_frames,
    latch_frame,
    status_frame,
    sync_frame,
)
from gyrorig_protocol.errors import GyrorigError

PORT = Path("/dev/gyrorig/RIG0001-if00")
SERVICE = "gyrorigd.service"
GYRORIGD = "/usr/local/bin/gyrorigd"
SOCKET = Path("/run/gyrorig/gyrorigd.sock")
STEP_S = 300.0
FRAME = struct.Struct("=IB3x8s")
NODE = 1
RATE_HZ = 25.0
RIG = f"""rig: l3
ptu: {{port: {PORT}, baud: 115200, poll: {{rate_hz: 10}}}}
buses: [{{id: can0, port: "socketcan:vcan0"}}]
boards: [{{id: C-1, bus: can0, node: {NODE}}}]
service: {{reserve_mb: 16, aftermath_s: 5.0}}
"""
LONG = "name: long\nsteps:\n  - move: {pan_deg: 120.0, speed_deg_s: 2.0}\n"
REST = "name: rest\nsteps:\n  - rest: {seconds: 600.0}\n"
INSIDE = """
import json, os
def can(path):
    try:
        os.close(os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK))
    except OSError as fault:
        return fault.strerror
    return "opened"
with open(os.environ["STATE_DIRECTORY"] + "/inside.json", "w") as file:
    json.dump({name: can("/dev/" + name) for name in ("ttyUSB0", "ttyS0")}, file)
"""

words = Path("/dev/ttyS1").open("w", buffering=1)  # noqa: SIM115 - for as long as it runs


def say(*what: object) -> None:
    """Say one line to the host."""
    words.write(" ".join(str(word) for word in what) + "\n")
    words.flush()


def run(*command: str) -> str:
    """Run a program; return what it says."""
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    return (ended.stdout + ended.stderr).strip()


def until(holds: Callable[[], bool], limit_s: float, what: str) -> None:
    """Wait for a condition."""
    end_s = time.monotonic() + limit_s
    while not holds():
        if time.monotonic() > end_s:
            raise TimeoutError(f"waited {limit_s:.0f} s for {what}")
        time.sleep(0.2)


def status() -> dict[str, Any]:
    """Return the daemon's status, nothing where it gives none in time.

    Asked by this process: an emulated processor takes seconds to start a program, and takes
    them from the daemon.
    """
    try:
        answer: dict[str, Any] = send_command(SOCKET, "status")["status"]
    except GyrorigError:
        return {}
    return answer


def unit_state() -> dict[str, Any]:
    """Return the daemon's status, asked until there is one."""
    state: dict[str, Any] = {}

    def look() -> bool:
        state.update(status())
        return bool(state)

    until(look, 120.0, "any status")
    return state


def wait_for_state(state: str) -> None:
    """Wait until the daemon is in a state."""
    until(lambda: status().get("state") == state, STEP_S, f"the state {state}")


def board() -> None:
    """Be a board of ours on vcan0, for ever: as many samples as an emulated processor bears."""
    bus = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    bus.bind(("vcan0",))
    bus.setblocking(False)
    gyro = Sensor(who=211, full_scale=250.0, per_count=0.00875, rate_hz=RATE_HZ)
    hello = Hello(1, "1.0", "l3", "L3-BOARD", 1, (gyro,))
    begun, number = time.monotonic(), 0

    def send(frame: CanFrame) -> None:
        try:
            bus.send(FRAME.pack(frame.identifier, len(frame.data), frame.data))
        except OSError:
            return

    while True:
        clock = int((time.monotonic() - begun) * 1e6)
        try:
            identifier, _, data = FRAME.unpack(bus.recv(16))
            if identifier == sync_frame(0).identifier:
                send(latch_frame(NODE, data[0], 1, clock))
        except BlockingIOError:
            pass
        if number % int(RATE_HZ) == 0:
            for frame in hello_frames(NODE, hello.encode_payload()[1:]):
                send(frame)
        due = begun + number / RATE_HZ
        if time.monotonic() >= due:
            ticks = int(number / RATE_HZ * 1e6) & 0xFFFFFFFF
            if number % 10 == 0:
                send(status_frame(NODE, ticks, number & 0xFFFF, 1))
            send(gyro_frame(NODE, (random.randint(-9, 9), number % 100, 3), ticks))
            number += 1
        time.sleep(0.002)


def udev() -> None:
    """What the rules did to the adapter."""
    until(PORT.exists, STEP_S, str(PORT))
    say("RESULT", "link", os.path.realpath(PORT))
    say("RESULT", "by_id", len(list(Path("/dev/serial/by-id").glob("*RIG0001*"))))
    name = Path(os.path.realpath(PORT)).name
    timer = Path(f"/sys/bus/usb-serial/devices/{name}/latency_timer").read_text().strip()
    say("RESULT", "latency_timer", timer)
    properties = run("udevadm", "info", "--query=property", f"--name={PORT}")
    say("RESULT", "modem_manager", "ID_MM_DEVICE_IGNORE=1" in properties)
    say("RESULT", "owner", run("stat", "-c", "%G", os.path.realpath(PORT)))


def begin(name: str, program: str) -> None:
    """Hand a session in and wait until it runs; one that ends before has not begun.

    Raises:
        RuntimeError: it was refused, or failed, or was not taken.
    """
    path = Path("/tmp/program.yaml")  # noqa: S108
    path.write_text(program)
    job = run(GYRORIGD, "enqueue", "--session", name, "--program", str(path))
    say("RESULT", f"job_{name}", job)

    def runs() -> bool:
        state = status()
        last = state.get("last_session") or {}
        if last.get("session") == name:
            raise RuntimeError(f"session {name}: {last['result']}: {last['reason']}")
        session = state.get("session") or {}
        # `running` begins before there is a recording; a step is one that is carried out.
        return state.get("state") == "running" and "step" in session

    until(runs, STEP_S, f"session {name}")


def serve() -> None:
    """The service on a real driver and a real bus, under cgroups that are enforced."""
    Path("/etc/gyrorig/rig.yaml").write_text(RIG)
    more = Path(f"/etc/systemd/system/{SERVICE}.d")
    more.mkdir(exist_ok=True)
    Path("/opt/l3/inside.py").write_text(INSIDE)
    (more / "l3.conf").write_text(
        "[Service]\nWatchdogSec=60\nTimeoutStartSec=300\n"
        "ExecStartPost=/opt/gyrorig/bin/python /opt/l3/inside.py\n"
    )
    run("systemctl", "daemon-reload")
    say("RESULT", "start", run("systemctl", "restart", SERVICE) or "ready")
    inside = json.loads(Path("/var/lib/gyrorig/inside.json").read_text())
    for name, state in inside.items():
        say("RESULT", f"open_{name}", state)
    until(lambda: any(b["state"] == "known" for b in status().get("boards", [])), STEP_S,
          "the board on vcan0")  # fmt: skip
    say("RESULT", "board", unit_state()["boards"][0]["state"])
    say("RESULT", "status_is_told", unit_state()["rig"] in run(GYRORIGD, "status", "--once"))


def pulled() -> None:
    """The adapter is pulled in motion and plugged in again."""
    begin("long", LONG)
    say("WANT", "unplug")
    until(lambda: not PORT.exists(), STEP_S, "the adapter to go")
    until(lambda: status().get("unit", {}).get("state") in ("absent", "silent"), STEP_S,
          "the unit to be missed")  # fmt: skip
    say("RESULT", "missed", unit_state()["unit"]["text"])
    say("WANT", "plug")
    until(PORT.exists, STEP_S, "the adapter to come back")
    until(lambda: status().get("unit", {}).get("state") == "stands", STEP_S, "the unit to stand")
    now = unit_state()
    say("RESULT", "back", now["unit"]["text"])
    say("RESULT", "held", now["state"])
    say("RESULT", "steps_are_sure", now["unit"]["steps_are_sure"])
    last = now["last_session"] or {"result": "forgotten", "reason": "the daemon is another one"}
    say("RESULT", "ended", last["result"], last["reason"])
    say("RESULT", "waiting", now["queue"]["waiting"])
    say("RESULT", "cleared", run(GYRORIGD, "clear"))
    wait_for_state("ready")


def clock_jumps() -> None:
    """The wall clock jumps by five years while a session runs."""
    # What is five years overdue then must not slow down an emulated processor.
    run("systemctl", "stop", "*.timer")
    begin("rest", REST)
    before = unit_state()["boards"][0]["counts"]["samples"]
    run("date", "--set=+5 years")
    time.sleep(5.0)
    now = unit_state()
    say("RESULT", "after_the_jump", now["state"])
    say("RESULT", "samples_meanwhile", now["boards"][0]["counts"]["samples"] - before)
    say("RESULT", "clock_steps", now["counts"].get("clock_steps"))


def main() -> None:
    """Do everything; the power is cut at the end."""
    try:
        say("RESULT", "up_s", Path("/proc/uptime").read_text().split()[0])
        say("RESULT", "cgroup2", Path("/sys/fs/cgroup/cgroup.controllers").exists())
        udev()
        run("modprobe", "vcan")
        run("ip", "link", "add", "dev", "vcan0", "type", "vcan")
        run("ip", "link", "set", "vcan0", "up")
        threading.Thread(target=board, daemon=True).start()
        serve()
        pulled()
        clock_jumps()
        say("RESULT", "sync_max_ms", unit_state()["recorder"]["counts"]["sync_max_ms"])
        for count in range(60):
            say("NOW", repr(time.clock_gettime(time.CLOCK_MONOTONIC_RAW)))
            if count == 50:
                say("WANT", "cut")
            time.sleep(0.2)
    except BaseException:
        for line in traceback.format_exc().splitlines():
            say("FAULT", line)
        say("FAULT", json.dumps(status()))
        for line in run("journalctl", "-n", "60", "--no-pager", "-o", "cat").splitlines():
            say("FAULT", line)
        say("FAULT", "end")
    sys.exit(0)


if __name__ == "__main__":
    main()
