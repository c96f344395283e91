"""Reference attitudes from rows of a table: exact times, lengths checked, the kind of the times.

What to use when: `pose_stream` in a format whose poses are rows of numbers; `exact_stamps_ns` for
a column of whole nanoseconds.
"""

import warnings
from pathlib import Path

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.importers.import_times import order_by_time, seconds_since
from gyrorig_solver.importers.measured_streams import LENGTH_TOLERANCE, PoseStream
from gyrorig_solver.importers.stamp_kinds import choose_stamp_kind
from gyrorig_solver.importers.text_columns import MAX_ROWS


def exact_stamps_ns(path: Path) -> IntArray:
    """Return the first column of a comma-separated table with one header line, as integers.

    A time of day in ns does not fit a float64: its step would be 256 ns.

    Raises:
        InputError: a cell is not a whole number.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # about empty lines, and no lines
            stamps = np.loadtxt(
                path, delimiter=",", skiprows=1, usecols=[0], dtype=np.int64, ndmin=1,
                comments=None, max_rows=MAX_ROWS,
            )  # fmt: skip
    except (ValueError, IndexError, OverflowError) as error:
        raise InputError(
            f"the first column of the table {path.name} does not contain whole nanoseconds",
            "give the file as it was published, or import it with a column map (--map)",
        ) from error
    if not stamps.size:
        raise InputError(
            f"the table {path.name} has a header, but no rows", "give a file with measurements"
        )
    return stamps


def pose_stream(
    stamp_ns: IntArray,
    orientation_xyzw: FloatArray,
    origin_ns: int,
    name: str,
    stamp: str | None,
    notes: list[str],
) -> PoseStream:
    """Return the attitudes in order; appends what was changed and assumed to `notes`.

    Args:
        stamp_ns: shape (n,).
        orientation_xyzw: body to world, shape (n, 4); rows of another length are lost.
        origin_ns: the time at which the stream's times are 0.
        name: the source of the poses, for notes and errors.
        stamp: "sampled" or "arrival" if a person chose it.
        notes: of the import.

    Raises:
        InputError: no row is a quaternion.
    """
    length = np.linalg.norm(orientation_xyzw, axis=1)
    is_unit = np.abs(length - 1.0) < LENGTH_TOLERANCE
    if is_unit.sum() < 2:
        raise InputError(
            f"{name} contains no quaternions of length 1",
            "give a file with orientations, or import it with a column map (--map)",
        )
    unit = orientation_xyzw[is_unit] / length[is_unit, None]
    ordered_ns, unit = order_by_time(stamp_ns[is_unit], unit, name, notes)
    kind, reason = choose_stamp_kind(ordered_ns, None, stamp)
    words = "times of arrival" if kind == "arrival" else "times of sampling"
    notes.append(
        f"{name}: the orientation maps the body to the world; its timestamps are {words} ({reason})"
    )
    return PoseStream(
        seconds_since(ordered_ns, origin_ns), unit, stamp=kind, lost=int((~is_unit).sum())
    )
