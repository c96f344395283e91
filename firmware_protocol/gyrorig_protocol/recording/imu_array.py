"""Many `ImuRaw` payloads at once, from arrays.

What to use when: under `RecordingWriter.write_imu_array`; the layout is the one that
`cdr` derives from the schema, so there is no second description of it.
"""

import numpy as np
import numpy.typing as npt

from gyrorig_protocol.recording.cdr import fixed_layout
from gyrorig_protocol.recording.cdr_stream import ENCAPSULATION, NS_PER_S
from gyrorig_protocol.recording.schemas import IMU_RAW

IntArray = npt.NDArray[np.integer]


def pack_imu(
    *,
    host_time_ns: IntArray,
    device_time: IntArray,
    sequence: IntArray,
    status: IntArray,
    temperature: IntArray,
    gyro: IntArray,
    accel: IntArray | None,
    mag: IntArray | None,
) -> list[bytes]:
    """The payloads of n samples, 64 bytes each; see `RecordingWriter.write_imu_array`.

    Raises:
        ValueError: shapes differ or a value does not fit its field.
    """
    layout = fixed_layout("gyrorig_msgs/msg/ImuRaw", IMU_RAW)
    if layout is None:  # the schema is ours and of fixed size
        raise AssertionError("ImuRaw has no fixed layout")
    n = len(host_time_ns)
    out = np.zeros(n, dtype=layout.dtype)
    host = np.asarray(host_time_ns).astype(np.int64)
    _put(out["host_time"]["sec"], host // NS_PER_S, "host_time")
    out["host_time"]["nanosec"] = host % NS_PER_S
    for name, values in (
        ("device_time", device_time),
        ("sequence", sequence),
        ("status", status),
        ("temperature", temperature),
        ("gyro", gyro),
        ("accel", accel),
        ("mag", mag),
    ):
        if values is not None:
            _put(out[name], np.asarray(values), name)
    whole = np.zeros((n, layout.size), dtype=np.uint8)
    whole[:, :4] = np.frombuffer(ENCAPSULATION, dtype=np.uint8)
    whole[:, 4:] = out.view(np.uint8).reshape(n, layout.dtype.itemsize)
    raw = whole.tobytes()
    return [raw[at : at + layout.size] for at in range(0, len(raw), layout.size)]


def _put(field: npt.NDArray[np.integer], values: IntArray, name: str) -> None:
    if values.shape != field.shape:
        raise ValueError(f"{name} has shape {values.shape}, not {field.shape}")
    if values.dtype.kind not in "iu":
        raise ValueError(f"{name} holds {values.dtype}, not whole numbers")
    bounds = np.iinfo(field.dtype)
    if values.size and (int(values.min()) < bounds.min or int(values.max()) > bounds.max):
        raise ValueError(f"{name} exceeds {field.dtype}")
    field[...] = values
