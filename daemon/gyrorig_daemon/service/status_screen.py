"""Text display of the status: one screen for a person."""

from typing import Any

from gyrorig_daemon.session.line_writer import escape_controls

_PROGRESS_BAR_WIDTH = 24
BOARD_LOSSES = ("sensor_overruns", "frames_dropped", "bus_errors")
BUS_LOSSES = ("lost_in_kernel", "rx_overflow", "bus_off")
LOST_MESSAGES = (
    "dropped_queue_full",
    "dropped_too_early",
    "dropped_from_memory",
    "dropped_at_close",
    "dropped_unsynced",
    "refused",
)


def render_status(status: dict[str, Any]) -> str:
    """Return the status as text."""
    lines = [
        f"rig {status['rig']}: {status['state']}"
        + (f": {status['reason']}" if status["reason"] else ""),
        f"  {status['utc']}, up {_format_duration(status['uptime_s'])}, {status['software']}, "
        f"process {status['pid']}",
        _unit_line(status["unit"], is_moving=status["state"] == "running"),
    ]
    lines += [_board_line(board) for board in status["boards"]]
    if status["session"] is not None:
        lines.append(_session_lines(status["session"], status["recorder"]))
    experiment = status.get("experiment")  # older services have none
    if experiment is not None:
        lines.append(_experiment_line(experiment))
    if status["last_session"] is not None:
        last_session = status["last_session"]
        reason = f": {last_session['reason']}" if last_session["reason"] else ""
        lines.append(f"last session  {last_session['session']} {last_session['result']}{reason}")
    queue = status["queue"]
    if queue["waiting"]:
        lines.append(f"queue  {queue['waiting']} waiting, next {queue['next'][0]}")
    else:
        lines.append("queue  empty")
    lines += [
        f"schedule  {entry['name']} in {_format_duration(entry['due_in_s'])}"
        for entry in status["schedule"]
    ]
    lines.append(_computer_line(status))
    losses_by_cause = count_losses(status)
    lines.append(
        "lost  " + (", ".join(f"{name} {n}" for name, n in losses_by_cause.items()) or "nothing")
    )
    # Members of the group choose the file names of jobs.
    return "\n".join(escape_controls(line) for line in "\n".join(lines).split("\n"))


def count_losses(status: dict[str, Any]) -> dict[str, int]:
    """Return all losses by cause, without those that are zero."""
    losses_by_cause: dict[str, int] = {}
    for board in status["boards"]:
        name, counts = board["id"], board["counts"]
        losses_by_cause[f"{name} missing samples"] = counts.get("missing", 0)
        for cause, count in board["faults"].items():
            losses_by_cause[f"{name} frames: {cause.replace('_', ' ')}"] = count
        for cause in BOARD_LOSSES:
            losses_by_cause[f"{name} reports: {cause.replace('_', ' ')}"] = board["own"].get(
                cause, 0
            )
        for cause in BUS_LOSSES:
            losses_by_cause[f"{name}'s bus: {cause.replace('_', ' ')}"] = board["bus"].get(cause, 0)
    for cause in ("timeouts", "garbled", "frame_errors"):
        losses_by_cause[f"replies of the unit: {cause.replace('_', ' ')}"] = status["unit"][
            "counts"
        ][cause]
    losses_by_cause["bytes dropped by the acquisition process"] = status[
        "acquisition_dropped_bytes"
    ]
    for cause in LOST_MESSAGES:
        losses_by_cause[f"messages {cause.replace('_', ' ')}"] = status["recorder"]["counts"].get(
            cause, 0
        )
    # older services do not count them
    losses_by_cause["state files not written"] = status["counts"].get("state_write_failures", 0)
    return {name: count for name, count in losses_by_cause.items() if count}


def _unit_line(unit: dict[str, Any], is_moving: bool) -> str:
    step_note = "" if unit["steps_are_sure"] else "; it may have lost steps: home it"
    position = ""
    if unit["pan_deg"] is not None:
        position = f", pan {unit['pan_deg']:+.2f}, tilt {unit['tilt_deg']:+.2f} deg"
    poll_wait_ms = unit.get("poll_wait_max_ms")  # older services do not report it
    poll_wait = f", position reply within {poll_wait_ms:.1f} ms" if poll_wait_ms else ""
    # a session controls the unit, so that the monitor does not know whether it stands
    text = "controlled by the session" if is_moving else unit["text"]
    return f"unit  {text} ({unit['port']}){position}{poll_wait}{step_note}"


def _board_line(board: dict[str, Any]) -> str:
    counts = board["counts"]
    rate = "" if board["rate_hz"] is None else f", {board['rate_hz']:.0f} samples/s"
    clock = board["clock"]
    clock_text = ", clock not mapped"
    if clock["mapped"] and clock["skew_ppm"] is not None:
        clock_text = f", clock {clock['skew_ppm']:+.1f} ppm"
        if clock["sigma_s"] is not None:
            clock_text += f" ± {clock['sigma_s'] * 1e6:.0f} us"
    if board["latency_ms"] is not None:
        rate += f", latency {board['latency_ms']:.2f} ms, {board['latency_max_ms']:.2f} ms at most"
    return f"board {board['id']}  {board['text']}{rate}, {counts['samples']} samples{clock_text}"


def _session_lines(session: dict[str, Any], recorder: dict[str, Any]) -> str:
    step, steps = session.get("step", 0), session.get("steps", 0)
    filled = round(_PROGRESS_BAR_WIDTH * step / steps) if steps else 0
    bar = "#" * filled + "." * (_PROGRESS_BAR_WIDTH - filled)
    path = recorder["path"]
    recording_text = "" if path is None else f"\n  {path}"
    if recorder["degraded"]:
        recording_text += f"\n  NOT ON DISK: {recorder['degraded']}"
    if not steps:
        return f"session {session['session']}  identifying the unit and the boards{recording_text}"
    remaining = f", {_format_duration(session['left_s'])} left" if "left_s" in session else ""
    return (
        f"session {session['session']}  [{bar}] step {step} of {steps}{remaining}{recording_text}"
    )


def _experiment_line(experiment: dict[str, Any]) -> str:
    sets = [" or ".join((c["cause"], *c["one_of"])) for c in experiment["causes"]]
    stated = f": {', '.join(sets)}" if sets else ""
    return (
        f"experiment  {experiment['step']}, session {experiment['round']} of at most "
        f"{experiment['rounds']}, {_format_duration(experiment['used_s'])} of "
        f"{_format_duration(experiment['limit_s'])}{stated}"
    )


def _computer_line(status: dict[str, Any]) -> str:
    free, clock = status["disk"]["free_bytes"], status["clock"]
    free_text = "free space unknown" if free is None else f"{free / 1e9:.1f} GB free"
    if clock["synchronised"] is None:
        return f"computer  {free_text}"
    synchronised = "synchronised" if clock["synchronised"] else "not synchronised"
    return f"computer  {free_text}, system time {synchronised}"


def _format_duration(seconds: float) -> str:
    minutes, remaining_s = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    days, hours = divmod(hours, 24)
    if days:
        return f"{days} d {hours} h"
    if hours:
        return f"{hours} h {minutes} min"
    return f"{minutes} min {remaining_s} s" if minutes else f"{remaining_s} s"
