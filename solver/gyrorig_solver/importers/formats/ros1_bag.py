"""ROS 1 bags."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gyrorig_solver.importers.bag_limits import ROS1_MAGIC, check_ros1_chunks, parsing_errors
from gyrorig_solver.importers.measured_streams import MeasuredStreams
from gyrorig_solver.importers.measurement_format import (
    BOARD_OPTIONS,
    FormatMatch,
    ImportOptions,
    read_head,
)
from gyrorig_solver.importers.ros_streams import (
    READ_TYPES,
    TRANSFORMS,
    RosMessage,
    read_ros_streams,
)

_ROS1_TYPES = {"tf/msg/tfMessage": TRANSFORMS}


@dataclass(frozen=True, slots=True)
class Ros1Bag:
    """A bag of ROS 1, version 2.0."""

    name: str = "ros1"
    title: str = "ROS 1 bag"
    extra: str = "ros"
    used_options: frozenset[str] = BOARD_OPTIONS | {"topics", "stamp"}

    def detect(self, source: Path) -> FormatMatch | None:
        """Return a match for the first line of a bag."""
        return FormatMatch("a ROS 1 bag") if read_head(source, 13) == ROS1_MAGIC else None

    def read(self, source: Path, options: ImportOptions) -> MeasuredStreams:
        """Return the IMUs, the poses and the temperature."""
        with parsing_errors(source.name, "repair it with `rosbag reindex`"):
            check_ros1_chunks(source)
            from rosbags.rosbag1 import Reader  # noqa: PLC0415 - an extra

            types: set[str] = set()
            return read_ros_streams(
                _messages(Reader(source), types),
                f"imported from {source.name}: a ROS 1 bag",
                options,
                types,
            )


def _messages(reader: Any, types: set[str]) -> Iterator[RosMessage]:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: PLC0415 - an extra

    store = get_typestore(Stores.ROS1_NOETIC)
    # the list of transforms is not in the library's set of ROS 1; it is one array
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TRANSFORMS))
    with reader:
        types.update(connection.msgtype for connection in reader.connections)
        for connection in reader.connections:
            type_name = _ROS1_TYPES.get(connection.msgtype, connection.msgtype)
            if type_name not in READ_TYPES:
                continue
            # one topic after another: the library unpacks a chunk again when topics alternate
            for _, log_ns, payload in reader.messages(connections=[connection]):
                message = store.deserialize_ros1(payload, type_name)
                yield connection.topic, type_name, log_ns, message


FORMAT = Ros1Bag()
