"""What a recording begins with, and how it is kept.

What to use when: `ONE_SHOT` for a person at a desk, who wants one file and to be told at
once when the disk fails; `SIMULATED` for the same under simulated time; `SERVICE` for a
rig that nobody watches.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from gyrorig_protocol.recording.writer import Attachment

MIB = 1 << 20


@dataclass(frozen=True, slots=True)
class RecordingPlan:
    """What a recording begins with; `path` is the name of its first part."""

    path: Path
    metadata: Mapping[str, Mapping[str, str]]
    attachments: Sequence[Attachment]


@dataclass(frozen=True, slots=True)
class RecorderSettings:
    """How a recording is cut into parts, and what happens when the disk does not take it."""

    part_s: float | None = None  # begin a new part after this time; None: never
    part_bytes: int | None = None  # or at this size
    reserve_bytes: int = 0  # stop before less than this is free on the disk
    sync_s: float = 1.0  # a power cut costs this much (reference: reliability.md section 3)
    ring_bytes: int = 64 * MIB  # of memory for what the disk does not take
    ring_s: float = 300.0
    survive: bool = False  # go on in memory when the disk fails, and resume; else raise

    @property
    def resume_bytes(self) -> int:
        """What must be free again before recording resumes: no flutter at the edge."""
        return self.reserve_bytes + self.reserve_bytes // 8


ONE_SHOT = RecorderSettings()
# Ten seconds pass in a moment there, and no power cut is simulated.
SIMULATED = RecorderSettings(sync_s=10.0)
# An hour or 512 MiB a part, a floor of 1 GB (reference: recording-facts.md section 6).
SERVICE = RecorderSettings(
    part_s=3600.0, part_bytes=512 * MIB, reserve_bytes=1024 * MIB, survive=True
)
