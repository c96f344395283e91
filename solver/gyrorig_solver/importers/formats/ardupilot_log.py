"""DataFlash logs of ArduPilot (.bin), with one board per gyroscope.

Source: ArduPilot, libraries/AP_InertialSensor/LogStructure.h: GYR (TimeUS, I, SampleUS, GyrX, GyrY,
GyrZ in rad/s) has every sample if INS_LOG_BAT_MASK or raw IMU logging is set; IMT has the delta
angles DelAX, DelAY, DelAZ in rad over DelaT in s; IMU has GyrX, GyrY, GyrZ, AccX, AccY, AccZ and
the temperature T. Before version 4.0 the instance is part of the name: GYR1, IMU2, IMT3. The
attitudes ATT, AHR2 and XKQ come from the flight controller's filter, which uses the same gyros.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray
from gyrorig_solver.importers.dataflash_log import HEAD, read_dataflash
from gyrorig_solver.importers.flight_boards import RateSource, choose_source, name_boards
from gyrorig_solver.importers.measured_streams import (
    AccelStream,
    GyroStream,
    MeasuredBoard,
    MeasuredStreams,
    PoseStream,
    TemperatureStream,
)
from gyrorig_solver.importers.measurement_format import (
    BOARD_OPTIONS,
    FormatMatch,
    ImportOptions,
    read_head,
)

_OLD_INSTANCES = {"": 0, "1": 0, "2": 1, "3": 2}
_KINDS = ("GYR", "IMT", "IMU", "ACC")
_WANTED = frozenset(
    {f"{kind}{suffix}" for kind in _KINDS for suffix in _OLD_INSTANCES} | {"XKQ", "XKQ1", "NKQ1"}
)
_QUATERNIONS = ("XKQ", "XKQ1", "NKQ1")


@dataclass(slots=True)
class _Instance:
    """The streams of one gyroscope."""

    sources: list[RateSource] = field(default_factory=list)
    accels: list[tuple[FloatArray, FloatArray]] = field(default_factory=list)
    temperature: tuple[FloatArray, FloatArray] | None = None


@dataclass(frozen=True, slots=True)
class ArdupilotLog:
    """The gyroscopes of one flight controller."""

    name: str = "dataflash"
    title: str = "ArduPilot DataFlash log (.bin)"
    extra: str = ""
    used_options: frozenset[str] = BOARD_OPTIONS | {"topics"}

    def detect(self, source: Path) -> FormatMatch | None:
        """Return a match for a file that begins with an FMT message."""
        if read_head(source, 4)[:3] != HEAD + b"\x80":
            return None
        return FormatMatch("an ArduPilot DataFlash log")

    def read(self, source: Path, options: ImportOptions) -> MeasuredStreams:
        """Return one board per gyroscope; `--topic XKQ` uses the flight controller's attitude."""
        topics = frozenset(topic.upper() for topic in options.topics)
        replace(options, topics=tuple(topics)).check_topics((*_KINDS, *_QUATERNIONS))
        log = read_dataflash(source, _WANTED)
        instances = _instances(log.columns)
        notes: list[str] = []
        if log.skipped_bytes:
            notes.append(f"{log.skipped_bytes} bytes of the log are damaged and were left out")
        boards = []
        for number, instance in sorted(instances.items()):
            chosen = choose_source(
                [s for s in instance.sources if not topics & set(_KINDS) or s.name in topics],
                notes, f"gyroscope {number}",
            )  # fmt: skip
            if chosen is not None:
                boards.append(_board(number, chosen, instance, options))
        if not boards:
            listed = ", ".join(log.known)[:200]
            raise InputError(
                f"the log {source.name} contains no messages of a gyroscope (GYR, IMT or IMU), "
                f"but only {listed}",
                "set LOG_BITMASK with IMU or raw IMU on the flight controller, and record again",
            )
        poses = _poses(log.columns, topics, notes)
        return MeasuredStreams(
            f"imported from {source.name}: DataFlash log of ArduPilot",
            name_boards(boards, options.board, "GYRO"),
            poses=poses,
            notes=tuple(notes),
        )


def _instances(columns: dict[str, dict[str, FloatArray]]) -> dict[int, _Instance]:
    instances: dict[int, _Instance] = {}
    for name, message in columns.items():
        kind = name[:3]
        if kind not in _KINDS or "TimeUS" not in message:
            continue
        if "I" in message:
            numbers = message["I"].astype(np.int64)
            for number in np.unique(numbers).tolist():
                rows = numbers == number
                part = {key: values[rows] for key, values in message.items()}
                _add(instances.setdefault(number, _Instance()), kind, part)
        elif name[3:] in _OLD_INSTANCES:
            _add(instances.setdefault(_OLD_INSTANCES[name[3:]], _Instance()), kind, message)
    return instances


def _add(instance: _Instance, kind: str, message: dict[str, FloatArray]) -> None:
    time_s = message.get("SampleUS", message["TimeUS"]) * 1e-6
    if kind == "IMT" and {"DelaT", "DelAX", "DelAY", "DelAZ"} <= message.keys():
        step_s = message["DelaT"]
        with np.errstate(divide="ignore", invalid="ignore"):
            rates = _stacked(message, "DelA") / step_s[:, None]
        instance.sources.append(RateSource("IMT", time_s, rates))
    elif kind in ("GYR", "IMU") and {"GyrX", "GyrY", "GyrZ"} <= message.keys():
        instance.sources.append(RateSource(kind, time_s, _stacked(message, "Gyr")))
    if kind in ("ACC", "IMU") and {"AccX", "AccY", "AccZ"} <= message.keys():
        instance.accels.append((time_s, _stacked(message, "Acc")))
    if kind == "IMU":
        degc = message.get("T", message.get("Temp"))
        instance.temperature = None if degc is None else (time_s, degc)


def _stacked(message: dict[str, FloatArray], prefix: str) -> FloatArray:
    return np.stack([message[f"{prefix}{axis}"] for axis in "XYZ"], axis=1)


def _board(
    number: int, chosen: RateSource, instance: _Instance, options: ImportOptions
) -> MeasuredBoard:
    accel = max(instance.accels, key=lambda pair: pair[0].size, default=None)
    return MeasuredBoard(
        str(number),
        GyroStream(chosen.time_s, chosen.rate_rad_s),
        None if accel is None else AccelStream(accel[1], accel[0]),
        None
        if instance.temperature is None
        else TemperatureStream(instance.temperature[1], instance.temperature[0]),
        {"sensor": options.sensor or "unknown", "model": "ArduPilot"},
    )


def _poses(
    columns: dict[str, dict[str, FloatArray]], topics: frozenset[str], notes: list[str]
) -> PoseStream | None:
    name = next((name for name in _QUATERNIONS if name in columns), None)
    if name is None:
        return None
    if not topics & set(_QUATERNIONS):
        notes.append(
            f"the attitude {name} is not used as a reference, because the flight controller "
            f"computes it from the same gyroscopes (--topic {name} uses it)"
        )
        return None
    message = columns[name]
    rows = message["C"] == message["C"][0] if "C" in message else slice(None)
    values = np.stack([message[key][rows] for key in ("Q2", "Q3", "Q4", "Q1")], axis=1)
    notes.append(f"the reference {name} is computed from the same gyroscopes")
    return PoseStream.of_rows(message["TimeUS"][rows] * 1e-6, values)


FORMAT = ArdupilotLog()
