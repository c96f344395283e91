"""Applying a calibration to a recording: a copy with a topic of `sensor_msgs/msg/Imu`.

What to use when: `apply_to_recording`. Every usable sample becomes one message on
`/board/<id>/imu`. Its timestamp is the time of the motion, by the clock map and the time
offset; its rates are the true rates. Saturated and repeated samples are left out. All other
data of the recording are copied unchanged.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.encoding.sensor_imu_packing import (
    SENSOR_IMU_SCHEMA,
    SENSOR_IMU_TYPE,
    pack_sensor_imu,
)
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording
from gyrorig_protocol.recording.recording_copy import MessageBatch, NewTopic, copy_with_topics
from gyrorig_protocol.suggestions import list_closest
from gyrorig_solver.apply.board_calibration import Calibration
from gyrorig_solver.apply.correction import Correction
from gyrorig_solver.data import BoolArray, FloatArray, IntArray
from gyrorig_solver.data.count_columns import stored_column
from gyrorig_solver.data.samples import GyroSamples, load_samples
from gyrorig_solver.model import BoardTemperature
from gyrorig_solver.model.board_temperature import MIN_READINGS

SAMPLES_PER_BATCH = 1 << 16
_BOARD_SETTINGS = (
    "odr_hz",
    "gyro_scale_rad_s",
    "gyro_full_scale_dps",
    "bandwidth_hz",
    "config_hash",
)


@dataclass(frozen=True, slots=True)
class RecordingSummary:
    """Counts of what was written and left out."""

    board: str
    topic: str
    messages: int
    left_out: int  # saturated or repeated samples
    outside: int  # rates above the range of the calibration's recordings
    outside_warmth: int  # temperatures outside their range, of a constant bias
    outside_temperature: int  # samples left out: outside the range of a bias with temperature
    losses: tuple[str, ...]  # damaged parts of the recording, missing in the copy
    other_uid: str | None = None  # of the board, if it is not that of the calibration
    without_force: int = 0  # samples left out: without the acceleration that the correction needs


def apply_to_recording(
    calibration: Calibration, source: Path, out: Path, board: str | None = None
) -> RecordingSummary:
    """Write a copy of a recording with the true rates of a board added.

    Args:
        calibration: to apply.
        source: the recording.
        out: the copy; must not exist.
        board: in the recording; by default the board of the calibration.

    Raises:
        InputError: `source` is no recording, does not hold the board, or the board was
            configured differently when it was calibrated, or has another uid and was not named.
        UsageError: `out` exists, or a needed quantity was not recorded.
        MachineError: the disk cannot be written; no file remains.
    """
    recording = read_recording(source)
    name = _choose_board(calibration, recording, board)
    other_uid = _other_uid(calibration, recording, name)
    if other_uid is not None and board is None:
        raise InputError(
            f"the calibration is of board {name} with the uid "
            f"{calibration.document.board.uid[:40]!r}, but in {recording.path.name} this board has "
            f"the uid {other_uid[:40]!r}",
            f"calibrate this board, or use the calibration for it with --board {name}",
        )
    _check_settings(calibration, recording, name)
    samples = load_samples(recording, name)
    if calibration.correction.needs_temperature and samples.temperature is None:
        raise UsageError(
            f"the calibration depends on the temperature of the board, but {source.name} "
            "does not contain temperatures",
            "record the board's thermometer, or solve the board again with `--extend none`",
        )
    if calibration.correction.needs_force and stored_column(samples, "accel_m_s2") is None:
        raise UsageError(
            f"the calibration depends on the acceleration, but {source.name} does not "
            "contain accelerometer data",
            "record the board's accelerometer, or solve the board again with `--extend none`",
        )
    builder = _MessageBuilder(calibration, samples)
    topic = f"/board/{name}/imu"
    added = NewTopic(topic, SENSOR_IMU_TYPE, SENSOR_IMU_SCHEMA, builder.batches())
    copied = copy_with_topics(
        source, out, {f"gyrorig.applied.{name}": _provenance(calibration)}, [added]
    )
    return RecordingSummary(
        board=str(name),
        topic=topic,
        messages=copied.added[topic],
        left_out=int(np.count_nonzero(~samples.usable)),
        outside=builder.rates_outside,
        outside_warmth=builder.temperatures_outside,
        outside_temperature=builder.left_out,
        losses=tuple(loss.text for loss in copied.losses),
        other_uid=other_uid,
        without_force=builder.without_force,
    )


def _choose_board(calibration: Calibration, recording: Recording, wanted: str | None) -> BoardId:
    name = wanted or calibration.board
    if name not in recording.board_ids:
        board_names = list_closest(name, recording.board_ids) or "none"
        raise InputError(
            f"{recording.path.name} does not contain board {name}, but only {board_names}",
            "if the same board has another name in the recording, give this name with --board",
        )
    return BoardId(name)


def _other_uid(calibration: Calibration, recording: Recording, board: BoardId) -> str | None:
    """Return the uid of the recorded board, None if it can be that of the calibration."""
    uid = recording.metadata.get(f"gyrorig.board.{board}", {}).get("uid", "")
    return uid if calibration.document.board.has_other_uid(uid) else None


def _check_settings(calibration: Calibration, recording: Recording, board: BoardId) -> None:
    """Check that the board has the settings that it was calibrated with.

    Raises:
        InputError: a setting differs.
    """
    metadata = recording.metadata.get(f"gyrorig.board.{board}", {})
    for key in _BOARD_SETTINGS:
        calibrated, recorded = getattr(calibration.document.board.config, key), metadata.get(key)
        if calibrated is None or recorded is None:
            continue
        try:
            same = (
                recorded == calibrated
                if isinstance(calibrated, str)
                else float(recorded) == calibrated
            )
        except ValueError:
            same = False
        if not same:
            raise InputError(
                f"the calibration is for the setting {key} = {calibrated}, but in "
                f"{recording.path.name} board {board} has {key} = {recorded[:40]}",
                "calibrate the board with the setting of the recording",
            )


def _provenance(calibration: Calibration) -> dict[str, str]:
    """Return the metadata on the calibration that was applied."""
    document, offset = calibration.document, calibration.time_offset_s
    return {
        "board": document.board.id,
        "version": str(document.version),
        "calibration": calibration.digest,
        "frame": calibration.frame,
        "unit": "rad/s",
        "time_offset_s": "" if offset is None else repr(offset),
        "not_applied": "; ".join(calibration.not_applied),
    }


class _MessageBuilder:
    """Makes batches of messages from samples, and counts values outside the valid range."""

    def __init__(self, calibration: Calibration, samples: GyroSamples) -> None:
        self._calibration, self._samples = calibration, samples
        validity = calibration.document.validity
        self._limit_rad_s = max(abs(bound) for bound in validity.rate_rad_s)
        self._temperature_range_degc = validity.temperature_degc
        self.rates_outside = self.temperatures_outside = 0
        misalignment = np.array(calibration.document.matrices.M, dtype=np.float64)
        known = bool(np.all(np.isfinite(misalignment))) and calibration.frame == "stage"
        self._misalignment = misalignment if known else np.eye(3)
        self._covariance = _rate_covariance(calibration)
        self._die_temperature = _die_temperature(samples, calibration.correction)
        self._frame_id = f"{samples.board}/{calibration.frame}"
        self._covered = self._valid_temperatures()
        self.left_out = int(np.count_nonzero(~self._covered & samples.usable))
        has_force = self._measured_forces()
        self.without_force = int(np.count_nonzero(~has_force & self._covered & samples.usable))
        self._covered &= has_force

    def _valid_temperatures(self) -> BoolArray:
        """Return which samples were taken at a temperature of the valid range, (n,).

        Raises:
            InputError: none was.
        """
        samples, correction = self._samples, self._calibration.correction
        if self._die_temperature is None:
            return np.ones(samples.time_s.size, dtype=np.bool_)
        rise = self._die_temperature.die_temperature_rise(samples.time_s)
        degc = rise + correction.reference_degc
        covered = correction.covers(degc)
        if not covered.any():
            raise self._calibration.outside_range_error(degc)
        return covered

    def _measured_forces(self) -> BoolArray:
        """Return which samples have the acceleration that the correction needs, (n,)."""
        column = stored_column(self._samples, "accel_m_s2")
        is_needed = self._calibration.correction.needs_force
        if not is_needed or column is None or column.valid is None:
            return np.ones(self._samples.time_s.size, dtype=np.bool_)
        return column.valid

    def batches(self) -> Iterator[MessageBatch]:
        """Yield the messages, in the order of their arrival."""
        host = stored_column(self._samples, "host_s")
        if host is None:
            raise AssertionError("samples without arrivals")
        arrival_ns = host.counts
        for start in range(0, self._samples.number.size, SAMPLES_PER_BATCH):
            rows = slice(start, start + SAMPLES_PER_BATCH)
            good = self._samples.usable[rows] & self._covered[rows]
            if good.any():
                arrived = arrival_ns[rows][good].astype(np.int64) + self._samples.origin_ns
                yield self._batch(rows, good, arrived)

    def _batch(self, rows: slice, good: BoolArray, arrived_ns: IntArray) -> MessageBatch:
        samples, calibration = self._samples, self._calibration
        force = stored_column(samples, "accel_m_s2")
        force_m_s2 = None if force is None else force.values(rows)[good]
        temperature_column = samples.temperature
        temperature_degc = (
            None if temperature_column is None else temperature_column.values(rows)[good]
        )
        die_degc = None
        if self._die_temperature is not None:
            correction = calibration.correction
            die_degc = self._die_temperature.die_temperature_rise(
                samples.time_s[rows][good], correction.lag_s
            )
            die_degc += correction.reference_degc
        rates = calibration.correction.rates(
            samples.counts[rows][good], samples.gyro.scale, die_degc, force_m_s2
        )
        self.rates_outside += int(np.sum(np.abs(rates).max(axis=1) > self._limit_rad_s))
        if (
            temperature_degc is not None
            and die_degc is None
            and self._temperature_range_degc is not None
            and samples.has_absolute_temperature
        ):
            low, high = self._temperature_range_degc
            self.temperatures_outside += int(
                np.sum((temperature_degc < low) | (temperature_degc > high))
            )
        offset_ns = round(1e9 * (calibration.time_offset_s or 0.0))
        since_ns = np.rint(samples.time_s[rows][good] * 1e9).astype(np.int64)
        stamp_ns = samples.origin_ns + since_ns - offset_ns
        payloads = pack_sensor_imu(
            np.maximum(stamp_ns, 0),  # a message cannot hold a time below 0
            self._frame_id,
            rates,
            self._covariance,
            None if force_m_s2 is None else force_m_s2 @ self._misalignment,
        )
        return MessageBatch(arrived_ns, np.maximum(stamp_ns, 0), payloads)


def _die_temperature(samples: GyroSamples, correction: Correction) -> BoardTemperature | None:
    """Return the smoothed temperature of the board, as in the fit; None if not needed.

    Raises:
        InputError: the recording has too few temperature readings.
    """
    readings = samples.temperature_degc if correction.needs_temperature else None
    if readings is None:
        return None
    temperature = BoardTemperature.of(samples.time_s, readings, correction.reference_degc)
    if temperature is None:
        raise InputError(
            f"the calibration depends on the temperature of board {samples.board}, but the "
            f"recording contains fewer than {MIN_READINGS} readings of it",
            "record the board's thermometer during the whole session, or solve the board again "
            "with `--extend none`",
        )
    return temperature


def _rate_covariance(calibration: Calibration) -> FloatArray:
    """Return the covariance of the white noise of one rate sample; zeros if unknown."""
    random_walk = calibration.document.noise.get("angle_random_walk")
    config = calibration.document.board.config
    band_hz = config.bandwidth_hz or (config.odr_hz and config.odr_hz / 2.0)
    if random_walk is None or band_hz is None or any(v is None for v in random_walk.value):
        return np.zeros((3, 3))
    density = np.array(random_walk.value, dtype=np.float64)
    inverse = calibration.correction.inverse
    return np.asarray(inverse @ np.diag(density**2 * band_hz) @ inverse.T, dtype=np.float64)
