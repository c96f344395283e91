"""A daemon that runs: what it says of the rig, which nobody else may ask meanwhile.

What to use when: `examine_daemon` first; with a daemon at work the devices' ports are its
own, and its word stands for theirs.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gyrorig_daemon.doctor.finding import Finding, fault, note, ok, warning
from gyrorig_daemon.service.client import RefusedRequestError, ask
from gyrorig_protocol.errors import MachineError

SUBJECT = "daemon"
WELL = ("known",)
LOSSES = ("missing", "foreign", "unidentified")


@dataclass(frozen=True, slots=True)
class Running:
    """What a daemon at work knows that matters for the night."""

    samples_hz: float
    is_held: bool  # nothing moves until somebody has looked
    steps_are_sure: bool


def examine_daemon(socket_path: Path) -> tuple[list[Finding], Running | None]:
    """Return what a running daemon says, and what follows; None where none runs."""
    try:
        status = ask(socket_path, "status")["status"]
    except PermissionError:
        return [], None
    except (MachineError, RefusedRequestError) as silence:
        if not socket_path.exists():
            return [], None
        return [note(SUBJECT, "no_answer", silence.what, silence.remedy)], None
    found = [_state(status), *_unit(status), *_recorder(status), *_last(status)]
    rate_hz = 0.0
    for board in status["boards"]:
        found += _board(board)
        rate_hz += board.get("rate_hz") or 0.0
    running = Running(rate_hz, status["state"] == "fault", status["unit"]["steps_are_sure"])
    return found, running


def _state(status: dict[str, Any]) -> Finding:
    state, reason = status["state"], status["reason"]
    if state == "fault":
        remedy = "look at the rig, then: gyrorigd clear"
        return fault(SUBJECT, "held", f"nothing moves: {reason}", remedy)
    if state == "waiting":
        remedy = "mend what it names; sessions begin by themselves then"
        return warning(SUBJECT, "waiting", f"no session begins: {reason}", remedy)
    hours = status["uptime_s"] / 3600.0
    return ok(SUBJECT, "running", f"it runs, {state}, for {hours:.1f} h, process {status['pid']}")


def _unit(status: dict[str, Any]) -> list[Finding]:
    unit = status["unit"]
    if unit["state"] == "absent":
        return [fault("unit", "absent", unit["text"], "check its cable; the daemon waits for it")]
    if unit["state"] == "silent":
        remedy = "check its power, the cable and the baud rate; the daemon goes on asking"
        return [fault("unit", "silent", unit["text"], remedy)]
    found = [ok("unit", "seen", f"{unit['text']} ({unit['port']})")]
    if not unit["steps_are_sure"]:
        what = "it may have lost steps: sessions without --home are refused"
        remedy = "clear the rig, then: gyrorigd enqueue --home --program PROGRAM.yaml"
        found.append(warning("unit", "lost_steps", what, remedy))
    return found


def _board(board: dict[str, Any]) -> list[Finding]:
    subject, counts = f"board {board['id']}", board["counts"]
    if board["state"] not in WELL:
        what = f"the daemon sees it as {board['state']}"
        return [fault(subject, "not_heard", what, "check its power, the cable and its firmware")]
    rate_hz = board.get("rate_hz") or 0.0
    found = [
        ok(subject, "seen", f"{rate_hz:.0f} samples a second, {counts.get('samples', 0)} so far")
    ]
    lost = {name: counts.get(name, 0) for name in LOSSES} | board.get("faults", {})
    told = ", ".join(f"{name.replace('_', ' ')} {count}" for name, count in lost.items() if count)
    if told:
        what = f"since the daemon's start: {told}"
        remedy = "if it grows, check cable and ground, or lower the baud rate"
        found.append(note(subject, "losses", what, remedy))
    return found


def _recorder(status: dict[str, Any]) -> list[Finding]:
    degraded = status["recorder"].get("degraded")
    if not degraded:
        return []
    return [
        fault(
            "disk",
            "degraded",
            f"recording goes on in memory, which is soon full: {degraded}",
            "make room on the disk; where there is room, dmesg says what is wrong with it",
        )
    ]


def _last(status: dict[str, Any]) -> list[Finding]:
    last = status["last_session"]
    if last is None or last["result"] == "done":
        return []
    what = f"the last session, {last['session']}, {last['result']}: {last['reason']}"
    remedy = "earlier ones: queue/failed in the daemon's state folder, a .result.json for each"
    return [note(SUBJECT, "last_session", what, remedy)]
