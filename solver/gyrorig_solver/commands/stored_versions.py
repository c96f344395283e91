"""Versions of a board in a store, as the command line names them.

What to use when: `find_version` by number; `versions_in_time` by the time of the recording or the
configuration; `parameter_differences` to compare two of them.
"""

from collections.abc import Iterator
from datetime import datetime
from pathlib import Path, PurePosixPath
from typing import Any

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.suggestions import did_you_mean
from gyrorig_solver.calibration import CalibrationDocument, StoredVersion, parse_calibration
from gyrorig_solver.fleet.store import open_existing_store, parameter_columns
from gyrorig_solver.fleet.store.index_rows import parameter_values
from gyrorig_solver.fleet.store.store_queries import list_documents, versions_by_measurement_time
from gyrorig_solver.storage import Storage


def find_version(folder: Storage, board: BoardId, number: int) -> tuple[Path, CalibrationDocument]:
    """Return one version of a board.

    Raises:
        InputError: the board or version does not exist, or is damaged.
    """
    versions = open_existing_store(folder).versions(board)
    for version in versions:
        if version.number == number:
            return read_version(version)
    if not versions:
        raise _unknown_board_error(folder, board)
    raise InputError(
        f"the store {folder.location} does not contain calibration version {number} of board "
        f"{board}",
        f"choose a calibration version from {versions[0].number} to {versions[-1].number}",
    )


def _unknown_board_error(folder: Storage, board: BoardId) -> InputError:
    known = {PurePosixPath(entry.name).parent.name for entry in list_documents(folder)}
    suggestion = did_you_mean(board, sorted(known))
    return InputError(
        f"the store {folder.location} does not contain board {board}",
        suggestion or f"list the boards of the store with `gyrorig store ls {folder.location}`",
    )


def versions_in_time(
    folder: Storage, board: BoardId, at: datetime | None = None, config_hash: str | None = None
) -> list[StoredVersion]:
    """Return the versions of a board in the order of their recordings, the last one last.

    Raises:
        InputError: there is none.
    """
    versions = versions_by_measurement_time(folder, board)
    matching = [
        measured.version
        for measured in versions
        if (at is None or measured.start <= at) and config_hash in (None, measured.config_hash)
    ]
    if not versions:
        raise _unknown_board_error(folder, board)
    if not matching:
        conditions = [
            *([] if at is None else [f"recorded until {at:%Y-%m-%d %H:%M} UTC"]),
            *([] if config_hash is None else [f"made with the configuration {config_hash[:20]}"]),
        ]
        raise InputError(
            f"the store {folder.location} contains no calibration of board {board} that was "
            f"{' and '.join(conditions)}",
            f"list the calibrations of the board with `gyrorig store ls {folder.location} --all "
            f"--board {board}`",
        )
    return matching


def read_version(version: StoredVersion) -> tuple[Path, CalibrationDocument]:
    """Return the path of a version and its document."""
    return version.path, parse_calibration(version.data(), str(version.path))


def parameter_differences(
    earlier: CalibrationDocument, later: CalibrationDocument
) -> Iterator[dict[str, Any]]:
    """Yield the change of each parameter between two calibrations, also in standard deviations."""
    before, after = parameter_values(earlier), parameter_values(later)
    for name in parameter_columns():
        if name.endswith("_std") or name not in before or name not in after:
            continue
        change = after[name] - before[name]
        combined_std = (before[f"{name}_std"] ** 2 + after[f"{name}_std"] ** 2) ** 0.5
        yield {
            "parameter": name,
            "before": before[name],
            "after": after[name],
            "change": change,
            "sigma": change / combined_std if combined_std else None,
        }
