"""Encode arrays of calibrated rates as `sensor_msgs/msg/Imu` payloads for ROS programs.

What to use when: `pack_sensor_imu` for the payloads of one frame; the schema is
`SENSOR_IMU_SCHEMA`. All payloads of a frame have the same size, because its name has.

Source: sensor_msgs/msg/Imu of ROS 2. A covariance that begins with -1 means that the quantity was
not measured; zeros mean that its covariance is unknown.
"""

import numpy as np
import numpy.typing as npt

from gyrorig_protocol.recording.encoding.cdr_codec import ENCAPSULATION, NS_PER_S
from gyrorig_protocol.recording.encoding.message_schemas import SEPARATOR

SENSOR_IMU_TYPE = "sensor_msgs/msg/Imu"
_DEFINITIONS = {
    "": "std_msgs/Header header\n"
    "geometry_msgs/Quaternion orientation\n"
    "float64[9] orientation_covariance\n"
    "geometry_msgs/Vector3 angular_velocity\n"
    "float64[9] angular_velocity_covariance\n"
    "geometry_msgs/Vector3 linear_acceleration\n"
    "float64[9] linear_acceleration_covariance\n",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
    "geometry_msgs/Quaternion": "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
}
SENSOR_IMU_SCHEMA = f"{SEPARATOR}\n".join(
    body if not name else f"MSG: {name}\n{body}" for name, body in _DEFINITIONS.items()
)
COVARIANCE_NOT_MEASURED = -1.0

FloatArray = npt.NDArray[np.float64]


def pack_sensor_imu(
    timestamp_ns: npt.NDArray[np.int64],
    frame_id: str,
    rate_rad_s: FloatArray,
    rate_covariance: FloatArray,
    force_m_s2: FloatArray | None,
) -> npt.NDArray[np.uint8]:
    """Return the payloads of n messages, shape (n, bytes of one message).

    Args:
        timestamp_ns: times of the samples, capture clock, shape (n,).
        frame_id: the frame of all messages.
        rate_rad_s: shape (n, 3).
        rate_covariance: covariance of all rates, shape (3, 3); zeros if unknown.
        force_m_s2: specific force, shape (n, 3); None if not measured, and a row that is not finite
            if it was not measured in this sample.

    Raises:
        ValueError: a timestamp does not fit a message.
    """
    if timestamp_ns.size and not 0 <= int(timestamp_ns.min()) <= int(timestamp_ns.max()) < (
        NS_PER_S << 31
    ):
        raise ValueError("a timestamp is outside the range of a message")
    frame_name = frame_id.encode() + b"\0"
    numbers_offset = -(-(12 + len(frame_name)) // 8) * 8  # of the doubles, counted after the header
    payload_dtype = np.dtype(
        {
            "names": ["head", "sec", "nanosec", "length", "name", "numbers"],
            "formats": ["V4", "<i4", "<u4", "<u4", f"V{len(frame_name)}", ("<f8", (37,))],
            "offsets": [0, 4, 8, 12, 16, 4 + numbers_offset],
            "itemsize": 4 + numbers_offset + 37 * 8,
        }
    )
    payloads = np.zeros(timestamp_ns.size, dtype=payload_dtype)
    payloads["head"] = np.void(ENCAPSULATION)
    payloads["sec"], payloads["nanosec"] = timestamp_ns // NS_PER_S, timestamp_ns % NS_PER_S
    payloads["length"], payloads["name"] = len(frame_name), np.void(frame_name)
    numbers = payloads["numbers"]
    numbers[:, 3] = 1.0  # the orientation is not measured
    numbers[:, 4] = COVARIANCE_NOT_MEASURED
    numbers[:, 13:16] = rate_rad_s
    numbers[:, 16:25] = rate_covariance.reshape(9)
    if force_m_s2 is None:
        numbers[:, 28] = COVARIANCE_NOT_MEASURED
    else:
        is_measured: npt.NDArray[np.bool_] = np.all(np.isfinite(force_m_s2), axis=1)
        numbers[:, 25:28] = np.where(is_measured[:, None], force_m_s2, 0.0)
        numbers[~is_measured, 28] = COVARIANCE_NOT_MEASURED
    return payloads.view(np.uint8).reshape(timestamp_ns.size, payload_dtype.itemsize)
