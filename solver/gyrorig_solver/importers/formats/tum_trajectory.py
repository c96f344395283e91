"""Trajectories in the format of the TUM RGB-D benchmark: a reference without a gyro.

Each line is `time tx ty tz qx qy qz qw`, with the time in seconds; lines with # are comments
(J. Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.importers.import_times import nanoseconds
from gyrorig_solver.importers.map_keys import TableLayout
from gyrorig_solver.importers.measured_streams import MeasuredStreams
from gyrorig_solver.importers.measurement_columns import open_columns
from gyrorig_solver.importers.measurement_format import FormatMatch, ImportOptions, read_head
from gyrorig_solver.importers.trajectory_rows import pose_stream

LAYOUT = TableLayout(header_rows=0, comment="#", delimiter="space")
TIME, ORIENTATION = 1, [5, 6, 7, 8]  # columns by number
MAX_STAMP_S = 4e9


@dataclass(frozen=True, slots=True)
class TumTrajectory:
    """Poses, a line each."""

    name: str = "tum"
    title: str = "TUM trajectory"
    extra: str = ""
    used_options: frozenset[str] = frozenset({"stamp"})

    def detect(self, source: Path) -> FormatMatch | None:
        """Return a match for lines of eight numbers that end in a quaternion of length 1."""
        head = read_head(source)
        if not head or b"\0" in head:
            return None
        lines = head.decode("utf-8", errors="replace").splitlines()
        rows = [line.split() for line in lines[:-1] if line.strip() and line[:1] != "#"][:20]
        try:
            values = np.array(rows, dtype=np.float64)
        except ValueError:
            return None
        if values.ndim != 2 or values.shape[1] != 8 or not np.all(np.isfinite(values)):
            return None
        length = np.linalg.norm(values[:, 4:], axis=1)
        is_pose = bool(np.all(np.abs(length - 1.0) < 0.01) and np.all(np.diff(values[:, 0]) >= 0))
        return FormatMatch("a trajectory with orientations (TUM)") if is_pose else None

    def read(self, source: Path, options: ImportOptions) -> MeasuredStreams:
        """Return the poses."""
        columns = open_columns(source, [TIME, *ORIENTATION], LAYOUT)
        time_s = columns.matrix([TIME], 1)[:, 0]
        if not np.all(np.isfinite(time_s)) or np.abs(time_s).max() > MAX_STAMP_S:
            raise InputError(
                f"a time in the trajectory {source.name} is not a time in seconds",
                "write the times in seconds, or import the file with a column map (--map)",
            )
        stamp_ns = nanoseconds(time_s)
        notes: list[str] = []
        origin_ns = int(stamp_ns.min())
        poses = pose_stream(
            stamp_ns,
            columns.matrix(ORIENTATION, 4),
            origin_ns,
            f"the trajectory {source.name}",
            options.stamp,
            notes,
        )
        return MeasuredStreams(
            f"imported from {source.name}: a TUM trajectory",
            poses=poses,
            origin_ns=origin_ns,
            notes=tuple(notes),
        )


FORMAT = TumTrajectory()
