"""From messages to files: a bounded queue, a writer, and what the disk does to them.

What to use when: `Recorder` for a session, with `ONE_SHOT` or `SERVICE` settings;
`recover_folder` at a start, for what a crash has left; `tidy` for retention;
`DiagnosticsTimer` and `HostClockTimer` are what a session records of itself and of the
host once a second.
"""

from gyrorig_daemon.recorder.counts import RecorderCounts
from gyrorig_daemon.recorder.recorder import Recorder, RecorderState
from gyrorig_daemon.recorder.settings import ONE_SHOT, SERVICE, RecorderSettings, RecordingPlan

__all__ = [
    "ONE_SHOT",
    "SERVICE",
    "Recorder",
    "RecorderCounts",
    "RecorderSettings",
    "RecorderState",
    "RecordingPlan",
]
