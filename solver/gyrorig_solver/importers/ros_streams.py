"""Measured streams from the messages of a ROS bag, whatever its container.

What to use when: `read_ros_streams` in the formats of ROS 1 and ROS 2 bags. Only standard types
are read, by their published definitions; definitions in the bag are not used.

Units and frames are those of REP 103 and the message definitions: rates in rad/s, accelerations
in m/s^2, temperatures in degC, quaternions x, y, z, w. The orientation in `sensor_msgs/Imu` is no
reference, because it is computed from the same gyro.
"""

from array import array
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.importers.board_names import board_name, unique_names
from gyrorig_solver.importers.import_times import order_by_time, seconds_since
from gyrorig_solver.importers.measured_streams import (
    AccelStream,
    GyroStream,
    MeasuredBoard,
    MeasuredStreams,
    PoseStream,
    StampKind,
    TemperatureStream,
)
from gyrorig_solver.importers.measurement_format import ImportOptions
from gyrorig_solver.importers.stamp_kinds import choose_stamp_kind, count_rows

NS = 1_000_000_000
MAX_MESSAGES = 10_000_000
MAX_LISTED_TOPICS = 12
NO_FRAME = "no frame"

RosMessage = tuple[str, str, int, Any]  # topic, type, log time in ns, decoded message


@dataclass(slots=True)
class _TopicRows:
    """The values of one topic, a row per message."""

    kind: str  # imu, pose or temperature
    type_name: str
    # arrays of numbers: a row of an IMU takes 64 bytes
    log_ns: "array[int]" = field(default_factory=lambda: array("q"))
    stamp_ns: "array[int]" = field(default_factory=lambda: array("q"))
    values: "array[float]" = field(default_factory=lambda: array("d"))
    frames: set[str] = field(default_factory=set)


@dataclass(frozen=True, slots=True, eq=False)
class _Topic:
    """The values of one topic in the order of time."""

    name: str
    kind: str
    stamp_ns: IntArray
    values: FloatArray
    stamp: StampKind
    reason: str
    frames: str

    @property
    def rate_hz(self) -> float:
        """The mean rate."""
        span_s = float(self.stamp_ns[-1] - self.stamp_ns[0]) / NS
        return (self.stamp_ns.size - 1) / span_s if span_s > 0.0 else 0.0


def _imu_values(message: Any) -> tuple[float, ...]:
    rate, accel = message.angular_velocity, message.linear_acceleration
    # REP 145: -1 as the first covariance marks a quantity that the source does not measure
    has_rate = float(message.angular_velocity_covariance[0]) != -1.0
    has_accel = float(message.linear_acceleration_covariance[0]) != -1.0
    nan = float("nan")
    return (
        *((rate.x, rate.y, rate.z) if has_rate else (nan,) * 3),
        *((accel.x, accel.y, accel.z) if has_accel else (nan,) * 3),
    )


def _quaternion(q: Any) -> tuple[float, ...]:
    return q.x, q.y, q.z, q.w


_Values = Callable[[Any], tuple[float, ...]]
_READERS: dict[str, tuple[str, _Values]] = {
    "sensor_msgs/msg/Imu": ("imu", _imu_values),
    "sensor_msgs/msg/Temperature": ("temperature", lambda m: (m.temperature,)),
    "geometry_msgs/msg/PoseStamped": ("pose", lambda m: _quaternion(m.pose.orientation)),
    "geometry_msgs/msg/PoseWithCovarianceStamped": (
        "pose",
        lambda m: _quaternion(m.pose.pose.orientation),
    ),
    "geometry_msgs/msg/TransformStamped": ("pose", lambda m: _quaternion(m.transform.rotation)),
    "geometry_msgs/msg/QuaternionStamped": ("pose", lambda m: _quaternion(m.quaternion)),
    "nav_msgs/msg/Odometry": ("pose", lambda m: _quaternion(m.pose.pose.orientation)),
}
TRANSFORMS = "tf2_msgs/msg/TFMessage"
READ_TYPES = frozenset({*_READERS, TRANSFORMS})


def read_ros_streams(
    messages: Iterable[RosMessage], source: str, options: ImportOptions, types: Iterable[str]
) -> MeasuredStreams:
    """Return the streams of the messages.

    Args:
        messages: those of `READ_TYPES`, in any order.
        source: what is read, for readers of the recording.
        options: topics, stamp, board and sensor.
        types: all types of messages in the bag, for the error if none is an Imu.

    Raises:
        InputError: there is no Imu, or several and none was chosen.
        UsageError: a chosen topic is not in the bag.
    """
    topics = [_order(name, rows, options) for name, rows in sorted(_collect(messages).items())]
    topics = [topic for topic in topics if topic.stamp_ns.size >= 2]
    _check_chosen(options.topics, topics)
    imus = _choose("imu", topics, options.topics)
    poses = _choose("pose", topics, options.topics)
    if not imus and not poses:
        listed = ", ".join(sorted(set(types))[:MAX_LISTED_TOPICS]) or "no messages"
        raise InputError(
            f"the bag contains no sensor_msgs/Imu and no poses, but {listed}",
            "record the topic of the IMU, with messages of the type sensor_msgs/Imu",
        )
    if len(poses) > 1 or (len(imus) > 1 and not options.topics):
        several = poses if len(poses) > 1 else imus
        what = "reference poses" if several is poses else "IMUs"
        raise InputError(
            f"the bag contains several topics with {what}: {_list_topics(several)}",
            "choose with --topic; for several boards give --topic once per board"
            if several is imus
            else "choose the topic of the reference with --topic",
        )
    if len(imus) > 1 and options.board is not None:
        raise UsageError(
            f"--board gives one name, but {len(imus)} topics of IMUs are chosen",
            "remove --board; each board gets the name of its topic",
        )
    origin_ns = min(int(topic.stamp_ns[0]) for topic in (*imus, *poses))
    notes = [note for topic in (*imus, *poses) for note in _topic_notes(topic)]
    temperatures = _assign_temperatures(topics, imus, options.topics, notes)
    names = unique_names([options.board or board_name(topic.name, "IMU") for topic in imus])
    boards = [
        _board(topic, name, temperatures.get(topic.name), origin_ns, options)
        for topic, name in zip(imus, names, strict=True)
    ]
    return MeasuredStreams(
        source=source,
        boards=tuple(boards),
        poses=_pose_stream(poses[0], origin_ns) if poses else None,
        origin_ns=origin_ns,
        notes=tuple(notes),
    )


def _collect(messages: Iterable[RosMessage]) -> dict[str, _TopicRows]:
    collected: dict[str, _TopicRows] = {}
    for number, (topic, type_name, log_ns, message) in enumerate(messages):
        if number >= MAX_MESSAGES:
            raise InputError(
                f"the bag contains more than {MAX_MESSAGES} messages",
                "split the bag, and import each part",
            )
        for name, part_type, part in _parts(topic, type_name, message):
            kind, values = _READERS[part_type]
            rows = collected.setdefault(name, _TopicRows(kind, type_name))
            stamp = part.header.stamp
            rows.log_ns.append(log_ns)
            rows.stamp_ns.append(int(stamp.sec) * NS + int(stamp.nanosec))
            rows.values.extend(values(part))
            if len(rows.frames) < 3:
                child = getattr(part, "child_frame_id", "")
                rows.frames.add(f"{part.header.frame_id}{' to ' + child if child else ''}")
    return collected


def _parts(topic: str, type_name: str, message: Any) -> Iterator[tuple[str, str, Any]]:
    """Yield the message, or each transform of a list of transforms."""
    if type_name != TRANSFORMS:
        yield topic, type_name, message
        return
    for transform in message.transforms:
        name = f"{topic}:{transform.header.frame_id}:{transform.child_frame_id}"
        yield name, "geometry_msgs/msg/TransformStamped", transform


def _order(name: str, rows: _TopicRows, options: ImportOptions) -> _Topic:
    stamp_ns = np.array(rows.stamp_ns, dtype=np.int64)
    log_ns = np.array(rows.log_ns, dtype=np.int64)
    stamp, reason = choose_stamp_kind(stamp_ns, log_ns, options.stamp)
    if not np.any(stamp_ns):
        stamp_ns, stamp, reason = log_ns, "arrival", "the messages have only a log time"
    values = np.array(rows.values, dtype=np.float64).reshape(stamp_ns.size, -1)
    if stamp == "arrival":
        # attitudes stay in the order of the frames; the stamps of the samples can repeat
        order = np.argsort(log_ns if rows.kind == "pose" else stamp_ns, kind="stable")
        stamp_ns, values = stamp_ns[order], values[order]
    else:
        notes: list[str] = []
        indices = np.arange(stamp_ns.size, dtype=np.float64)[:, None]
        stamp_ns, picked = order_by_time(stamp_ns, indices, name, notes)
        values = values[picked[:, 0].astype(np.int64)]
        reason = "; ".join([reason, *notes])
    frames = " and ".join(sorted(frame for frame in rows.frames if frame)) or NO_FRAME
    return _Topic(name, rows.kind, stamp_ns, values, stamp, reason, frames)


def _check_chosen(chosen: tuple[str, ...], topics: list[_Topic]) -> None:
    names = {topic.name for topic in topics}
    for name in chosen:
        if name not in names:
            raise UsageError(
                f"the bag contains no topic {name!r:.60} with data of an IMU, a pose or a "
                "temperature",
                f"choose one of the topics {_list_topics(topics)}",
            )


def _choose(kind: str, topics: list[_Topic], chosen: tuple[str, ...]) -> list[_Topic]:
    """Return the topics of a kind, only the chosen ones if one of them is chosen."""
    of_kind = [topic for topic in topics if topic.kind == kind]
    return [topic for topic in of_kind if topic.name in chosen] or of_kind


def _assign_temperatures(
    topics: list[_Topic], imus: list[_Topic], chosen: tuple[str, ...], notes: list[str]
) -> dict[str, _Topic]:
    """Return the temperature of each IMU, by the topic of the IMU; may append to `notes`.

    A temperature is that of the IMU with the same namespace or the same frame. Of a bag with one
    IMU and one temperature, and of topics that a person chose, it is assumed to be that of the IMU.
    """
    temperatures = _choose("temperature", topics, chosen)
    all_imus = [topic for topic in topics if topic.kind == "imu"]
    assigned: dict[str, list[_Topic]] = {}
    left_out = []
    for temperature in temperatures:
        owners = _same_sensor(temperature, all_imus)
        is_single = len(temperatures) == 1 and len(imus) == 1
        if not owners and is_single and (len(all_imus) == 1 or temperature.name in chosen):
            owners = imus
            notes.append(f"the temperature of {temperature.name} is taken as that of the IMU")
        for owner in owners:
            assigned.setdefault(owner.name, []).append(temperature)
        if not owners:
            left_out.append(temperature)
    for imu in imus:
        if len(assigned.get(imu.name, [])) > 1:
            left_out += assigned.pop(imu.name)
    if left_out and imus:
        notes.append(
            f"temperatures are left out: {_list_topics(left_out)}; it is not known which IMU they "
            "belong to; use --topic for one IMU and one temperature"
        )
    return {name: of_imu[0] for name, of_imu in assigned.items()}


def _same_sensor(temperature: _Topic, imus: list[_Topic]) -> list[_Topic]:
    """Return the IMUs that share the namespace or the frame of a temperature.

    If several share one of the two, only those that share both.
    """
    namespace = temperature.name.rpartition("/")[0]
    by_name = [imu for imu in imus if namespace and imu.name.rpartition("/")[0] == namespace]
    by_frame = [imu for imu in imus if imu.frames == temperature.frames and imu.frames != NO_FRAME]
    if len(by_name) == 1:
        return by_name
    if by_name:
        return [imu for imu in by_name if imu in by_frame]
    return by_frame if len(by_frame) == 1 else []


def _list_topics(topics: list[_Topic]) -> str:
    shown = [
        f"{topic.name[:80]} ({topic.stamp_ns.size} messages, {topic.rate_hz:.4g} Hz)"
        for topic in topics[:MAX_LISTED_TOPICS]
    ]
    more = len(topics) - len(shown)
    return (", ".join(shown) or "none") + (f" and {more} more" if more else "")


def _topic_notes(topic: _Topic) -> list[str]:
    assumed = (
        f"the axes of the sensor are those of the frame {topic.frames}"
        if topic.kind == "imu"
        else f"the frames are {topic.frames}, and the orientation maps the body to the world; "
        "the body is fixed to the IMU"
    )
    kind = "times of arrival" if topic.stamp == "arrival" else "times of sampling"
    return [f"{topic.name}: {assumed}; its timestamps are {kind} ({topic.reason})"]


def _board(
    topic: _Topic, name: str, stream: _Topic | None, origin_ns: int, options: ImportOptions
) -> MeasuredBoard:
    time_s = seconds_since(topic.stamp_ns, origin_ns)
    accel = topic.values[:, 3:]
    temperature = None
    if stream is not None:
        temperature = TemperatureStream(
            stream.values[:, 0], seconds_since(stream.stamp_ns, origin_ns), stream.stamp
        )
    return MeasuredBoard(
        name,
        GyroStream(
            time_s,
            topic.values[:, :3],
            stamp=topic.stamp,
            number=count_rows(time_s) if topic.stamp == "arrival" else None,
        ),
        AccelStream(accel) if np.isfinite(accel).any() else None,
        temperature,
        {"sensor": options.sensor or "unknown", "model": topic.name},
    )


def _pose_stream(topic: _Topic, origin_ns: int) -> PoseStream:
    poses = PoseStream.of_rows(seconds_since(topic.stamp_ns, origin_ns), topic.values, topic.stamp)
    if not poses.time_s.size:
        raise InputError(
            f"no message of the topic {topic.name} contains a quaternion of length 1",
            "choose another topic with --topic",
        )
    return poses
