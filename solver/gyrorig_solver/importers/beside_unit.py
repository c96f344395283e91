"""Samples of a device with its own clock, dated by the recording of the unit that turned it.

What to use when: `UnitRecording.date_samples` finds the times of a device's samples from the
motion (`phone_clock`); the other methods return what a new recording keeps of the unit's.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.backup_copies import COPY_NAMES as COPIES
from gyrorig_protocol.recording.messages import Message
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.writer import Attachment
from gyrorig_solver.data import FloatArray
from gyrorig_solver.importers.measured_streams import GyroStream
from gyrorig_solver.importers.phone_clock import GRID_S, PhoneClock, find_phone_clock
from gyrorig_solver.importers.sample_encoding import ImuStream

NS = 1_000_000_000
UNIT_MARGIN_S = 2.0  # of the device's samples, before and after the unit's recording


class UnitRecording:
    """A recording of the unit that turned a device.

    Raises:
        InputError: it is no recording of a pan-tilt unit.
    """

    def __init__(self, path: Path) -> None:
        self._unit = read_recording(path)
        if "/ptu/position" not in self._unit.topics:
            raise InputError(
                f"the recording {path.name} contains no data of a pan-tilt unit",
                "give a recording that gyrorigd made with a pan-tilt unit",
            )

    @property
    def start_ns(self) -> int:
        """The time of its first message."""
        return self._unit.start_ns

    def check_name(self, name: BoardId) -> None:
        """Check that a board's name is free.

        Raises:
            UsageError: it is not.
        """
        if str(name) in map(str, self._unit.board_ids):
            raise UsageError(
                f"the phone would get the name {name}, but a board in the recording "
                f"{self._unit.path.name} already has this name",
                "choose another name for the phone with --board",
            )

    def metadata(self, session: str) -> dict[str, dict[str, str]]:
        """Return its metadata, with the name of the new session."""
        records = {key: dict(value) for key, value in self._unit.metadata.items()}
        records["gyrorig"]["session"] = session
        return records

    def attachments(self) -> list[Attachment]:
        """Return its attachments, without the backup copies."""
        return [
            Attachment(attachment.name, attachment.media_type, attachment.data)
            for attachment in self._unit.attachments
            if attachment.name not in COPIES
        ]

    def copied_messages(self) -> list[tuple[int, int, str, Message]]:
        """Return all of its messages, with their times."""
        return [
            (stamped.log_time_ns, stamped.publish_time_ns, topic, stamped.message)
            for topic in self._unit.topics
            for stamped in self._unit.timed_messages(topic)
        ]

    def date_samples(self, imu: ImuStream, gyro: GyroStream) -> tuple[ImuStream, str]:
        """Return the samples near the unit's recording, on its clock, and a note on the clock.

        Raises:
            InputError: the motions differ, or the motion fits at two times.
        """
        since_s = imu.time_s - imu.time_s[0]
        is_finite = np.all(np.isfinite(gyro.values), axis=1)
        clock = self._find_clock(since_s, gyro.values[is_finite] * (gyro.scale_rad_s or 1.0))
        host_ns = self.start_ns + np.rint(clock.capture_s(since_s) * NS).astype(np.int64)
        margin_ns = int(UNIT_MARGIN_S * NS)
        is_near = (host_ns >= max(0, self.start_ns - margin_ns)) & (
            host_ns <= self._unit.end_ns + margin_ns
        )
        keep = slice(int(np.argmax(is_near)), is_near.size - int(np.argmax(is_near[::-1])))
        trimmed = replace(
            imu,
            host_time_ns=host_ns[keep],
            device_time=imu.device_time[keep],
            row=imu.row[keep],
            number=imu.number[keep],
            time_s=imu.time_s[keep],
            status=imu.status[keep],
            temperature=imu.temperature[keep],
            gyro=imu.gyro[keep],
            accel=None if imu.accel is None else imu.accel[keep],
        )
        return trimmed, _clock_note(clock)

    def _find_clock(self, since_s: FloatArray, rate_rad_s: FloatArray) -> PhoneClock:
        from gyrorig_solver.reference import (  # noqa: PLC0415 - loads scipy
            read_pan_tilt_reference,
        )

        unit = self._unit
        reference = read_pan_tilt_reference(unit, unit.start_ns)
        edges_s = np.arange(0.0, (unit.end_ns - unit.start_ns) * 1e-9, GRID_S)
        rate = reference.evaluate(edges_s, derivatives=False).rate_rad_s
        # a mean over a grid step is the speed in its middle; shifted by half a step below
        speed = np.linalg.norm(rate, axis=1)
        unbiased_rate = rate_rad_s - np.median(rate_rad_s, axis=0)
        clock = find_phone_clock(since_s, np.linalg.norm(unbiased_rate, axis=1), speed)
        return replace(clock, offset_s=clock.offset_s + 0.5 * GRID_S)


def _clock_note(clock: PhoneClock) -> str:
    return (
        f"the phone's clock was estimated from the motion: {1e6 * clock.skew:+.1f} ± "
        f"{1e6 * clock.skew_std:.1f} ppm, offset to {1e3 * clock.offset_std_s:.2f} ms, correlation "
        f"{clock.correlation:.4f}, {clock.windows} windows; the offset includes the delay of the "
        "phone, therefore the time_offset of a calibration has no meaning"
    )
