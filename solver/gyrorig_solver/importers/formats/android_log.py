"""Logs of a phone, in the layouts of the common Android loggers."""

import re
from dataclasses import dataclass
from pathlib import Path

from gyrorig_solver.importers.import_times import seconds_since
from gyrorig_solver.importers.measured_streams import (
    AccelStream,
    GyroStream,
    MeasuredBoard,
    MeasuredStreams,
)
from gyrorig_solver.importers.measurement_format import (
    BOARD_OPTIONS,
    FormatMatch,
    ImportOptions,
    read_head,
)
from gyrorig_solver.importers.phone_log import has_sensor_tags, read_phone_log

# A header that names the unit of the rates, or Sensor Logger's columns.
_RATE_HEADER = re.compile(r"rad/s\b|\bseconds_elapsed,z,y,x\b")


@dataclass(frozen=True, slots=True)
class AndroidLog:
    """One file of a phone's log."""

    name: str = "android"
    title: str = "log of a phone"
    extra: str = ""
    used_options: frozenset[str] = BOARD_OPTIONS

    def detect(self, source: Path) -> FormatMatch | None:
        """Return a match for lines with sensor tags, or a header that gives the unit rad/s."""
        head = read_head(source)
        if not head or b"\0" in head:
            return None
        text = head.decode("utf-8", errors="replace")
        is_table = _RATE_HEADER.search(text.partition("\n")[0]) is not None
        if not is_table and not has_sensor_tags(text.splitlines()):
            return None
        return FormatMatch("a log of a phone")

    def read(self, source: Path, options: ImportOptions) -> MeasuredStreams:
        """Return the rates, and the accelerations if the log has them."""
        log = read_phone_log(source)
        stamps = (log.stamp_ns, log.accel_stamp_ns)
        first_ns = min(int(stamp_ns[0]) for stamp_ns in stamps if stamp_ns is not None)
        accel = None
        if log.accel_m_s2 is not None and log.accel_stamp_ns is not None:
            accel = AccelStream(log.accel_m_s2, seconds_since(log.accel_stamp_ns, first_ns))
        board = MeasuredBoard(
            options.board or "PHONE",
            GyroStream(seconds_since(log.stamp_ns, first_ns), log.rate_rad_s),
            accel,
            metadata={"sensor": options.sensor or "android"},
        )
        source_text = f"imported from {source.name}: {log.layout}"
        # the stamps are no time of day: the recording's time starts at 0
        return MeasuredStreams(source_text, (board,), notes=log.notes)


FORMAT = AndroidLog()
