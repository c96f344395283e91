"""Blackbox logs of Betaflight (.bbl, .bfl).

Source: Betaflight, src/main/blackbox/blackbox.c: `gyroADC` (filtered) and `gyroUnfilt` are in
deg/s times 1 / `gyro_scale`, a float written as the hexadecimal digits of its bits;
with `blackbox_high_resolution` they are ten times as large; `accSmooth` is in counts with
`acc_1G` counts per g; `time` is in us. The log has no attitudes.
"""

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray
from gyrorig_solver.importers.blackbox_log import PRODUCT, BlackboxSession, read_blackbox
from gyrorig_solver.importers.measured_streams import (
    STANDARD_GRAVITY_M_S2,
    AccelStream,
    GyroStream,
    MeasuredBoard,
    MeasuredStreams,
)
from gyrorig_solver.importers.measurement_format import (
    BOARD_OPTIONS,
    FormatMatch,
    ImportOptions,
    read_head,
)

_TIME_WRAP_US = 2**32
_MAX_GAP_US = 10_000_000  # a larger step is a pause or a damaged frame; the next frame shows which


@dataclass(frozen=True, slots=True)
class BetaflightLog:
    """The longest session of a blackbox log."""

    name: str = "blackbox"
    title: str = "Betaflight blackbox log (.bbl)"
    extra: str = ""
    used_options: frozenset[str] = BOARD_OPTIONS | {"topics"}

    def detect(self, source: Path) -> FormatMatch | None:
        """Return a match for the first header line of the log."""
        if not read_head(source, len(PRODUCT)).startswith(PRODUCT):
            return None
        return FormatMatch("a Betaflight blackbox log")

    def read(self, source: Path, options: ImportOptions) -> MeasuredStreams:
        """Return the rates of the longest session; `--topic 2` selects the second."""
        sessions = read_blackbox(source)
        if not sessions:
            raise InputError(
                f"the blackbox log {source.name} has a header, but no frames",
                "download the log from the flight controller again",
            )
        session, notes = _choose_session(sessions, options.topics, source.name)
        time_us, frames = _times(session)
        rates, more = _rates(session, source.name)
        accel = _accelerations(session)
        if session.damaged:
            notes.append(f"{session.damaged} damaged frames were left out")
        board = MeasuredBoard(
            options.board or "BETAFLIGHT",
            GyroStream(time_us * 1e-6, rates[frames]),
            None if accel is None else AccelStream(accel[frames]),
            metadata={
                "sensor": options.sensor or "unknown",
                "model": session.headers.get("Board information", "Betaflight")[:100],
            },
        )
        return MeasuredStreams(
            f"imported from {source.name}: blackbox log",
            (board,),
            notes=(*notes, *more),
        )


def _choose_session(
    sessions: list[BlackboxSession], topics: tuple[str, ...], name: str
) -> tuple[BlackboxSession, list[str]]:
    if topics:
        number = int(topics[0]) if topics[0].isdecimal() and len(topics[0]) < 6 else 0
        if not 1 <= number <= len(sessions):
            raise InputError(
                f"the blackbox log {name} has {len(sessions)} sessions, and none is "
                f"{topics[0]!r:.40}",
                f"give a number from 1 to {len(sessions)} with --topic",
            )
        return sessions[number - 1], []
    longest = max(range(len(sessions)), key=lambda index: len(sessions[index].rows))
    if len(sessions) == 1:
        return sessions[0], []
    return sessions[longest], [
        f"the log has {len(sessions)} sessions, and this is the longest, number {longest + 1} "
        "(--topic selects another)"
    ]


def _column(session: BlackboxSession, name: str) -> FloatArray | None:
    if name not in session.names:
        return None
    return session.rows[:, session.names.index(name)]


def _triple(session: BlackboxSession, name: str) -> FloatArray | None:
    columns = [_column(session, f"{name}[{axis}]") for axis in range(3)]
    if any(column is None for column in columns):
        return None
    return np.stack([column for column in columns if column is not None], axis=1)


def _times(session: BlackboxSession) -> tuple[FloatArray, np.ndarray]:
    """Return the times in us of the frames in order, and the indices of these frames.

    After a long step, the next frame decides: if it continues the time before the step, the frame
    is damaged; if it continues the time after it, the step is a pause. A step of half the range of
    the counter (36 min) or more is one backwards.
    """
    raw = _column(session, "time")
    if raw is None:
        raise InputError(
            "the blackbox log has no field time",
            "download the log from the flight controller again",
        )
    steps = np.concatenate([[0.0], np.mod(np.diff(raw), _TIME_WRAP_US)])
    is_next = (steps > 0.0) & (steps < _MAX_GAP_US)
    is_next[0] = True
    for frame in np.flatnonzero(~is_next).tolist():
        if is_next[frame] or frame + 1 == raw.size:
            continue
        from_before = steps[frame] + steps[frame + 1]
        if 0.0 < from_before % _TIME_WRAP_US < _MAX_GAP_US:
            steps[frame + 1], is_next[frame + 1] = from_before % _TIME_WRAP_US, True
        elif 0.0 < steps[frame] < _TIME_WRAP_US / 2:
            is_next[frame] = 0.0 < steps[frame + 1] < _MAX_GAP_US
    time_us = raw[0] + np.cumsum(np.where(is_next, steps, 0.0))
    frames = np.flatnonzero(is_next)
    return time_us[frames] - min(0.0, float(raw[0])), frames


def _rates(session: BlackboxSession, name: str) -> tuple[FloatArray, list[str]]:
    """Return the rates in rad/s, and notes."""
    field = next((f for f in ("gyroUnfilt", "gyroADC") if f"{f}[2]" in session.names), None)
    counts = _triple(session, field) if field else None
    if counts is None or field is None:
        listed = ", ".join(session.names)[:200]
        raise InputError(
            f"the blackbox log {name} has no field gyroUnfilt or gyroADC, but only {listed}",
            "include the gyroscope in the blackbox settings of Betaflight, and record again",
        )
    text = session.headers.get("gyro_scale", session.headers.get("gyro.scale", ""))
    try:
        (scale_dps,) = struct.unpack("<f", struct.pack("<I", int(text, 16)))
    except (ValueError, struct.error):
        scale_dps = float("nan")
    if not 1e-6 < scale_dps <= 100.0:
        raise InputError(
            f"the header of the blackbox log {name} gives no valid gyro_scale ({text[:20]!r})",
            "use a log of Betaflight or Cleanflight",
        )
    if session.headers.get("blackbox_high_resolution", "0").strip() == "1":
        scale_dps /= 10.0
    notes = [f"the log rounds the rates to {scale_dps:.3g} deg/s"]
    if field == "gyroADC":
        notes.append("the rates are filtered by the flight controller (gyroADC)")
    return np.radians(counts * scale_dps), notes


def _accelerations(session: BlackboxSession) -> FloatArray | None:
    counts = _triple(session, "accSmooth")
    text = session.headers.get("acc_1G", "")
    if counts is None or not text.isdecimal() or not 1 <= int(text) <= 100_000:
        return None
    return counts * (STANDARD_GRAVITY_M_S2 / int(text))


FORMAT = BetaflightLog()
