"""Checks of a running service: its state, the devices that it uses, its losses.

What to use when: `check_daemon` first. A running service uses the ports of the devices, so that
its status replaces their checks.
"""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gyrorig_daemon.doctor.finding import Finding, fault, note, ok, warning
from gyrorig_daemon.service.service_client import RefusedRequestError, send_command
from gyrorig_protocol.errors import MachineError

SUBJECT = "daemon"
HEALTHY_STATES = ("known",)
LOSS_COUNTERS = ("missing", "foreign", "unidentified")


@dataclass(frozen=True, slots=True)
class DaemonReport:
    """What a running service contributes to the forecast."""

    samples_hz: float
    motion_is_locked: bool
    steps_are_sure: bool


def check_daemon(socket_path: Path) -> tuple[list[Finding], DaemonReport | None]:
    """Return the findings about a running service; None if none is running."""
    try:
        status = send_command(socket_path, "status")["status"]
    except (MachineError, RefusedRequestError) as error:
        with contextlib.suppress(PermissionError):
            if socket_path.exists():
                return [note(SUBJECT, "no_answer", error.problem, error.remedy)], None
        return [], None
    findings = [
        _check_state(status),
        *_check_unit(status),
        *_check_recorder(status),
        *_check_last_session(status),
        *(finding for board in status["boards"] for finding in _check_board(board)),
    ]
    rate_hz = sum((board.get("rate_hz") or 0.0 for board in status["boards"]), 0.0)
    is_locked = status["state"] == "fault"
    return findings, DaemonReport(rate_hz, is_locked, status["unit"]["steps_are_sure"])


def _check_state(status: dict[str, Any]) -> Finding:
    state, reason = status["state"], status["reason"].partition(". Check")[0]
    if state == "fault":
        remedy = "check the rig, then run `gyrorigd clear` to release the lock"
        return fault(
            SUBJECT, "held", f"the daemon has locked all motion of the rig ({reason})", remedy
        )
    if state == "waiting":
        message = f"the daemon cannot start a session because of this problem: {reason}"
        remedy = "solve the problem. The daemon then starts the sessions itself"
        return warning(SUBJECT, "waiting", message, remedy)
    hours = status["uptime_s"] / 3600.0
    message = (
        f"the daemon (process {status['pid']}) has run for {hours:.1f} h, and its state is {state}"
    )
    return ok(SUBJECT, "running", message)


def _check_unit(status: dict[str, Any]) -> Iterator[Finding]:
    unit = status["unit"]
    message = f"the daemon reports this state of the pan-tilt unit: {unit['text']}"
    if unit["state"] == "absent":
        yield fault(
            "unit",
            "absent",
            message,
            "check the cable of the pan-tilt unit. The daemon waits for the unit",
        )
    elif unit["state"] == "silent":
        remedy = (
            "check the power, the cable and the baud rate of the pan-tilt unit. The daemon "
            "tries to connect until the unit answers"
        )
        yield fault("unit", "silent", message, remedy)
    else:
        yield ok("unit", "seen", f"{unit['text']} ({unit['port']})")
        if not unit["steps_are_sure"]:
            message = (
                "the pan-tilt unit may have lost steps, so the daemon rejects sessions without "
                "--home"
            )
            remedy = (
                "remove all objects from the unit's range of motion, then run `gyrorigd enqueue "
                "--home --program PROGRAM.yaml`"
            )
            yield warning("unit", "lost_steps", message, remedy)


def _check_board(board: dict[str, Any]) -> Iterator[Finding]:
    subject, counts = f"board {board['id']}", board["counts"]
    if board["state"] not in HEALTHY_STATES:
        message = f"the daemon reports the state {board['state']} of the board"
        yield fault(
            subject,
            "not_heard",
            message,
            "check the power, the cable and the firmware of the board",
        )
        return
    rate_hz = board.get("rate_hz") or 0.0
    message = (
        f"the board sends {rate_hz:.0f} samples per second, and has sent "
        f"{counts.get('samples', 0)} samples so far"
    )
    yield ok(subject, "seen", message)
    losses = {name: counts.get(name, 0) for name in LOSS_COUNTERS} | board.get("faults", {})
    text = ", ".join(f"{name.replace('_', ' ')} {count}" for name, count in losses.items() if count)
    if text:
        remedy = (
            "if a number increases, check the cable and the ground connection, or use a lower "
            "baud rate"
        )
        message = (
            f"the daemon counted these faults in the data of the board since its start: {text}"
        )
        yield note(subject, "losses", message, remedy)


def _check_recorder(status: dict[str, Any]) -> Iterator[Finding]:
    degraded = status["recorder"].get("degraded")
    if degraded:
        message = (
            f"the daemon cannot write to the disk ({degraded}). It keeps new data in memory, and "
            "this memory will soon be full"
        )
        remedy = (
            "free space on the disk. If the disk has free space, run `dmesg` to find the fault of "
            "the disk"
        )
        yield fault("disk", "degraded", message, remedy)


def _check_last_session(status: dict[str, Any]) -> Iterator[Finding]:
    last = status["last_session"]
    if last is not None and last["result"] != "done":
        message = (
            f"the last session, {last['session']}, ended with the result {last['result']} "
            f"({last['reason']})"
        )
        remedy = (
            "see the folder queue/failed in the daemon's state folder for the results of other "
            "sessions"
        )
        yield note(SUBJECT, "last_session", message, remedy)
