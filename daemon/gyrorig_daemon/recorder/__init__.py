"""Recording: from messages to files, in spite of slow, full and failing disks.

What to use when: `Recorder` for a session, with the settings `ONE_SHOT` or `SERVICE`;
`recovery.recover_folder` at start-up, for files that a crash has left;
`retention.apply_retention` to delete old recordings; `session_timers` for what a session
records once per second about itself and the host.
"""

from gyrorig_daemon.recorder.recorder import Recorder, RecorderState
from gyrorig_daemon.recorder.recorder_counts import RecorderCounts
from gyrorig_daemon.recorder.recorder_settings import (
    ONE_SHOT,
    SERVICE,
    RecorderSettings,
    RecordingPlan,
)

__all__ = [
    "ONE_SHOT",
    "SERVICE",
    "Recorder",
    "RecorderCounts",
    "RecorderSettings",
    "RecorderState",
    "RecordingPlan",
]
