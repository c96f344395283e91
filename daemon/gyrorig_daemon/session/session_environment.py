"""The environment of a session: clocks, signals and reports of its progress.

What to use when: `SessionEnvironment` for `record_session` and `Session`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from gyrorig_daemon.clocks.capture_clock import CaptureClock, HostClocks
from gyrorig_daemon.links.pump import StopFlag
from gyrorig_daemon.recorder import Recorder
from gyrorig_protocol.identity import BoardId

Progress = Callable[[int, int], None]  # steps done, all steps
EventListener = Callable[[str, str], None]  # kind, text

CLOSE_TIMEOUT_S = 60.0


@dataclass(frozen=True, slots=True)
class SessionSummary:
    """What was recorded."""

    path: Path
    duration_s: float
    samples: Mapping[BoardId, int]


def ignore_progress(_step: int, _total: int) -> None:
    """Show no progress."""


def ignore_event(_kind: str, _text: str) -> None:
    """Show no events."""


def ignore_line(_line: str) -> None:
    """Say nothing."""


def ignore_summary(_summary: SessionSummary) -> None:
    """Show no summary."""


@dataclass(frozen=True, slots=True)
class SessionEnvironment:
    """What differs between real and simulated time, and between a command and the service."""

    capture: CaptureClock
    read_host: Callable[[], HostClocks]
    threaded_writer: bool
    host: str
    seed: int = 0  # of the random moments at which time is requested from the boards
    program_begin_ns: int | None = None  # a replay begins then, by the clock of the ports
    paths: dict[str, str] = field(default_factory=dict)  # of ports that are not as configured
    dropped_bytes: Callable[[], int] = lambda: 0
    stop: StopFlag = field(default_factory=StopFlag)
    progress: Progress = ignore_progress
    on_event: EventListener = ignore_event
    on_summary: Callable[[SessionSummary], None] = ignore_summary
    say: Callable[[str], None] = ignore_line  # to a person who turns the boards
    new_recorder: Callable[[], Recorder] | None = None  # None: one file, a disk error ends it
    close_timeout_s: float = CLOSE_TIMEOUT_S
