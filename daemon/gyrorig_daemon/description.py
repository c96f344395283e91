"""What a recording says of its session before the first message: name, metadata, files."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from gyrorig_daemon.config import RigConfig, Site
from gyrorig_daemon.links.board_link import BoardLink
from gyrorig_daemon.links.capture_clock import CaptureClock
from gyrorig_daemon.motion import UnitFacts
from gyrorig_daemon.recorder import RecordingPlan
from gyrorig_protocol.errors import MachineError
from gyrorig_protocol.program import MotionProgram
from gyrorig_protocol.recording.writer import Attachment


@dataclass(frozen=True, slots=True)
class SessionOrder:
    """What shall be recorded."""

    config: RigConfig
    config_text: bytes
    program: MotionProgram
    program_text: bytes
    out_dir: Path
    session: str
    home: bool = False  # sweep both axes first, also where the unit says it knows its zero


def describe_session(
    order: SessionOrder,
    capture: CaptureClock,
    host: str,
    facts: UnitFacts,
    boards: Sequence[BoardLink],
    now_ns: int,
) -> RecordingPlan:
    """Return what the recording begins with.

    Args:
        order: what was asked for.
        capture: the session's clock.
        host: this computer's name.
        facts: what the unit said of itself.
        boards: those that have said who they are.
        now_ns: raw monotonic time.
    """
    config = order.config
    begun = datetime.fromtimestamp(capture.anchor_utc_ns * 1e-9, UTC)
    stem = f"{begun:%Y%m%dT%H%M%SZ}_{config.rig}_{order.session}"
    metadata: dict[str, dict[str, str]] = {
        "gyrorig": {
            "format": "1",
            "session": order.session,
            "rig": config.rig,
            "part": "0",
            "previous": "",
            "anchor_utc_ns": str(capture.anchor_utc_ns),
            "anchor_monotonic_raw_ns": str(capture.anchor_raw_ns),
            "host": host,
        },
        "gyrorig.ptu": facts.metadata(),
        "foxglove": {"deviceName": config.rig},
    }
    for board in boards:
        metadata[f"gyrorig.board.{board.board_id}"] = board.metadata()
    if site := _site(config.site):
        metadata["gyrorig.site"] = site
    files = _files(order, boards, capture.utc_ns(now_ns))
    return RecordingPlan(_free_name(order.out_dir, stem), metadata, files)


def _free_name(folder: Path, stem: str) -> Path:
    """Return a name that no recording in `folder` has: a wall clock may be set back."""
    there = {path.name for path in folder.glob(f"{stem}*")}
    number = 1
    while True:
        tail = "" if number == 1 else f"-{number}"
        own = (f"{stem}{tail}.", f"{stem}{tail}_")
        if not any(name.startswith(own) for name in there):
            return folder / f"{stem}{tail}.mcap"
        number += 1


def _site(site: Site) -> dict[str, str]:
    known = {key: getattr(site, key) for key in site.__struct_fields__}
    return {key: repr(value) for key, value in known.items() if value is not None}


def _files(
    order: SessionOrder, boards: Sequence[BoardLink], now_utc_ns: int
) -> tuple[Attachment, ...]:
    files = [
        Attachment("rig.yaml", "application/yaml", order.config_text, now_utc_ns),
        Attachment("program.yaml", "application/yaml", order.program_text, now_utc_ns),
    ]
    for config in order.config.boards:
        if config.signals is not None and config.signals.dbc is not None:
            text = config.signals.dbc.encode()
            files.append(Attachment(f"signals.{config.id}.dbc", "text/plain", text, now_utc_ns))
    for board in boards:
        files += hello_files(board, now_utc_ns)
    return tuple(files)


def hello_files(board: BoardLink, now_utc_ns: int) -> tuple[Attachment, ...]:
    """Return what a board said of itself, as received."""
    name = f"hello.{board.board_id}"
    return tuple(
        # behind the frame's type
        Attachment(f"{name}.{number}.json", "application/json", payload[1:], now_utc_ns)
        for number, payload in enumerate(board.hello_bytes)
    )


def check_folder(folder: Path) -> None:
    """Make sure that a recording can be made in `folder`, and make nothing yet.

    Raises:
        MachineError: it, or the nearest folder above it that exists, takes no files.
    """
    there = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if not there.is_dir():
        raise MachineError(f"{there} is no folder", "name another folder with --out")
    if not os.access(there, os.W_OK | os.X_OK):
        raise MachineError(f"{there} may not be written to", "name another folder with --out")


def make_folder(folder: Path) -> None:
    """Make sure that recordings can go to `folder`.

    Raises:
        MachineError: it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as fault:
        raise MachineError(
            f"{folder} cannot be made: {fault.strerror}", "name another folder with --out"
        ) from fault
