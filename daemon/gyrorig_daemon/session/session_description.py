"""What a recording contains before its first message: file name, metadata, attachments."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from gyrorig_daemon.clocks.capture_clock import CaptureClock
from gyrorig_daemon.config import RigConfig, Site
from gyrorig_daemon.links.boards.board_link import BoardLink
from gyrorig_daemon.motion import RecordedMotion, UnitFacts
from gyrorig_daemon.recorder import RecordingPlan
from gyrorig_protocol.errors import MachineError
from gyrorig_protocol.program import MotionProgram
from gyrorig_protocol.recording.writer import Attachment


@dataclass(frozen=True, slots=True)
class SessionRequest:
    """What to record."""

    config: RigConfig
    config_text: bytes
    program: MotionProgram
    program_text: bytes
    out_dir: Path
    session: str
    home: bool = False  # home first, even if the unit reports that it is homed
    replay: RecordedMotion | None = None  # instead of the steps of the program
    replay_sha256: str = ""  # of the replayed recording
    limit_s: float | None = None  # that the program may last


def describe_session(
    request: SessionRequest,
    capture: CaptureClock,
    host: str,
    facts: UnitFacts | None,
    boards: Sequence[BoardLink],
    now_ns: int,
) -> RecordingPlan:
    """Return the file name, metadata and attachments of a recording.

    Args:
        request: what to record.
        capture: the session's clock.
        host: the name of this computer.
        facts: capabilities and settings of the unit, None without one.
        boards: boards that have identified themselves.
        now_ns: raw monotonic time.
    """
    config = request.config
    start_utc = datetime.fromtimestamp(capture.anchor_utc_ns * 1e-9, UTC)
    stem = f"{start_utc:%Y%m%dT%H%M%SZ}_{config.rig}_{request.session}"
    metadata: dict[str, dict[str, str]] = {
        "gyrorig": {
            "format": "1",
            "session": request.session,
            "rig": config.rig,
            "part": "0",
            "previous": "",
            "anchor_utc_ns": str(capture.anchor_utc_ns),
            "anchor_monotonic_raw_ns": str(capture.anchor_raw_ns),
            "host": host,
        },
        "foxglove": {"deviceName": config.rig},
    }
    if request.replay is not None:
        metadata["gyrorig.replay"] = {
            "recording": request.replay.name,
            "sha256": request.replay_sha256,
        }
    if facts is not None:
        metadata["gyrorig.ptu"] = facts.metadata()
    for board in boards:
        metadata[f"gyrorig.board.{board.board_id}"] = board.metadata()
    if site := _site_metadata(config.site):
        metadata["gyrorig.site"] = site
    attachments = _attachments(request, boards, capture.utc_ns(now_ns))
    return RecordingPlan(_unused_path(request.out_dir, stem), metadata, attachments)


def _unused_path(folder: Path, stem: str) -> Path:
    """Return a path that no recording in `folder` uses: the system time may have been set back."""
    existing_names = {path.name for path in folder.glob(f"{stem}*")}
    number = 1
    while True:
        suffix = "" if number == 1 else f"-{number}"
        prefixes = (f"{stem}{suffix}.", f"{stem}{suffix}_")
        if not any(name.startswith(prefixes) for name in existing_names):
            return folder / f"{stem}{suffix}.mcap"
        number += 1


def _site_metadata(site: Site) -> dict[str, str]:
    values = {key: getattr(site, key) for key in site.__struct_fields__}
    return {key: repr(value) for key, value in values.items() if value is not None}


def _attachments(
    request: SessionRequest, boards: Sequence[BoardLink], now_utc_ns: int
) -> tuple[Attachment, ...]:
    attachments = [
        Attachment("rig.yaml", "application/yaml", request.config_text, now_utc_ns),
    ]
    if request.program_text:  # a replayed recording can have none
        attachments.append(
            Attachment("program.yaml", "application/yaml", request.program_text, now_utc_ns)
        )
    for config in request.config.boards:
        if config.signals is not None and config.signals.dbc is not None:
            text = config.signals.dbc.encode()
            attachments.append(
                Attachment(f"signals.{config.id}.dbc", "text/plain", text, now_utc_ns)
            )
    for board in boards:
        attachments += hello_attachments(board, now_utc_ns)
    return tuple(attachments)


def hello_attachments(board: BoardLink, now_utc_ns: int) -> tuple[Attachment, ...]:
    """Return the HELLO payloads of a board as received."""
    name = f"hello.{board.board_id}"
    return tuple(
        # without the byte of the frame type
        Attachment(f"{name}.{number}.json", "application/json", payload[1:], now_utc_ns)
        for number, payload in enumerate(board.hello_bytes)
    )


def check_folder(folder: Path) -> None:
    """Check that a recording can be made in `folder`, without creating it.

    Raises:
        MachineError: the folder, or its nearest existing parent, is not writable.
    """
    existing_folder = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if not existing_folder.is_dir():
        raise MachineError(
            f"recordings cannot be written to {existing_folder}, because it is not a folder",
            "choose another folder with --out",
        )
    if not os.access(existing_folder, os.W_OK | os.X_OK):
        raise MachineError(
            f"recordings cannot be written to the folder {existing_folder}, because it is not "
            "writable",
            "choose another folder with --out",
        )


def make_folder(folder: Path) -> None:
    """Create `folder` if it does not exist.

    Raises:
        MachineError: it cannot be created.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as fault:
        raise MachineError(
            f"the folder {folder} for recordings cannot be created ({fault.strerror})",
            "choose another folder with --out",
        ) from fault
