"""A calibration applied to a recording: a copy of it with a topic of `sensor_msgs/msg/Imu`.

What to use when: `apply_to_recording`. Every sample that can be trusted becomes one message
on `/board/<id>/imu`: its stamp is when the motion was so, by the clock map and the time
offset, its rates are the true ones. Samples that are saturated or repeated become none: they
do not say what the rate was. Everything else of the recording is in the copy as it was.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.adding import AddedTopic, Batch, copy_with
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording
from gyrorig_protocol.recording.sensor_imu import SENSOR_IMU, SENSOR_IMU_TYPE, pack_sensor_imu
from gyrorig_solver.apply.calibration import Calibration
from gyrorig_solver.apply.correction import Correction
from gyrorig_solver.arrays import BoolArray, FloatArray, IntArray
from gyrorig_solver.columns import column_of
from gyrorig_solver.model.terms.temperature import Temperature
from gyrorig_solver.samples import GyroSamples, load_samples

SAMPLES_AT_A_TIME = 1 << 16
_SETTINGS = ("gyro_scale_rad_s", "gyro_full_scale_dps", "bandwidth_hz", "config_hash")


@dataclass(frozen=True, slots=True)
class RecordingApplied:
    """What became of a recording."""

    board: str
    topic: str
    messages: int
    left_out: int  # saturated or repeated samples
    outside: int  # rates that the calibration's recordings did not cover
    outside_warmth: int  # temperatures that they did not cover
    losses: tuple[str, ...]  # damaged parts of the recording that the copy does not have


def apply_to_recording(
    calibration: Calibration, source: Path, out: Path, board: str | None = None
) -> RecordingApplied:
    """Write a copy of a recording with the board's true rates in it.

    Args:
        calibration: to apply.
        source: the recording.
        out: the copy; must not exist.
        board: in the recording; the calibration's own by default.

    Raises:
        InputError: `source` is no recording, does not hold the board, or the board was
            set otherwise than when it was calibrated.
        UsageError: `out` exists, or the calibration asks for what was not recorded.
        MachineError: the disk refused; nothing is left.
    """
    recording = read_recording(source)
    name = _board(calibration, recording, board)
    _check_settings(calibration, recording, name)
    samples = load_samples(recording, name)
    if calibration.correction.needs_temperature and samples.temperature is None:
        raise UsageError(
            f"{source.name} lacks the board's temperature, on which the calibration depends",
            "record the board's thermometer, or solve without thermal_bias and thermal_scale",
        )
    if calibration.correction.needs_force and column_of(samples, "accel_m_s2") is None:
        raise UsageError(
            f"{source.name} has no accelerometer, on which the calibration depends",
            "record the board's accelerometer, or solve without g_sensitivity",
        )
    work = _Work(calibration, samples)
    topic = f"/board/{name}/imu"
    added = AddedTopic(topic, SENSOR_IMU_TYPE, SENSOR_IMU, work.batches())
    copied = copy_with(source, out, {f"gyrorig.applied.{name}": _about(calibration)}, [added])
    return RecordingApplied(
        board=str(name),
        topic=topic,
        messages=copied.added[topic],
        left_out=int(np.count_nonzero(~samples.good)),
        outside=work.outside,
        outside_warmth=work.outside_warmth,
        losses=tuple(loss.text for loss in copied.losses),
    )


def _board(calibration: Calibration, recording: Recording, wanted: str | None) -> BoardId:
    name = wanted or calibration.board
    if name not in recording.board_ids:
        there = ", ".join(recording.board_ids) or "none"
        raise InputError(
            f"{recording.path.name} does not hold {name}",
            f"in it: {there}; name one with --board, if it is the same board",
        )
    return BoardId(name)


def _check_settings(calibration: Calibration, recording: Recording, board: BoardId) -> None:
    """Refuse a board that was set otherwise: other counts, another lag.

    Raises:
        InputError: it was.
    """
    there = recording.metadata.get(f"gyrorig.board.{board}", {})
    for key in _SETTINGS:
        wanted, said = getattr(calibration.document.board.config, key), there.get(key)
        if wanted is None or said is None:
            continue
        try:
            same = said == wanted if isinstance(wanted, str) else float(said) == wanted
        except ValueError:
            same = False
        if not same:
            raise InputError(
                f"{recording.path.name} has {board} with {key} {said[:40]}, the calibration is for "
                f"{wanted}",
                "a calibration holds for one setting: calibrate in this one",
            )


def _about(calibration: Calibration) -> dict[str, str]:
    """Return what the copy says of the calibration that made the topic."""
    found, offset = calibration.document, calibration.time_offset_s
    return {
        "board": found.board.id,
        "version": str(found.version),
        "calibration": calibration.digest,
        "frame": calibration.frame,
        "unit": "rad/s",
        "time_offset_s": "" if offset is None else repr(offset),
        "not_applied": "; ".join(calibration.not_applied),
    }


class _Work:
    """Samples on their way to messages, some at a time; counts what a person should know."""

    def __init__(self, calibration: Calibration, samples: GyroSamples) -> None:
        self._calibration, self._samples = calibration, samples
        validity = calibration.document.validity
        self._limit_rad_s = max(abs(bound) for bound in validity.rate_rad_s)
        self._warmth_degc = validity.temperature_degc
        self.outside = self.outside_warmth = 0
        turn = np.array(calibration.document.matrices.M, dtype=np.float64)
        known = bool(np.all(np.isfinite(turn))) and calibration.frame == "stage"
        self._turn = turn if known else np.eye(3)
        self._covariance = _covariance(calibration)
        self._die = _die(samples, calibration.correction)
        self._frame_id = f"{samples.board}/{calibration.frame}"

    def batches(self) -> Iterator[Batch]:
        """Yield the messages, in the order of their arrival."""
        host = column_of(self._samples, "host_s")
        if host is None:
            raise AssertionError("samples without arrivals")
        arrival_ns = host.counts
        for start in range(0, self._samples.number.size, SAMPLES_AT_A_TIME):
            rows = slice(start, start + SAMPLES_AT_A_TIME)
            good = self._samples.good[rows]
            if good.any():
                arrived = arrival_ns[rows][good].astype(np.int64) + self._samples.origin_ns
                yield self._batch(rows, good, arrived)

    def _batch(self, rows: slice, good: BoolArray, arrived_ns: IntArray) -> Batch:
        samples, calibration = self._samples, self._calibration
        force = column_of(samples, "accel_m_s2")
        force_m_s2 = None if force is None else force.values(rows)[good]
        warmth = samples.temperature
        degc = None if warmth is None else warmth.values(rows)[good]
        die = None
        if self._die is not None:
            correction = calibration.correction
            die = self._die.at(samples.time_s[rows][good], correction.lag_s)
            die += correction.reference_degc
        rates = calibration.correction.rates(
            samples.counts[rows][good], samples.quantum_rad_s, die, force_m_s2
        )
        self.outside += int(np.sum(np.abs(rates).max(axis=1) > self._limit_rad_s))
        if degc is not None and self._warmth_degc is not None and samples.absolute_degc:
            low, high = self._warmth_degc
            self.outside_warmth += int(np.sum((degc < low) | (degc > high)))
        offset_ns = round(1e9 * (calibration.time_offset_s or 0.0))
        since_ns = np.rint(samples.time_s[rows][good] * 1e9).astype(np.int64)
        stamp_ns = samples.origin_ns + since_ns - offset_ns
        payloads = pack_sensor_imu(
            np.maximum(stamp_ns, 0),  # a message cannot tell of a time before its zero
            self._frame_id,
            rates,
            self._covariance,
            None if force_m_s2 is None else force_m_s2 @ self._turn,
        )
        return Batch(arrived_ns, np.maximum(stamp_ns, 0), payloads)


def _die(samples: GyroSamples, correction: Correction) -> Temperature | None:
    """Return the board's temperature as the fit saw it, smooth; None where none is needed.

    Raises:
        InputError: the recording has too few readings of it.
    """
    readings = samples.temperature_degc if correction.needs_temperature else None
    if readings is None:
        return None
    found = Temperature.of(samples.time_s, readings, correction.reference_degc)
    if found is None:
        raise InputError(
            f"the recording has too few temperatures of {samples.board}, on which the calibration "
            "depends",
            "record the board's thermometer, or solve without thermal_bias and thermal_scale",
        )
    return found


def _covariance(calibration: Calibration) -> FloatArray:
    """Return the covariance of one rate's white noise over the band; zeros where unknown."""
    found = calibration.document.noise.get("angle_random_walk")
    config = calibration.document.board.config
    band_hz = config.bandwidth_hz or (config.odr_hz and config.odr_hz / 2.0)
    if found is None or band_hz is None or any(v is None for v in found.value):
        return np.zeros((3, 3))
    density = np.array(found.value, dtype=np.float64)
    inverse = calibration.correction.inverse
    return np.asarray(inverse @ np.diag(density**2 * band_hz) @ inverse.T, dtype=np.float64)
