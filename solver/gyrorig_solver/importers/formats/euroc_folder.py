"""Folders in the layout of the EuRoC data set (ASL): imu0/data.csv, vicon0/data.csv, ...

The header names the quantity and the unit of each column, and `sensor.yaml` gives the pose of
each sensor on the body (M. Burri et al., "The EuRoC micro aerial vehicle datasets", IJRR 2016).
"""

import re
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np

from gyrorig_protocol.documents import parse_yaml
from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.importers.board_names import board_name
from gyrorig_solver.importers.import_times import order_by_time, seconds_since
from gyrorig_solver.importers.map_keys import TableLayout
from gyrorig_solver.importers.matrix_attitudes import quaternions_of_matrices
from gyrorig_solver.importers.measured_streams import (
    AccelStream,
    GyroStream,
    MeasuredBoard,
    MeasuredStreams,
    PoseStream,
)
from gyrorig_solver.importers.measurement_columns import open_columns
from gyrorig_solver.importers.measurement_format import (
    BOARD_OPTIONS,
    MAX_LISTED,
    FormatMatch,
    ImportOptions,
    read_head,
)
from gyrorig_solver.importers.stamp_kinds import choose_stamp_kind, count_rows
from gyrorig_solver.importers.trajectory_rows import exact_stamps_ns, pose_stream

# References, the one that is most independent of the gyro first.
REFERENCES = ("vicon", "mocap", "gt", "state_groundtruth_estimate")
RATE = [f"w_RS_S_{axis} [rad s^-1]" for axis in "xyz"]
FORCE = [f"a_RS_S_{axis} [m s^-2]" for axis in "xyz"]
QUATERNION = ["q_RS_x", "q_RS_y", "q_RS_z", "q_RS_w"]
MAX_YAML_BYTES = 100_000


@dataclass(frozen=True, slots=True)
class EurocFolder:
    """A sequence: a folder with a folder per sensor, or that folder's parent."""

    name: str = "euroc"
    title: str = "EuRoC/ASL folder"
    extra: str = ""
    used_options: frozenset[str] = BOARD_OPTIONS | {"topics", "stamp"}

    def detect(self, source: Path) -> FormatMatch | None:
        """Return a match for the header of an IMU's table."""
        if source.is_file():
            is_table = RATE[0].encode() in read_head(source)
            return FormatMatch("a table of an IMU (EuRoC/ASL)") if is_table else None
        sensors = _sensor_folders(source)
        if not any(RATE[0].encode() in read_head(path / "data.csv") for path in sensors):
            return None
        names = ", ".join(path.name[:40] for path in sensors[:8])
        return FormatMatch(f"a folder in the layout of EuRoC with {names}")

    def read(self, source: Path, options: ImportOptions) -> MeasuredStreams:
        """Return the IMUs and the most independent reference with attitudes."""
        if source.is_file():
            sensors = [source.parent]
            tables = {source.parent: source}
        else:
            sensors = _sensor_folders(source)
            tables = {path: path / "data.csv" for path in sensors}
        headers = {path: _header(tables[path]) for path in sensors}
        imus = [path for path in sensors if set(RATE) <= set(headers[path])]
        chosen = [path for path in imus if path.name in options.topics] or imus[:1]
        if not chosen:
            raise InputError(
                f"{source.name} has no table with all columns of a gyroscope ({', '.join(RATE)})",
                "give the files as they were published, or import with a column map (--map)",
            )
        notes: list[str] = []
        if len(imus) > len(chosen):
            names = ", ".join(path.name for path in imus)
            notes.append(f"the folder contains {names}; the others can be chosen with --topic")
        origin_ns = min(int(exact_stamps_ns(tables[path]).min()) for path in chosen)
        boards = [
            _board(tables[path], path, headers[path], origin_ns, options, notes) for path in chosen
        ]
        poses = None
        if source.is_dir():
            reference = _choose_reference(sensors, headers, options, notes)
            if reference is not None:
                poses = _poses(reference, headers[reference], chosen[0], origin_ns, options, notes)
        return MeasuredStreams(
            f"imported from {source.name}: the layout of EuRoC",
            tuple(boards),
            poses,
            origin_ns=origin_ns,
            notes=tuple(notes),
        )


def _sensor_folders(source: Path) -> list[Path]:
    """Return the folders with a data.csv: of the source, of its mav0, or the source itself."""
    for base in (source / "mav0", source):
        if base.is_dir():
            listed = islice(base.iterdir(), MAX_LISTED)
            sensors = sorted(path for path in listed if (path / "data.csv").is_file())
            if sensors:
                return sensors
    return [source] if (source / "data.csv").is_file() else []


def _header(table: Path) -> list[str]:
    first = read_head(table).partition(b"\n")[0].decode("utf-8", errors="replace")
    return [name.strip() for name in first.split(",")]


def _numbers(header: list[str], wanted: list[str]) -> list[int] | None:
    """Return the numbers of columns, from 1, by the beginnings of their names."""
    numbers = []
    for name in wanted:
        at = [k for k, text in enumerate(header, 1) if text == name or text.startswith(f"{name} ")]
        if not at:
            return None
        numbers.append(at[0])
    return numbers


def _matrix(table: Path, numbers: list[int]) -> FloatArray:
    layout = TableLayout(delimiter="comma")
    return open_columns(table, numbers, layout).matrix(numbers, len(numbers))


def _board(
    table: Path,
    folder: Path,
    header: list[str],
    origin_ns: int,
    options: ImportOptions,
    notes: list[str],
) -> MeasuredBoard:
    rate_numbers = _numbers(header, RATE) or []
    force_numbers = _numbers(header, FORCE)
    values = _matrix(table, rate_numbers + (force_numbers or []))
    stamp_ns = exact_stamps_ns(table)
    _check_rows(table, stamp_ns, values)
    indices = np.arange(stamp_ns.size, dtype=np.float64)[:, None]
    ordered_ns, picked = order_by_time(stamp_ns, indices, folder.name, notes)
    values = values[picked[:, 0].astype(np.int64)]
    rate_hz = _sensor_yaml(folder).get("rate_hz")
    time_s = seconds_since(ordered_ns, origin_ns)
    kind, reason = choose_stamp_kind(ordered_ns, None, options.stamp)
    if kind == "arrival":
        notes.append(f"{folder.name}: its timestamps are times of arrival ({reason})")
    return MeasuredBoard(
        options.board or board_name(folder.name, "imu0"),
        GyroStream(
            time_s,
            values[:, :3],
            stamp=kind,
            number=count_rows(time_s) if kind == "arrival" else None,
            rate_hz=float(rate_hz) if isinstance(rate_hz, int | float) and rate_hz > 0 else None,
        ),
        AccelStream(values[:, 3:]) if force_numbers else None,
        metadata={"sensor": options.sensor or "unknown", "model": folder.name},
    )


def _choose_reference(
    sensors: list[Path], headers: dict[Path, list[str]], options: ImportOptions, notes: list[str]
) -> Path | None:
    with_attitude = [path for path in sensors if _numbers(headers[path], QUATERNION) is not None]
    ranked = sorted(
        (path for path in with_attitude if path.name.rstrip("0123456789") in REFERENCES),
        key=lambda path: REFERENCES.index(path.name.rstrip("0123456789")),
    )
    imus = {path.name for path in sensors if set(RATE) <= set(headers[path])}
    for name in options.topics:
        if name not in imus and name not in {path.name for path in with_attitude}:
            known = ", ".join(sorted({*imus, *(path.name for path in with_attitude)}))
            raise UsageError(
                f"the folder contains no IMU or attitudes with the name {name!r:.60}",
                f"choose one of {known}",
            )
    chosen = [path for path in with_attitude if path.name in options.topics] or ranked
    without = [
        path.name
        for path in sensors
        if path not in with_attitude and re.match(r"leica|pos|prism", path.name)
    ]
    if without:
        notes.append(
            f"{', '.join(without)} contains positions without orientations, which cannot be a "
            "reference for a gyro"
        )
    if not chosen:
        return None
    if chosen[0].name.startswith("state_groundtruth"):
        notes.append(
            f"{chosen[0].name} was estimated with the same IMU, so its attitudes are not "
            "independent of the gyro"
        )
    if len(chosen) > 1:
        others = ", ".join(path.name for path in chosen[1:])
        notes.append(f"the reference is {chosen[0].name}; {others} can be chosen with --topic")
    return chosen[0]


def _poses(
    folder: Path,
    header: list[str],
    imu: Path,
    origin_ns: int,
    options: ImportOptions,
    notes: list[str],
) -> PoseStream:
    """Return the attitudes of the IMU: those of the tracked frame, turned by both extrinsics."""
    table = folder / "data.csv"
    stamp_ns = exact_stamps_ns(table)
    quaternion = _matrix(table, _numbers(header, QUATERNION) or [])
    _check_rows(table, stamp_ns, quaternion)
    tracked, sensor = _rotation_on_body(folder), _rotation_on_body(imu)
    poses = pose_stream(stamp_ns, quaternion, origin_ns, folder.name, options.stamp, notes)
    if tracked is None or sensor is None:
        notes.append(
            f"{folder.name}: a sensor.yaml gives no T_BS, so the tracked frame is taken as the "
            "frame of the IMU"
        )
        return poses
    from scipy.spatial.transform import Rotation  # noqa: PLC0415 - slow to load

    turn = Rotation.from_matrix(tracked).inv() * Rotation.from_matrix(sensor)
    attitude = Rotation.from_quat(poses.orientation_xyzw) * turn
    notes.append(f"{folder.name}: turned into the frame of {imu.name} by T_BS of both")
    return replace(poses, orientation_xyzw=np.asarray(attitude.as_quat(), dtype=np.float64))


def _check_rows(table: Path, stamp_ns: IntArray, values: FloatArray) -> None:
    if stamp_ns.size != len(values):
        raise InputError(
            f"the table {table.parent.name}/{table.name} has {stamp_ns.size} times, but "
            f"{len(values)} rows of values",
            "give the table as it was published",
        )


def _sensor_yaml(folder: Path) -> dict[str, object]:
    path = folder / "sensor.yaml"
    if not path.is_file() or path.stat().st_size > MAX_YAML_BYTES:
        return {}
    lines = path.read_bytes().splitlines()
    text = b"\n".join(line for line in lines if not line.startswith(b"%YAML"))  # of OpenCV
    document = parse_yaml(text, f"{folder.name}/sensor.yaml", InputError)
    return document if isinstance(document, dict) else {}


def _rotation_on_body(folder: Path) -> FloatArray | None:
    """Return the rotation from the sensor's frame to the body's, (3, 3), None if not given."""
    pose = _sensor_yaml(folder).get("T_BS")
    data = pose.get("data") if isinstance(pose, dict) else None
    if not isinstance(data, list) or len(data) != 16:
        return None
    try:
        matrix = np.array(data, dtype=np.float64).reshape(4, 4)[:3, :3]
    except (ValueError, TypeError):
        return None
    quaternions_of_matrices(matrix.reshape(1, 9))  # refuses what is no rotation
    return matrix


FORMAT = EurocFolder()
