"""The gyroscopes of a PX4 log, and the messages that have the rates of each.

What to use when: `rate_sources` for the gyroscopes; `processing_notes` for what PX4 did to the
rates of a message.

The gyroscope of a message is that of its device id, because the instances of the messages need not
have the same order. sensor_combined has no device id: its gyroscope is that which PX4 selects.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.importers.flight_boards import MIN_RATE_SHARE, MIN_SAMPLES, RateSource

GYROS = ("sensor_gyro", "vehicle_imu", "sensor_combined")
SELECTION = "sensor_selection"

Topic = tuple[int, dict[str, Any]]  # instance, columns by the names of the fields


@dataclass(slots=True, eq=False)
class Px4Gyroscope:
    """One gyroscope, and the messages with its rates, the least processed first."""

    name: str
    device_id: int = 0  # 0: unknown
    instance: int | None = None  # of its sensor_gyro and sensor_accel, None if not known
    sources: list[RateSource] = field(default_factory=list)


def rate_sources(
    topics: Mapping[str, Sequence[Topic]], wanted: frozenset[str], notes: list[str]
) -> list[Px4Gyroscope]:
    """Return the gyroscopes of a log, in the order of their names.

    Args:
        topics: of the log, by name.
        wanted: the names of messages that a person chose.
        notes: texts for a reader; may be appended to.
    """
    names = [name for name in GYROS if name in wanted] or list(GYROS)
    gyroscopes: list[Px4Gyroscope] = []
    for instance, columns in topics.get("sensor_gyro", []):
        device_id = _only_id(columns.get("device_id"))
        gyroscopes.append(Px4Gyroscope(str(instance), device_id, instance))
        _add_source(gyroscopes[-1], "sensor_gyro", columns, names)
    for instance, columns in topics.get("vehicle_imu", []):
        gyroscope = _of_vehicle_imu(gyroscopes, instance, _only_id(columns.get("gyro_device_id")))
        _add_source(gyroscope, "vehicle_imu", columns, names)
    for _, columns in topics.get("sensor_combined", [])[:1]:
        selected = _only_id(dict(topics.get(SELECTION, [])).get(0, {}).get("gyro_device_id"))
        known = [g for g in gyroscopes if selected and g.device_id == selected]
        gyroscope = known[0] if known else Px4Gyroscope("combined", selected)
        _add_source(gyroscope, "sensor_combined", columns, names)
        if not known:
            gyroscopes = _add_unknown(gyroscopes, gyroscope, notes)
    return sorted((g for g in gyroscopes if g.sources), key=lambda g: g.name)


def processing_notes(gyroscope: str, message: str) -> list[str]:
    """Return a note if PX4 processed the rates of a message."""
    if message == "sensor_gyro":
        return []
    return [
        f"gyroscope {gyroscope}: PX4 has already corrected the rates of {message} with its own "
        "calibration, and has rotated them to the body frame"
    ]


def _add_unknown(
    gyroscopes: list[Px4Gyroscope], combined: Px4Gyroscope, notes: list[str]
) -> list[Px4Gyroscope]:
    """Return the gyroscopes with sensor_combined if it is faster than all others.

    It is a copy of one of them, so it is needed only if PX4 logged the others slowly.
    """
    if not combined.sources:
        return gyroscopes
    combined_hz = _fastest_hz(combined)
    rates_hz = [_fastest_hz(g) for g in gyroscopes]
    if rates_hz and max(rates_hz) >= MIN_RATE_SHARE * combined_hz:
        return gyroscopes
    for slow, rate_hz in zip(gyroscopes, rates_hz, strict=True):
        if slow.sources:
            notes.append(
                f"gyroscope {slow.name}: {slow.sources[0].name} was logged with only "
                f"{rate_hz:.3g} Hz, so it is left out"
            )
    notes.append(
        "the log does not show which gyroscope has the rates of sensor_combined, so their board "
        "has no temperature and no accelerometer" + ("" if combined.device_id else ", and no uid")
    )
    return [combined]


def _of_vehicle_imu(gyroscopes: list[Px4Gyroscope], instance: int, device_id: int) -> Px4Gyroscope:
    """Return the gyroscope of a vehicle_imu; appends it if the log has no other message of it."""
    same = [g for g in gyroscopes if device_id and g.device_id == device_id]
    if same:
        return same[0]
    at_instance = [g for g in gyroscopes if g.instance == instance]
    if at_instance and not (device_id and at_instance[0].device_id):
        return at_instance[0]
    name = f"{instance}-imu" if at_instance else str(instance)
    gyroscopes.append(Px4Gyroscope(name, device_id, None if at_instance else instance))
    return gyroscopes[-1]


def _only_id(values: Any) -> int:
    """Return the device id of all rows, 0 if it is unknown or changes."""
    ids = np.unique(np.asarray([] if values is None else values))
    ids = ids[ids > 0]
    return int(ids[0]) if ids.size == 1 else 0


def _fastest_hz(gyroscope: Px4Gyroscope) -> float:
    ordered = [source.in_order() for source in gyroscope.sources]
    return max((s.rate_hz for s in ordered if s.time_s.size >= MIN_SAMPLES), default=0.0)


def _add_source(
    gyroscope: Px4Gyroscope, name: str, columns: dict[str, Any], names: Sequence[str]
) -> None:
    rates = _rates(name, columns) if name in names else None
    if rates is not None:
        gyroscope.sources.append(RateSource(name, time_s_of(columns), rates))


def time_s_of(columns: Mapping[str, Any]) -> FloatArray:
    """Return the times of a message in s, those of sampling if it has them."""
    sampled = columns.get("timestamp_sample")
    is_used = sampled is not None and np.any(sampled)
    return np.asarray(sampled if is_used else columns["timestamp"], dtype=np.float64) * 1e-6


def triple(columns: Mapping[str, Any], names: tuple[str, str, str]) -> FloatArray | None:
    """Return three fields of a message, shape (n, 3), None if it lacks one."""
    if any(name not in columns for name in names):
        return None
    with np.errstate(invalid="ignore"):  # of a nan that is signalling
        return np.stack([np.asarray(columns[name], dtype=np.float64) for name in names], axis=1)


def _rates(name: str, columns: Mapping[str, Any]) -> FloatArray | None:
    """Return the rates of a message in rad/s."""
    if name == "sensor_gyro":
        return triple(columns, ("x", "y", "z"))
    if name == "sensor_combined":
        return triple(columns, ("gyro_rad[0]", "gyro_rad[1]", "gyro_rad[2]"))
    angle = triple(columns, ("delta_angle[0]", "delta_angle[1]", "delta_angle[2]"))
    step_us = columns.get("delta_angle_dt")
    if angle is None or step_us is None:
        return None
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(angle / (np.asarray(step_us, np.float64)[:, None] * 1e-6))
