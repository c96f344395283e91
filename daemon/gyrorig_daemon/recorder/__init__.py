"""From messages to a file: a bounded queue and one writer, in a thread or without.

What to use when: `Recorder` for a session; `DiagnosticsTimer` and `HostClockTimer` are
what it records of itself and of the host once a second.
"""

from gyrorig_daemon.recorder.recorder import Recorder, RecordingPlan

__all__ = ["Recorder", "RecordingPlan"]
