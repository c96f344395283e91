"""Losses by the boards' own counters and lateness of stamps in a recording of the load."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gyrorig_protocol.recording.messages import PTU_POSITION_TOPIC
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import times_ns

WRAP = 1 << 16
US_WRAP = 1 << 32


@dataclass(frozen=True)
class BoardFigures:
    """One board of a recording."""

    board: str
    link: str
    samples: int
    missing: int
    unordered: int
    late_ms: npt.NDArray[np.float64]  # of every arrival stamp


@dataclass(frozen=True)
class RecordingFigures:
    """A whole recording."""

    boards: list[BoardFigures]
    positions: int
    seconds: float
    size: int


def read_figures(path: Path, flooded_board: str) -> RecordingFigures:
    """Return the figures of a recording; device times must be CLOCK_MONOTONIC_RAW in us.

    Args:
        path: the recording.
        flooded_board: left out.
    """
    recording = read_recording(path)
    metadata = recording.metadata["gyrorig"]
    utc_minus_raw_ns = int(metadata["anchor_utc_ns"]) - int(metadata["anchor_monotonic_raw_ns"])
    boards: list[BoardFigures] = []
    for board in recording.board_ids:
        if board == flooded_board:
            continue
        imu = recording.imu(board)
        numbers = imu["sequence"].astype(np.int64)
        steps = np.diff(numbers) % WRAP
        unordered = int((steps >= WRAP // 2).sum()) + int((steps == 0).sum())
        forward = steps[(steps > 0) & (steps < WRAP // 2)]
        raw_us = (times_ns(imu["host_time"]) - utc_minus_raw_ns) / 1000.0
        late_us = raw_us - imu["device_time"].astype(np.float64) + US_WRAP / 2
        late_us = late_us % US_WRAP - US_WRAP / 2  # a kernel's stamp may be a microsecond early
        boards.append(
            BoardFigures(
                str(board),
                recording.metadata[f"gyrorig.board.{board}"]["link"],
                len(numbers),
                int((forward - 1).sum()) - unordered,
                unordered,
                late_us / 1000.0,
            )
        )
    first_ns, last_ns = recording.span_ns
    positions = recording.topics.get(PTU_POSITION_TOPIC)
    return RecordingFigures(
        boards,
        0 if positions is None else len(positions),
        (last_ns - first_ns) * 1e-9,
        path.stat().st_size,
    )
