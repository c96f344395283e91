"""One session's work, as a worker does it: recordings in, versions in the store, rows out.

What to use when: `carry_out` is what is sent to an executor; it never raises for what a
recording holds. What it raises is a fault of the machine or of the store, and the work is
then put off, not done.
"""

import hashlib
import json
import time
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import lru_cache, partial
from pathlib import PurePosixPath

import msgspec

from gyrorig_protocol.errors import GyrorigError, InputError, MachineError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.calibration.build import settings_sha256
from gyrorig_solver.calibration.document import Calibration, parse_calibration
from gyrorig_solver.calibration.solving import (
    Ready,
    fits_together,
    likelihood_settings,
    solve_into,
)
from gyrorig_solver.calibration.store import CalibrationStore, StoredVersion
from gyrorig_solver.fleet.bucket_store import store_at
from gyrorig_solver.fleet.limits import TooLongError, deadline, memory_limited
from gyrorig_solver.fleet.rows import MAX_TEXT, Row, Status, row_of_calibration, utc_now_text
from gyrorig_solver.places.place import Place

LOOKED_BACK = 3  # versions in which a cut-off batch's own work is looked for


@dataclass(frozen=True, slots=True)
class Settings:
    """How every session of a batch is solved."""

    solver_version: str
    extend: tuple[str, ...] = ()
    deadline_s: float = 300.0
    memory_bytes: int = 4 << 30

    @property
    def config_sha256(self) -> str:
        """As the calibrations have it."""
        return settings_sha256(likelihood_settings(self.extend))


@dataclass(frozen=True, slots=True)
class Order:
    """One piece of work."""

    key: str
    batch: str
    store: Place
    spool: Place
    paths: tuple[PurePosixPath, ...]  # below the spool
    digests: tuple[str, ...]
    settings: Settings
    refused: str = ""  # why it must not be solved; its worker says so


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of it: at least one row."""

    key: str
    rows: tuple[Row, ...]


def key_of(digests: Sequence[str], solver_version: str, config_sha256: str) -> str:
    """Return the name of a piece of work: what goes in, by what it is solved, and how."""
    text = json.dumps([sorted(digests), solver_version, config_sha256])
    return hashlib.sha256(text.encode()).hexdigest()


def carry_out(order: Order) -> Outcome:
    """Solve every board of one session.

    Raises:
        MachineError: the store or the machine refuses; nothing of this is to be recorded.
    """
    begun_s = time.process_time()
    try:
        with deadline(order.settings.deadline_s):
            rows = tuple(_solve(order))
    except MachineError:
        raise
    except GyrorigError as fault:
        rows = (row_of(order, "rejected", reason=str(fault)),)
    except TooLongError:
        reason = f"it took longer than {order.settings.deadline_s:g} s: --retry failed, and more "
        reason += "with --deadline"
        rows = (row_of(order, "failed", reason=reason, trace=traceback.format_exc()),)
    except MemoryError:
        reason = f"it needs more than {order.settings.memory_bytes >> 20} MB of memory: --retry "
        reason += "failed, and more with --memory"
        rows = (row_of(order, "failed", reason=reason),)
    except Exception as fault:  # a fault of this program must not stop a fleet
        reason = f"a fault of the program, {type(fault).__name__}: {fault}"
        rows = (row_of(order, "failed", reason=reason, trace=traceback.format_exc()),)
    spent_s = time.process_time() - begun_s
    return Outcome(order.key, tuple(msgspec.structs.replace(row, seconds=spent_s) for row in rows))


def carry_out_within(order: Order) -> Outcome:
    """Do `carry_out` within the order's memory, in a process that others have begun.

    Raises:
        MachineError: as `carry_out`.
    """
    with memory_limited(order.settings.memory_bytes):
        return carry_out(order)


def row_of(
    order: Order,
    status: Status,
    *,
    reason: str = "",
    trace: str = "",
    recording: Recording | None = None,
    board: str = "",
) -> Row:
    """Return the row of work that has no calibration."""
    own = {} if recording is None else recording.metadata.get("gyrorig", {})
    return Row(
        key=order.key,
        status=status,
        created=utc_now_text(datetime.now(UTC)),
        batch=order.batch,
        inputs=list(order.digests),
        names=[path.name for path in order.paths],
        reason=" ".join(reason.split())[:MAX_TEXT],
        trace=trace[-MAX_TEXT:],
        session=own.get("session", ""),
        rig=own.get("rig", ""),
        board=str(board),  # an id is a text of its own kind, which JSON does not know
        solver_version=order.settings.solver_version,
        config_sha256=order.settings.config_sha256,
    )


def _solve(order: Order) -> Iterator[Row]:
    if order.refused:
        raise InputError(order.refused, "keep one of them in the spool")
    recordings = []
    for path in order.paths:
        with order.spool.local(str(path)) as here:  # mapped: it may be removed once it is read
            recordings.append(read_recording(here))
    for recording in recordings:
        if recording.sha256 not in order.digests:
            raise InputError(
                f"{recording.path.name} has changed since it was looked at",
                "leave recordings as they are; the next batch takes it as it is now",
            )
    boards = sorted({board for recording in recordings for board in recording.board_ids})
    if not boards:
        raise InputError(
            f"{order.paths[0].name} holds no board's samples",
            "`gyrorig check` says what it holds; connect the board and record again",
        )
    store = store_at(order.store)
    ready = _together(order, store, recordings, boards)
    for board in boards:
        yield _solve_board(order, store, recordings, board, ready.get(board))


def _together(
    order: Order, store: CalibrationStore, recordings: Sequence[Recording], boards: list[BoardId]
) -> dict[str, Ready | GyrorigError]:
    """Return the fits of boards that were on one unit at once; empty where they go one by one."""
    everywhere = [one for one in boards if all(one in each.board_ids for each in recordings)]
    try:
        for board in everywhere:
            _look_again(order, store, recordings, board)
    except _DoneError:  # a batch was cut off among them: the others are few
        return {}
    except InputError:  # said where that board is solved
        pass
    try:
        return fits_together(recordings, everywhere, extend=order.settings.extend)
    except (TooLongError, MemoryError):
        raise
    except Exception:  # a fault of the joint fit leaves the boards one by one
        return {}


def _solve_board(
    order: Order,
    store: CalibrationStore,
    recordings: Sequence[Recording],
    board: BoardId,
    ready: Ready | GyrorigError | None,
) -> Row:
    """Solve one board; what is wrong with it does not keep the others."""
    holding = [recording for recording in recordings if board in recording.board_ids]
    first = holding[0]
    before = partial(_look_again, order, store, holding, board)
    try:
        before()
        if isinstance(ready, GyrorigError):
            raise ready
        extend = order.settings.extend
        solved = solve_into(store, holding, board, extend=extend, ready=ready, before=before)
        made, stored = solved.calibration, solved.stored
    except _DoneError as found:
        made, stored = found.made, found.stored
    except MachineError:
        raise
    except GyrorigError as fault:
        return row_of(order, "rejected", reason=str(fault), recording=first, board=board)
    except (TooLongError, MemoryError):
        raise
    except Exception as fault:  # see carry_out
        reason = f"a fault of the program, {type(fault).__name__}: {fault}"
        trace = traceback.format_exc()
        return row_of(order, "failed", reason=reason, trace=trace, recording=first, board=board)
    own = first.metadata.get("gyrorig", {})
    return row_of_calibration(
        made,
        key=order.key,
        batch=order.batch,
        session=own.get("session", ""),
        rig=own.get("rig", ""),
        file=store.name_of(stored),
        file_sha256=stored.digest().removeprefix("sha256:"),
        beside=store.digests_beside(stored),
    )


class _DoneError(Exception):
    """This work has its version: it was cut off before its row, or another batch was faster."""

    def __init__(self, made: Calibration, stored: StoredVersion) -> None:
        super().__init__()
        self.made, self.stored = made, stored


def _look_again(
    order: Order, store: CalibrationStore, holding: Sequence[Recording], board: BoardId
) -> None:
    """Look at the board's newest versions: before the work, and before each try to write.

    Args:
        order: the work.
        store: where they are.
        holding: all recordings of the order that hold the board. A version of fewer of them
            was made before the others were there, and is not this work's.
        board: whose versions.

    Raises:
        _DoneError: one of them is this work's.
        InputError: they are another board's.
    """
    newest = store.versions(board)[-LOOKED_BACK:]
    digests = {recording.sha256 for recording in holding}
    uid = holding[0].metadata.get(f"gyrorig.board.{board}", {}).get("uid", "")
    config = order.settings.config_sha256
    for stored in reversed(newest):
        made = _parsed(stored.data(), str(stored.path))
        if stored is newest[-1] and uid and made.board.uid not in ("", uid):
            raise InputError(
                f"board {board} has the uid {uid[:40]!r} here and {made.board.uid[:40]!r} in "
                "the store: two boards have one name",
                "give one of them another id in its rig's configuration",
            )
        same_inputs = {one.sha256 for one in made.inputs} == digests
        same_solver = made.solver.version == order.settings.solver_version
        if same_inputs and same_solver and made.solver.config_sha256 == config:
            raise _DoneError(made, stored)


@lru_cache(maxsize=16)  # one board's newest versions are looked at three times
def _parsed(data: bytes, named: str) -> Calibration:
    return parse_calibration(data, named)
