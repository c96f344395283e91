"""The status as a person reads it: one screen of plain text."""

from typing import Any

_BAR = 24
OWN_LOSSES = ("sensor_overruns", "frames_dropped", "bus_errors")
BUS_LOSSES = ("lost_in_kernel", "rx_overflow", "bus_off")
LOST_MESSAGES = (
    "dropped_queue_full",
    "dropped_too_early",
    "dropped_from_memory",
    "dropped_at_close",
    "refused",
)


def picture(status: dict[str, Any]) -> str:
    """Return the status as lines of text."""
    lines = [
        f"rig {status['rig']}: {status['state']}"
        + (f": {status['reason']}" if status["reason"] else ""),
        f"  {status['utc']}, up {_span(status['uptime_s'])}, {status['software']}, "
        f"process {status['pid']}",
        _unit(status["unit"], moves=status["state"] == "running"),
    ]
    lines += [_board(board) for board in status["boards"]]
    if status["session"] is not None:
        lines.append(_session(status["session"], status["recorder"]))
    if status["last_session"] is not None:
        last = status["last_session"]
        why = f": {last['reason']}" if last["reason"] else ""
        lines.append(f"last session  {last['session']} {last['result']}{why}")
    queue = status["queue"]
    if queue["waiting"]:
        lines.append(f"queue  {queue['waiting']} waiting, next {queue['next'][0]}")
    else:
        lines.append("queue  empty")
    lines += [
        f"schedule  {entry['name']} in {_span(entry['due_in_s'])}" for entry in status["schedule"]
    ]
    lines.append(_machine(status))
    lost = losses(status)
    lines.append("lost  " + (", ".join(f"{name} {n}" for name, n in lost.items()) or "nothing"))
    return "\n".join(lines)


def losses(status: dict[str, Any]) -> dict[str, int]:
    """Return every loss by its cause, those that are none left out."""
    found: dict[str, int] = {}
    for board in status["boards"]:
        name, counts = board["id"], board["counts"]
        found[f"{name} missing samples"] = counts.get("missing", 0)
        for cause, count in board["faults"].items():
            found[f"{name} frames: {cause.replace('_', ' ')}"] = count
        for cause in OWN_LOSSES:
            found[f"{name} by its own word: {cause.replace('_', ' ')}"] = board["own"].get(cause, 0)
        for cause in BUS_LOSSES:
            found[f"{name}'s bus: {cause.replace('_', ' ')}"] = board["bus"].get(cause, 0)
    for cause in ("timeouts", "garbled", "frame_errors"):
        found[f"unit's answers: {cause.replace('_', ' ')}"] = status["unit"]["counts"][cause]
    found["bytes dropped by a slow daemon"] = status["acquisition_dropped_bytes"]
    for cause in LOST_MESSAGES:
        found[f"messages {cause.replace('_', ' ')}"] = status["recorder"]["counts"].get(cause, 0)
    return {name: count for name, count in found.items() if count}


def _unit(unit: dict[str, Any], moves: bool) -> str:
    sure = "" if unit["steps_are_sure"] else "; it may have lost steps, home it"
    where = ""
    if unit["pan_deg"] is not None:
        where = f", pan {unit['pan_deg']:+.2f}, tilt {unit['tilt_deg']:+.2f} deg"
    wait = unit.get("poll_wait_max_ms")  # an older daemon does not tell it
    waited = f", says where within {wait:.1f} ms" if wait else ""
    # whether it stands is not asked while a session gives it orders
    text = "under the session's orders" if moves else unit["text"]
    return f"unit  {text} ({unit['port']}){where}{waited}{sure}"


def _board(board: dict[str, Any]) -> str:
    counts = board["counts"]
    rate = "" if board["rate_hz"] is None else f", {board['rate_hz']:.0f} samples/s"
    clock = board["clock"]
    mapped = ", clock not mapped yet"
    if clock["mapped"] and clock["skew_ppm"] is not None:
        mapped = f", clock {clock['skew_ppm']:+.1f} ppm"
        if clock["sigma_s"] is not None:
            mapped += f" ± {clock['sigma_s'] * 1e6:.0f} us"
    if board["latency_ms"] is not None:
        rate += f", {board['latency_ms']:.2f} ms late, {board['latency_max_ms']:.2f} at most"
    return f"board {board['id']}  {board['text']}{rate}, {counts['samples']} samples{mapped}"


def _session(session: dict[str, Any], recorder: dict[str, Any]) -> str:
    step, steps = session.get("step", 0), session.get("steps", 0)
    done = round(_BAR * step / steps) if steps else 0
    bar = "#" * done + "." * (_BAR - done)
    path = recorder["path"]
    written = "" if path is None else f"\n  {path}"
    if recorder["degraded"]:
        written += f"\n  NOT ON DISK: {recorder['degraded']}"
    if not steps:
        return f"session {session['session']}  getting to know unit and boards{written}"
    left = f", {_span(session['left_s'])} left" if "left_s" in session else ""
    return f"session {session['session']}  [{bar}] step {step} of {steps}{left}{written}"


def _machine(status: dict[str, Any]) -> str:
    free, clock = status["disk"]["free_bytes"], status["clock"]
    room = "room unknown" if free is None else f"{free / 1e9:.1f} GB free"
    if clock["synchronised"] is None:
        return f"computer  {room}"
    synchronised = "synchronised" if clock["synchronised"] else "not synchronised"
    return f"computer  {room}, wall clock {synchronised}"


def _span(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    days, hours = divmod(hours, 24)
    if days:
        return f"{days} d {hours} h"
    if hours:
        return f"{hours} h {minutes} min"
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"
