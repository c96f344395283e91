"""`sensor_msgs/msg/Imu`, many messages at once: calibrated rates as ROS programs take them.

What to use when: `pack_sensor_imu` for the payloads of one frame; `SENSOR_IMU` is the schema.
All payloads of one frame have one size, because the frame's name has.

Source: sensor_msgs/msg/Imu of ROS 2, whose comments say what -1 in a covariance means (there
is no such measurement) and what zeros mean (its covariance is not known).
"""

import numpy as np
import numpy.typing as npt

from gyrorig_protocol.recording.cdr_stream import ENCAPSULATION, NS_PER_S
from gyrorig_protocol.recording.schemas import SEPARATOR

SENSOR_IMU_TYPE = "sensor_msgs/msg/Imu"
_PARTS = {
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
SENSOR_IMU = f"{SEPARATOR}\n".join(
    body if not name else f"MSG: {name}\n{body}" for name, body in _PARTS.items()
)
NO_MEASUREMENT = -1.0

FloatArray = npt.NDArray[np.float64]


def pack_sensor_imu(
    stamp_ns: npt.NDArray[np.int64],
    frame_id: str,
    rate_rad_s: FloatArray,
    rate_covariance: FloatArray,
    force_m_s2: FloatArray | None,
) -> npt.NDArray[np.uint8]:
    """Return the payloads of n messages, shape (n, bytes of one).

    Args:
        stamp_ns: when the motion was so, capture time, shape (n,).
        frame_id: of all of them.
        rate_rad_s: shape (n, 3).
        rate_covariance: of all of them, shape (3, 3); zeros where it is not known.
        force_m_s2: specific force, shape (n, 3); None where it was not measured.

    Raises:
        ValueError: a stamp does not fit a message.
    """
    if stamp_ns.size and not 0 <= int(stamp_ns.min()) <= int(stamp_ns.max()) < (NS_PER_S << 31):
        raise ValueError("a stamp is outside what a message can hold")
    name = frame_id.encode() + b"\0"
    begin = -(-(12 + len(name)) // 8) * 8  # of the doubles, counted behind the header
    kind = np.dtype(
        {
            "names": ["head", "sec", "nanosec", "length", "name", "numbers"],
            "formats": ["V4", "<i4", "<u4", "<u4", f"V{len(name)}", ("<f8", (37,))],
            "offsets": [0, 4, 8, 12, 16, 4 + begin],
            "itemsize": 4 + begin + 37 * 8,
        }
    )
    out = np.zeros(stamp_ns.size, dtype=kind)
    out["head"] = np.void(ENCAPSULATION)
    out["sec"], out["nanosec"] = stamp_ns // NS_PER_S, stamp_ns % NS_PER_S
    out["length"], out["name"] = len(name), np.void(name)
    numbers = out["numbers"]
    numbers[:, 3] = 1.0  # an orientation that nothing measured
    numbers[:, 4] = NO_MEASUREMENT
    numbers[:, 13:16] = rate_rad_s
    numbers[:, 16:25] = rate_covariance.reshape(9)
    if force_m_s2 is None:
        numbers[:, 28] = NO_MEASUREMENT
    else:
        numbers[:, 25:28] = force_m_s2
    return out.view(np.uint8).reshape(stamp_ns.size, kind.itemsize)
