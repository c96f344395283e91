"""From recordings to the provenance of a calibration."""

import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.messages import imu_topic
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.calibration.build import Provenance
from gyrorig_solver.calibration.document import Board, BoardConfig, SolvedInput


def utc_text(nanoseconds: int) -> str:
    """Return nanoseconds since the epoch as UTC, `2026-01-31T02:30:00Z`."""
    return datetime.fromtimestamp(nanoseconds // 1_000_000_000, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def provenance(
    recordings: Sequence[Recording],
    board: BoardId,
    lost: Sequence[int],
    software: str,
    settings: Mapping[str, Any],
) -> Provenance:
    """Return where a result for `board` comes from.

    Args:
        recordings: at least one, the first says how the board was set.
        board: in each of them.
        lost: samples missing, one number a recording.
        software: version of the program.
        settings: of the solver.
    """
    metadata = recordings[0].metadata.get(f"gyrorig.board.{board}", {})
    return Provenance(
        board=Board(
            id=str(board),  # a plain string: the document knows no other kind
            uid=metadata.get("uid", ""),
            sensor=metadata.get("sensor", ""),
            config=BoardConfig(
                odr_hz=_number(metadata, "odr_hz"),
                bandwidth_hz=_number(metadata, "bandwidth_hz"),
                gyro_full_scale_dps=_number(metadata, "gyro_full_scale_dps"),
                gyro_scale_rad_s=_number(metadata, "gyro_scale_rad_s"),
                config_hash=metadata.get("config_hash"),
            ),
        ),
        inputs=[
            SolvedInput(
                name=recording.path.name,
                sha256=recording.sha256,
                start=utc_text(recording.start_ns),
                duration_s=(recording.end_ns - recording.start_ns) * 1e-9,
                samples=len(recording.topics[imu_topic(board)]),
                lost=int(missing),
            )
            for recording, missing in zip(recordings, lost, strict=True)
        ],
        software=software,
        settings=settings,
    )


def _number(metadata: Mapping[str, str], key: str) -> float | None:
    """Return a metadata entry as a finite number; what is none is left out."""
    try:
        value = float(metadata[key])
    except (KeyError, ValueError):
        return None
    return value if math.isfinite(value) else None
