"""Refuse recordings of two boards with one name, and of one board with two settings.

What to use when: `check_same_board` before recordings are fitted together, `check_stored_board`
before a batch adds a version to a store, `compare_with_version` for a remark on the newest version.
"""

from collections.abc import Mapping, Sequence

from gyrorig_protocol.errors import GyrorigError, InputError, UsageError
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.calibration import StoredVersion, parse_calibration
from gyrorig_solver.calibration.calibration_document import (
    UNKNOWN_IDENTITIES,
    BoardRecord,
    are_different,
)

IDENTITIES = ("uid", "sensor")
# Settings that the fit uses: a setting in only one of two recordings is a difference.
FITTED_SETTINGS = ("gyro_scale_rad_s", "gyro_full_scale_dps", "bandwidth_hz")
# Settings that `gyrorig apply` and the drift charts compare too. Older recordings lack them.
HASH = "config_hash"
OTHER_SETTINGS = ("odr_hz", HASH)


def check_same_board(
    board: str, names: Sequence[str], metadata: Sequence[Mapping[str, str]]
) -> None:
    """Check that recordings are of one board with the same settings.

    A uid or a sensor that is not known can be that of any board.

    Args:
        board: its name.
        names: of the recordings.
        metadata: of the board in each of them.

    Raises:
        UsageError: uid, sensor or a setting differs.
    """
    for key in IDENTITIES:
        seen: tuple[str, str] | None = None  # the first known identity, and its recording
        for name, entries in zip(names, metadata, strict=True):
            identity = entries.get(key, "")
            if seen is not None and are_different(seen[0], identity):
                raise UsageError(
                    f"the {key} of board {board} is {seen[0]:.40} in the recording "
                    f"{seen[1]}, and {identity:.40} in {name}, so two boards have the same name",
                    "solve the recordings of each board separately, and give one of the two boards "
                    "another `id` in its rig file",
                )
            if seen is None and identity not in UNKNOWN_IDENTITIES:
                seen = identity, name
    for key in (*FITTED_SETTINGS, *OTHER_SETTINGS):
        _check_setting(key, board, names, metadata)


def check_stored_board(stored: BoardRecord, recordings: Sequence[Recording]) -> None:
    """Check that each recording can be of the board that a store has under this name.

    Args:
        stored: the board of its newest version.
        recordings: each with a board of this name.

    Raises:
        InputError: uid or sensor differs.
    """
    for recording in recordings:
        metadata = recording.metadata.get(f"gyrorig.board.{stored.id}", {})
        difference = _find_other_identity(stored, metadata)
        if difference is not None:
            key, known, identity = difference
            raise InputError(
                f"board {stored.id} has the {key} {identity!r} in the recording "
                f"{recording.path.name}, but {known!r} in the store, so two boards have the same "
                "name",
                "give one of the two boards another `id` in its rig file",
            )


def compare_with_version(version: StoredVersion | None, board: BoardRecord) -> str | None:
    """Return a remark if the newest version of a store is of another board, else None.

    A version that cannot be read is not compared.
    """
    if version is None:
        return None
    try:
        earlier = parse_calibration(version.data(), version.name).board
    except GyrorigError:
        return None
    difference = _find_other_identity(earlier, {"uid": board.uid, "sensor": board.sensor})
    if difference is None:
        return None
    key, known, identity = difference
    return (
        f"the {key} of board {board.id} is {identity}, and {known} in version {version.number}, so "
        "two boards have the same name; give one of them another `id` in its rig file"
    )


def _find_other_identity(
    stored: BoardRecord, identities: Mapping[str, str]
) -> tuple[str, str, str] | None:
    """Return the key whose known values differ, and both values, shortened; None without one."""
    for key, known in (("uid", stored.uid), ("sensor", stored.sensor)):
        identity = identities.get(key, "")
        if are_different(known, identity):
            return key, known[:40], identity[:40]
    return None


def _check_setting(
    key: str, board: str, names: Sequence[str], metadata: Sequence[Mapping[str, str]]
) -> None:
    texts = [entries.get(key) for entries in metadata]
    given = [k for k, text in enumerate(texts) if text or key in FITTED_SETTINGS]
    for k in given[1:]:
        first, other = texts[given[0]], texts[k]
        is_number = key != HASH  # a hash of digits such as 1e400 is no number
        if _as_number(first) != _as_number(other) if is_number else first != other:
            raise UsageError(
                f"the setting {key} of board {board} differs: it is "
                f"{first or 'not given'} in the recording {names[given[0]]}, and "
                f"{other or 'not given'} in {names[k]}",
                "solve these two recordings separately",
            )


def _as_number(text: str | None) -> float | str | None:
    """Return a setting as a number, because `250` and `250.0` are the same; else as it is."""
    try:
        return float(text or "")
    except ValueError:
        return text
