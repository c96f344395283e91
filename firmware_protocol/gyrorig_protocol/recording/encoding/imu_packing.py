"""Encode arrays of samples as `ImuRaw` payloads.

What to use when: only in `RecordingWriter.write_imu_array`. The layout is derived from the schema.
"""

import numpy as np
import numpy.typing as npt

from gyrorig_protocol.recording.encoding.cdr_codec import ENCAPSULATION, NS_PER_S
from gyrorig_protocol.recording.encoding.message_layouts import FIXED_LAYOUTS

IntArray = npt.NDArray[np.integer]


def pack_imu_payloads(
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
    """Return the payloads of n samples, 64 bytes each; see `RecordingWriter.write_imu_array`.

    Raises:
        ValueError: shapes differ or a value does not fit its field.
    """
    layout = FIXED_LAYOUTS["gyrorig_msgs/msg/ImuRaw"]
    sample_count = len(host_time_ns)
    records = np.zeros(sample_count, dtype=layout.dtype)
    host_ns = np.asarray(host_time_ns).astype(np.int64)
    _fill_field(records["host_time"]["sec"], host_ns // NS_PER_S, "host_time")
    records["host_time"]["nanosec"] = host_ns % NS_PER_S
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
            _fill_field(records[name], np.asarray(values), name)
    payloads = np.zeros((sample_count, layout.size_bytes), dtype=np.uint8)
    payloads[:, :4] = np.frombuffer(ENCAPSULATION, dtype=np.uint8)
    payloads[:, 4:] = records.view(np.uint8).reshape(sample_count, layout.dtype.itemsize)
    payload_bytes = payloads.tobytes()
    return [
        payload_bytes[start : start + layout.size_bytes]
        for start in range(0, len(payload_bytes), layout.size_bytes)
    ]


def _fill_field(field: npt.NDArray[np.integer], values: IntArray, name: str) -> None:
    if values.shape != field.shape:
        raise ValueError(f"{name} has shape {values.shape}, not {field.shape}")
    if values.dtype.kind not in "iu":
        raise ValueError(f"{name} holds {values.dtype}, not whole numbers")
    bounds = np.iinfo(field.dtype)
    if values.size and (int(values.min()) < bounds.min or int(values.max()) > bounds.max):
        raise ValueError(f"{name} exceeds {field.dtype}")
    field[...] = values
