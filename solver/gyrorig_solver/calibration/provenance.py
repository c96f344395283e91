"""Provenance of a calibration: board, recordings and settings."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.messages import imu_raw_topic
from gyrorig_protocol.recording.recording import Recording
from gyrorig_protocol.recording.recording_names import distinct_names
from gyrorig_solver.calibration.calibration_builder import Provenance
from gyrorig_solver.calibration.calibration_document import BoardRecord, BoardSettings, SolvedInput
from gyrorig_solver.data.utc_time import utc_text, utc_text_now


def build_provenance(
    recordings: Sequence[Recording],
    board: BoardId,
    lost: Sequence[int],
    software: str,
    settings: Mapping[str, Any],
) -> Provenance:
    """Return the provenance of a result for `board`.

    Args:
        recordings: at least one; the first has the board's settings.
        board: in each of them.
        lost: number of missing samples per recording.
        software: version of the program.
        settings: of the solver.
    """
    metadata = recordings[0].metadata.get(f"gyrorig.board.{board}", {})
    return Provenance(
        board=BoardRecord(
            id=str(board),  # a plain string, as the document requires
            uid=metadata.get("uid", ""),
            sensor=metadata.get("sensor", ""),
            config=BoardSettings(
                odr_hz=_finite_metadata(metadata, "odr_hz"),
                bandwidth_hz=_finite_metadata(metadata, "bandwidth_hz"),
                gyro_full_scale_dps=_finite_metadata(metadata, "gyro_full_scale_dps"),
                gyro_scale_rad_s=_finite_metadata(metadata, "gyro_scale_rad_s"),
                config_hash=metadata.get("config_hash"),
            ),
        ),
        inputs=[
            SolvedInput(
                name=name,
                sha256=recording.sha256,
                start=utc_text(recording.start_ns),
                duration_s=(recording.end_ns - recording.start_ns) * 1e-9,
                samples=len(recording.topics[imu_raw_topic(board)]),
                lost=int(missing),
            )
            for name, recording, missing in zip(
                distinct_names(recordings), recordings, lost, strict=True
            )
        ],
        software=software,
        created=utc_text_now(),
        settings=settings,
    )


def _finite_metadata(metadata: Mapping[str, str], key: str) -> float | None:
    """Return a metadata entry as a finite number, None if it is not one."""
    try:
        value = float(metadata[key])
    except (KeyError, ValueError):
        return None
    return value if math.isfinite(value) else None
