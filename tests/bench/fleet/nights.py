"""The physics of a fleet: boards of lots on rigs, and what each is like on a night.

What to use when: `FleetDraw` says how large a fleet is and what is hidden in it; `sessions_of`
who is measured when; `truth_of` what the emulator is to be in one session. All of it is a pure
function of the draw: a session can be made again alone.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from tests.bench.fleet.parts import SCATTER, SPREAD

from gyrorig_daemon.emulator.emulator_settings import BoardSettings, RigSettings
from gyrorig_daemon.emulator.physics.rotation import rotation_matrix
from gyrorig_daemon.emulator.rig_truth import (
    BoardTruth,
    RigTruth,
    sample_board_truth,
    sample_rig_truth,
)

FloatArray = np.ndarray
Broken = Literal["truncated", "foreign", "empty", "garbled", "at_rest"]
BROKEN: tuple[Broken, ...] = ("truncated", "foreign", "empty", "garbled", "at_rest")
ROOM_DEGC, SEASON_K, DAY_K = 25.0, 4.0, 0.5
BIAS_PER_K = 1e-4  # rad/s; I3G4250D: zero rate over temperature +-0.03 dps/K at most

_BOARD, _NIGHT, _PLAN = 1, 2, 3  # streams of one seed


@dataclass(frozen=True, slots=True)
class FleetDraw:
    """A fleet, and what is hidden in it. Boards are `B000000` and so on."""

    boards: int = 24
    nights: int = 6
    rigs: int = 4
    lots: int = 3
    at_once: int = 2  # boards on a rig in one session
    measured: float = 1.0  # share of the boards on a night
    seed: int = 1
    odr_hz: float = 100.0
    bad_lot: tuple[int, float] | None = None  # lot, added to its z scale
    rig_drift: tuple[int, int, float] | None = None  # rig, first night, rad a night about x
    board_drift: tuple[int, int, float] | None = None  # board, first night, y scale a night
    constant: float | None = None  # the rate of one count is wrong by this share, on every unit
    broken: float = 0.0  # share of the sessions whose recording is spoilt

    def rig_of(self, board: int) -> int:
        """Return which rig a board is measured on."""
        return board % self.rigs

    def lot_of(self, board: int) -> int:
        """Return which lot a board is of."""
        return (board // self.rigs) % self.lots


@dataclass(frozen=True, slots=True)
class Session:
    """Some boards on a rig on a night."""

    number: int
    of_night: int  # counts from 0 in every night
    night: int
    rig: int
    boards: tuple[int, ...]
    broken: Broken | None = None


def name_of(board: int) -> str:
    """Return a board's name."""
    return f"B{board:06d}"


def sessions_of(draw: FleetDraw) -> Iterator[Session]:
    """Yield all sessions in the order of time."""
    rng = np.random.default_rng([draw.seed, _PLAN])
    number = 0
    for night in range(draw.nights):
        first_number = number
        here = np.flatnonzero(rng.random(draw.boards) < draw.measured)
        for rig in range(draw.rigs):
            rig_boards = [int(board) for board in here if draw.rig_of(int(board)) == rig]
            for first in range(0, len(rig_boards), draw.at_once):
                spoilt = rng.random() < draw.broken
                broken = BROKEN[int(rng.integers(len(BROKEN)))] if spoilt else None
                boards = tuple(rig_boards[first : first + draw.at_once])
                yield Session(number, number - first_number, night, rig, boards, broken)
                number += 1


def settings_of(draw: FleetDraw, session: Session) -> RigSettings:
    """Return what the emulator is told to be in a session."""
    boards = tuple(
        BoardSettings(name=name_of(board), odr_hz=draw.odr_hz, bandwidth_hz=draw.odr_hz / 4.0)
        for board in session.boards
    )
    seed = int(np.random.default_rng([draw.seed, _NIGHT, session.number]).integers(2**31))
    return RigSettings(seed=seed, boards=boards)


def truth_of(draw: FleetDraw, session: Session) -> RigTruth:
    """Return what the emulator hides in a session."""
    settings = settings_of(draw, session)
    drawn = sample_rig_truth(settings)
    boards: Mapping[str, BoardTruth] = {
        settings_of_board.name: _board_tonight(draw, session, board, settings_of_board)
        for board, settings_of_board in zip(session.boards, settings.boards, strict=True)
    }
    return replace(drawn, boards=boards)


def _board_tonight(
    draw: FleetDraw, session: Session, board: int, settings: BoardSettings
) -> BoardTruth:
    board_rng = np.random.default_rng([draw.seed, _BOARD, board])
    tonight = np.random.default_rng([draw.seed, _NIGHT, session.night, board])
    drawn = sample_board_truth(settings, board_rng)
    of_part = {family: board_rng.normal(0.0, size, 3) for family, size in SPREAD.items()}
    value = {f: of_part[f] + tonight.normal(0.0, SCATTER[f], 3) for f in of_part}
    room = ROOM_DEGC + SEASON_K * np.sin(session.night / 4.0) + tonight.normal(0.0, DAY_K)
    scale = 1.0 + value["scale"] + _scale_hidden(draw, session, board)
    skewing = np.eye(3)
    skewing[(1, 2, 2), (0, 0, 1)] = value["nonorthogonality"]
    mounting = rotation_matrix(value["misalignment"]) @ rotation_matrix(_rig_moved(draw, session))
    imu = replace(
        drawn.imu,
        gain=np.diag(scale) @ skewing @ mounting,
        mounting=mounting,
        bias_rad_s=value["bias"] + BIAS_PER_K * (room - ROOM_DEGC),
        tau_s=0.35 / settings.odr_hz + float(value["time"][0]),
        ambient_degc=float(room),
    )
    return replace(drawn, imu=imu, scale=np.diag(scale), nonorthogonality=skewing)


def _scale_hidden(draw: FleetDraw, session: Session, board: int) -> FloatArray:
    """Return what is hidden in a board's scale."""
    hidden = np.full(3, draw.constant or 0.0)
    if draw.bad_lot is not None and draw.lot_of(board) == draw.bad_lot[0]:
        hidden[2] += draw.bad_lot[1]
    if draw.board_drift is not None and draw.board_drift[0] == board:
        _, first, a_night = draw.board_drift
        hidden[1] += max(session.night - first + 1, 0) * a_night
    return hidden


def _rig_moved(draw: FleetDraw, session: Session) -> FloatArray:
    """Return how far a rig's fixture has turned, rotation vector, rad."""
    turned = np.zeros(3)
    if draw.rig_drift is not None and draw.rig_drift[0] == session.rig:
        _, first, a_night = draw.rig_drift
        turned[0] = max(session.night - first + 1, 0) * a_night
    return turned
