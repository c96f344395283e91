"""Logs of the x-IMU3: a folder with one table per kind of message, or a folder of such folders.

Source: xioTechnologies/x-IMU3-CSV, ximu3csv/read.py and data_messages.py, and its example log:
`Inertial.csv` has the columns `Timestamp (us)`, gyroscope x, y, z in deg/s and accelerometer x,
y, z in g; `Temperature.csv` has `Temperature (degC)`; `Quaternion.csv` has w, x, y, z, the
orientation of the sensor relative to the Earth; `Command.json` has the answer to a ping.
"""

import json
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.importers.board_names import unique_names
from gyrorig_solver.importers.measured_streams import (
    STANDARD_GRAVITY_M_S2,
    AccelStream,
    GyroStream,
    MeasuredBoard,
    MeasuredStreams,
    PoseStream,
    TemperatureStream,
)
from gyrorig_solver.importers.measurement_format import (
    BOARD_OPTIONS,
    MAX_LISTED,
    FormatMatch,
    ImportOptions,
)
from gyrorig_solver.importers.source_tables import SourceTables

_TIME = "Timestamp (us)"
_GYRO = [f"Gyroscope {axis} (deg/s)" for axis in "XYZ"]
_ACCEL = [f"Accelerometer {axis} (g)" for axis in "XYZ"]
_MAX_COMMAND_BYTES = 1_000_000


@dataclass(frozen=True, slots=True)
class Ximu3:
    """The inertial messages of one x-IMU3 or of several."""

    name: str = "x-imu3"
    title: str = "log of an x-IMU3 (folder)"
    extra: str = ""
    used_options: frozenset[str] = BOARD_OPTIONS | {"topics"}

    def detect(self, source: Path) -> FormatMatch | None:
        """Return a match for a folder, or a folder of folders, with Inertial.csv."""
        return FormatMatch("a log of an x-IMU3") if _device_folders(source) else None

    def read(self, source: Path, options: ImportOptions) -> MeasuredStreams:
        """Return one board per device; `--topic Quaternion` uses the sensor's own attitude."""
        options.check_topics(("Quaternion",))
        folders = _device_folders(source)
        if not folders:
            raise InputError(
                f"the folder {source.name} contains no Inertial.csv of an x-IMU3",
                "give the folder that the x-IMU3 software wrote",
            )
        if len(folders) > 1 and options.board:
            raise InputError(
                f"the folder {source.name} contains {len(folders)} devices, so one name is not "
                "enough",
                "remove --board, or give the folder of one device",
            )
        if len(folders) > 1 and options.topics:
            raise InputError(
                f"the folder {source.name} contains {len(folders)} devices, each with an attitude, "
                "but one recording has one reference",
                "remove --topic, or give the folder of one device",
            )
        boards = [_read_board(folder, options) for folder in folders]
        boards, name_notes = _name_unknown_devices(boards, folders)
        poses, pose_notes = _read_poses(SourceTables(folders[0]), options)
        return MeasuredStreams(
            f"imported from {source.name}: log of an x-IMU3",
            tuple(boards),
            poses=poses,
            notes=(*name_notes, *pose_notes),
        )


def _device_folders(source: Path) -> list[Path]:
    if not source.is_dir():
        return []
    candidates = [source, *sorted(islice(source.iterdir(), MAX_LISTED))]
    folders = [path for path in candidates if path.is_dir() and _has_inertial(path)]
    return folders[:1] if source in folders else folders


def _has_inertial(folder: Path) -> bool:
    if not (folder / "Inertial.csv").is_file():
        return False
    return SourceTables(folder).header("Inertial.csv").startswith(_TIME)


def _read_board(folder: Path, options: ImportOptions) -> MeasuredBoard:
    tables = SourceTables(folder)
    inertial = tables.columns("Inertial.csv", [_TIME, *_GYRO, *_ACCEL])
    time_s = inertial.matrix([_TIME], 1)[:, 0] * 1e-6
    temperature = None
    if "Temperature.csv" in tables.names:
        key = "Temperature (degC)"
        columns = tables.columns("Temperature.csv", [_TIME, key])
        temperature = TemperatureStream(
            columns.matrix([key], 1)[:, 0], columns.matrix([_TIME], 1)[:, 0] * 1e-6
        )
    serial = _serial_number(folder)
    return MeasuredBoard(
        options.board or serial or "X-IMU3",
        GyroStream(time_s, np.radians(inertial.matrix(_GYRO, 3))),
        AccelStream(STANDARD_GRAVITY_M_S2 * inertial.matrix(_ACCEL, 3)),
        temperature,
        {"sensor": options.sensor or "x-IMU3", "uid": serial or "unknown", "model": "x-IMU3"},
    )


def _name_unknown_devices(
    boards: list[MeasuredBoard], folders: list[Path]
) -> tuple[list[MeasuredBoard], list[str]]:
    """Return the boards and notes; devices without a serial number get numbered names."""
    unknown = [k for k, board in enumerate(boards) if board.metadata["uid"] == "unknown"]
    if len(unknown) < 2:
        return boards, []
    named, notes = list(boards), []
    names = unique_names([boards[k].name for k in unknown])
    for k, name in zip(unknown, names, strict=True):
        named[k] = replace(boards[k], name=name)
        notes.append(f"{folders[k].name} contains no serial number; its device has the name {name}")
    return named, notes


def _serial_number(folder: Path) -> str:
    """Return the serial number in the answer to a ping, "" if the log has none."""
    path = folder / "Command.json"
    try:
        if path.stat().st_size > _MAX_COMMAND_BYTES:
            return ""
        answers = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError):
        return ""
    for answer in answers if isinstance(answers, list) else []:
        ping = answer.get("ping") if isinstance(answer, dict) else None
        if isinstance(ping, dict):
            serial = str(ping.get("serialNumber") or ping.get("sn") or "")
            is_name = serial.replace("-", "").isalnum() and serial.isascii()
            return serial if is_name and len(serial) <= 32 and serial[0] != "-" else ""
    return ""


def _read_poses(
    tables: SourceTables, options: ImportOptions
) -> tuple[PoseStream | None, list[str]]:
    if "Quaternion.csv" not in tables.names:
        return None, []
    if "Quaternion" not in options.topics:
        return None, [
            "Quaternion.csv is not used as a reference, because the x-IMU3 computes it from the "
            "same gyroscope (--topic Quaternion uses it)"
        ]
    columns = tables.columns("Quaternion.csv", [1, 2, 3, 4, 5])
    time_s = columns.matrix([1], 1)[:, 0] * 1e-6
    poses = PoseStream.of_rows(time_s, columns.matrix([3, 4, 5, 2], 4))
    return poses, ["the reference is the x-IMU3's own attitude, computed from the same gyroscope"]


FORMAT = Ximu3()
