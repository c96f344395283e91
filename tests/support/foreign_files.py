"""One simulated session, written in the formats of others by the formats' own libraries.

What to use when: a `write_*` function writes a `SimulatedAttitudes` session as somebody else's
program would; `START_NS` is its time of day.
"""

from collections.abc import Iterator
from heapq import merge
from pathlib import Path
from typing import Any

import h5py  # type: ignore[import-untyped]
import numpy as np
import pyarrow  # type: ignore[import-untyped]
import pyarrow.parquet  # type: ignore[import-untyped]
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_typestore
from scipy.io import savemat
from scipy.spatial.transform import Rotation
from tests.support.simulated_attitudes import SimulatedAttitudes

START_NS = 1_760_000_000_000_000_000
LINK_NS = 1_300_000  # from the stamp of a message to the log


def stamps_ns(time_s: np.ndarray) -> list[int]:
    return [int(at) for at in START_NS + np.rint(time_s * 1e9).astype(np.int64)]


class RosMessages:
    """The session as messages of one ROS version's standard types."""

    def __init__(self, store: Stores, session: SimulatedAttitudes, pose_type: str) -> None:
        self.store = get_typestore(store)
        self._types = self.store.types
        self._session = session
        self._pose_type = pose_type

    def imu_type(self) -> str:
        return "sensor_msgs/msg/Imu"

    def pose_type(self) -> str:
        package = {"Odometry": "nav_msgs", "TFMessage": "tf2_msgs"}
        return f"{package.get(self._pose_type, 'geometry_msgs')}/msg/{self._pose_type}"

    def header(self, at_ns: int, frame: str) -> Any:
        seconds, rest = divmod(at_ns, 10**9)
        stamp = self._types["builtin_interfaces/msg/Time"](seconds, rest)
        header = self._types["std_msgs/msg/Header"]
        fields = getattr(header, "__dataclass_fields__", {})
        return header(0, stamp, frame) if "seq" in fields else header(stamp, frame)

    def imu(self) -> Iterator[tuple[int, Any]]:
        vector = self._types["geometry_msgs/msg/Vector3"]
        orientation = self._types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
        unknown = np.array([-1.0, *[0.0] * 8])
        for at_ns, rate in zip(
            stamps_ns(self._session.gyro_time_s), self._session.gyro_rad_s.tolist(), strict=True
        ):
            yield at_ns, self._types[self.imu_type()](
                self.header(at_ns, "imu_link"), orientation, unknown, vector(*rate),
                np.zeros(9), vector(0.0, 0.0, 9.81), np.zeros(9),
            )  # fmt: skip

    def temperatures(self) -> Iterator[tuple[int, Any]]:
        for at_ns in stamps_ns(self._session.gyro_time_s[::200]):
            yield (
                at_ns,
                self._types["sensor_msgs/msg/Temperature"](
                    self.header(at_ns, "imu_link"), 31.5, 0.0
                ),
            )

    def poses(self) -> Iterator[tuple[int, Any]]:
        for at_ns, q in zip(
            stamps_ns(self._session.stamp_s), self._session.orientation_xyzw.tolist(), strict=True
        ):
            yield at_ns, self._pose(self.header(at_ns, "world"), q)

    def _pose(self, header: Any, q: list[float]) -> Any:
        types = self._types
        rotation = types["geometry_msgs/msg/Quaternion"](*q)
        point = types["geometry_msgs/msg/Point"](0.0, 0.0, 0.0)
        zero = types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
        pose = types["geometry_msgs/msg/Pose"](point, rotation)
        if self._pose_type == "PoseStamped":
            return types[self.pose_type()](header, pose)
        if self._pose_type == "Odometry":
            twist = types["geometry_msgs/msg/Twist"](zero, zero)
            return types[self.pose_type()](
                header, "body",
                types["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36)),
                types["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36)),
            )  # fmt: skip
        transform = types["geometry_msgs/msg/TransformStamped"](
            header, "body", types["geometry_msgs/msg/Transform"](zero, rotation)
        )
        if self._pose_type == "TransformStamped":
            return transform
        return types[self.pose_type()]([transform])


def write_ros2_bag(
    folder: Path,
    session: SimulatedAttitudes,
    *,
    storage: str = "mcap",
    pose_type: str = "PoseStamped",
    imu_topics: tuple[str, ...] = ("/imu/data_raw",),
    link_ns: int = LINK_NS,
) -> Path:
    """Write a bag; with `link_ns` 0 the stamps are those of the log."""
    messages = RosMessages(Stores.ROS2_HUMBLE, session, pose_type)
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    with Ros2Writer(folder, version=9, storage_plugin=plugin) as bag:
        for topic in imu_topics:
            imu = bag.add_connection(topic, messages.imu_type(), typestore=messages.store)
            for at_ns, message in messages.imu():
                payload = messages.store.serialize_cdr(message, messages.imu_type())
                bag.write(imu, at_ns + link_ns, payload)
        name = "/tf" if pose_type == "TFMessage" else "/mocap/body"
        poses = bag.add_connection(name, messages.pose_type(), typestore=messages.store)
        for at_ns, message in messages.poses():
            payload = messages.store.serialize_cdr(message, messages.pose_type())
            bag.write(poses, at_ns + link_ns, payload)
        warmth = bag.add_connection(
            "/imu/temperature", "sensor_msgs/msg/Temperature", typestore=messages.store
        )
        for at_ns, message in messages.temperatures():
            payload = messages.store.serialize_cdr(message, "sensor_msgs/msg/Temperature")
            bag.write(warmth, at_ns + link_ns, payload)
    return folder


def write_ros1_bag(
    path: Path,
    session: SimulatedAttitudes,
    *,
    pose_type: str = "PoseStamped",
    compression: str = "none",
) -> Path:
    messages = RosMessages(Stores.ROS1_NOETIC, session, pose_type)
    bag = Ros1Writer(path)
    if compression != "none":
        bag.set_compression(Ros1Writer.CompressionFormat[compression.upper()])
    with bag:
        imu = bag.add_connection("/imu", messages.imu_type(), typestore=messages.store)
        poses = bag.add_connection("/vicon", messages.pose_type(), typestore=messages.store)
        for at_ns, connection, type_name, message in merge(
            ((at, imu, messages.imu_type(), message) for at, message in messages.imu()),
            ((at, poses, messages.pose_type(), message) for at, message in messages.poses()),
            key=lambda dated: dated[0],
        ):
            payload = messages.store.serialize_ros1(message, type_name)
            bag.write(connection, at_ns + LINK_NS, payload)
    return path


# vicon's marker frame on the body, as a published sensor.yaml gives it
MARKER_TURN = Rotation.from_euler("ZYX", [90.0, 10.0, -5.0], degrees=True)
_SENSOR_YAML = """#Default imu sensor yaml file
sensor_type: {kind}
comment: simulated

# Sensor extrinsics wrt. the body-frame.
T_BS:
  cols: 4
  rows: 4
  data: [{data}]
rate_hz: {rate}
"""


def write_euroc_folder(
    folder: Path, session: SimulatedAttitudes, reference: str = "vicon0"
) -> Path:
    """Write the folders of a sequence, with the header lines of the published ones."""
    imu = folder / "mav0" / "imu0"
    tracked = folder / "mav0" / reference
    leica = folder / "mav0" / "leica0"
    for path in (imu, tracked, leica):
        path.mkdir(parents=True)
    rows = [
        "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
        "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]"
    ]
    for at_ns, rate in zip(
        stamps_ns(session.gyro_time_s), session.gyro_rad_s.tolist(), strict=True
    ):
        rows.append(f"{at_ns},{rate[0]:.9f},{rate[1]:.9f},{rate[2]:.9f},0.0,0.0,9.81")
    (imu / "data.csv").write_text("\r\n".join(rows) + "\r\n")
    (imu / "sensor.yaml").write_text(_sensor_yaml("imu", Rotation.identity(), 200))
    rows = [
        "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], "
        "q_RS_y [], q_RS_z []"
    ]
    marker = Rotation.from_quat(session.orientation_xyzw) * MARKER_TURN
    for at_ns, q in zip(stamps_ns(session.stamp_s), marker.as_quat().tolist(), strict=True):
        rows.append(f"{at_ns},0.1,0.2,0.3,{q[3]:.9f},{q[0]:.9f},{q[1]:.9f},{q[2]:.9f}")
    (tracked / "data.csv").write_text("\n".join(rows) + "\n")
    (tracked / "sensor.yaml").write_text(_sensor_yaml("pose", MARKER_TURN, 100))
    (leica / "data.csv").write_text(
        "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m]\n1403636579758555392,1.0,2.0,3.0\n"
    )
    return folder


def _sensor_yaml(kind: str, turn: Rotation, rate: int) -> str:
    pose = np.eye(4)
    pose[:3, :3] = turn.as_matrix()
    data = ",\n         ".join(", ".join(f"{v:.9f}" for v in row) for row in pose.tolist())
    return _SENSOR_YAML.format(kind=kind, data=data, rate=rate)


def write_tum_trajectory(path: Path, session: SimulatedAttitudes) -> Path:
    """Write `time tx ty tz qx qy qz qw` per line."""
    lines = ["# ground truth trajectory", "# timestamp tx ty tz qx qy qz qw"]
    for at_s, q in zip(session.stamp_s.tolist(), session.orientation_xyzw.tolist(), strict=True):
        lines.append(f"{at_s:.6f} 0.1 0.2 0.3 {q[0]:.7f} {q[1]:.7f} {q[2]:.7f} {q[3]:.7f}")
    path.write_text("\n".join(lines) + "\n")
    return path


def write_gyro_table(path: Path, session: SimulatedAttitudes) -> Path:
    """Write a table of the gyro in deg/s."""
    lines = ["t,gx,gy,gz"]
    for at_s, rate in zip(
        session.gyro_time_s.tolist(), np.degrees(session.gyro_rad_s).tolist(), strict=True
    ):
        lines.append(f"{at_s:.6f},{rate[0]:.7f},{rate[1]:.7f},{rate[2]:.7f}")
    path.write_text("\n".join(lines) + "\n")
    return path


def session_arrays(session: SimulatedAttitudes) -> dict[str, np.ndarray]:
    """Return the session as somebody would name its arrays."""
    return {
        "t_imu": session.gyro_time_s,
        "gyr": np.degrees(session.gyro_rad_s),
        "t_cam": session.stamp_s,
        "quat": session.orientation_xyzw[:, [3, 0, 1, 2]],
    }


def write_matlab5(path: Path, session: SimulatedAttitudes, *, as_struct: bool = False) -> Path:
    arrays: dict[str, Any] = session_arrays(session)
    savemat(path, {"log": arrays} if as_struct else arrays, do_compression=True)
    return path


def write_matlab73(path: Path, session: SimulatedAttitudes) -> Path:
    """Write a file of version 7.3: a user block of 512 bytes, and arrays stored columns first."""
    with h5py.File(path, "w", userblock_size=512) as file:
        group = file.create_group("log")
        for name, values in session_arrays(session).items():
            rows = values[:, None] if values.ndim == 1 else values
            dataset = group.create_dataset(name, data=rows.T, compression="gzip")
            dataset.attrs["MATLAB_class"] = np.bytes_(b"double")
    text = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Mon Nov 23 2026 HDF5 schema 1.00 ."
    with path.open("r+b") as file:
        file.write(text.ljust(116) + bytes(8) + b"\x00\x02IM")
    return path


def write_parquet(path: Path, session: SimulatedAttitudes) -> Path:
    """Write the gyro, a column per axis, and the quaternions at the samples nearest in time."""
    nearest = np.clip(
        np.searchsorted(session.stamp_s, session.gyro_time_s), 0, session.stamp_s.size - 1
    )
    is_equal = np.abs(session.stamp_s[nearest] - session.gyro_time_s) < 1e-6
    orientation = np.where(is_equal[:, None], session.orientation_xyzw[nearest], np.nan)
    columns: dict[str, Any] = {"time_us": np.rint(session.gyro_time_s * 1e6).astype(np.int64)}
    columns |= {f"gyro_{axis}": session.gyro_rad_s[:, k] for k, axis in enumerate("xyz")}
    columns |= {f"q{axis}": orientation[:, k] for k, axis in enumerate("xyzw")}
    pyarrow.parquet.write_table(pyarrow.table(columns), path)
    return path
