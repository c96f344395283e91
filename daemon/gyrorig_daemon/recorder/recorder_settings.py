"""Settings of a recorder: how a recording starts, is split, and survives disk faults.

What to use when: `ONE_SHOT` for a person who wants one file, and an error at once when the disk
fails; `SIMULATED` for the same in simulated time; `SERVICE` for an unattended rig.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from gyrorig_protocol.recording.writer import Attachment

MIB = 1 << 20


@dataclass(frozen=True, slots=True)
class RecordingPlan:
    """What a recording starts with; `path` is the path of its first part."""

    path: Path
    metadata: Mapping[str, Mapping[str, str]]
    attachments: Sequence[Attachment]


@dataclass(frozen=True, slots=True)
class RecorderSettings:
    """How a recording is split into parts, and what happens when the disk fails."""

    part_s: float | None = None  # start a new part after this time; None: never
    part_bytes: int | None = None  # or at this size
    reserve_bytes: int = 0  # stop before less than this is free on the disk
    sync_s: float = 1.0  # a power cut loses at most about this much
    ram_bytes: int = 64 * MIB  # of memory while the disk fails
    ram_s: float = 300.0
    survives_faults: bool = False  # continue in memory when the disk fails, and resume; else raise

    @property
    def resume_bytes(self) -> int:
        """Free space at which recording resumes: more than the reserve, as hysteresis."""
        return self.reserve_bytes + self.reserve_bytes // 8


ONE_SHOT = RecorderSettings()
# Ten seconds pass at once there, and no power cut is simulated.
SIMULATED = RecorderSettings(sync_s=10.0)
# Parts of an hour or 512 MiB; 1 GB stays free, like `rosbag record --min-space` of ROS 1.
SERVICE = RecorderSettings(
    part_s=3600.0, part_bytes=512 * MIB, reserve_bytes=1024 * MIB, survives_faults=True
)
