"""Boards on one pan-tilt unit at the same time: their recordings and samples, loaded once.

Boards on one CAN bus get a common time base.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from gyrorig_protocol.errors import GyrorigError
from gyrorig_protocol.recording.recording import Recording, in_order_of_time
from gyrorig_solver.data.clocks.shared_time_base import TimeCorrection, fit_shared_time
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate import NO_SHARING, BoardSharing
from gyrorig_solver.pipeline.board_data import BoardData, load_changing_samples
from gyrorig_solver.pipeline.recording_agreement import require_agreement


@dataclass(frozen=True, slots=True, eq=False)
class JointData:
    """The data of several boards of the same recordings."""

    recordings: tuple[Recording, ...]  # in the order of time
    boards: Mapping[str, BoardData]
    errors: Mapping[str, GyrorigError]  # of boards that could not be loaded
    clock_shifts: Mapping[str, TimeCorrection]  # in the last recording, of boards on one bus

    def without(self, names: Collection[str]) -> "JointData":
        """Return the data without some boards."""
        return replace(
            self,
            boards={board: data for board, data in self.boards.items() if board not in names},
            errors={board: fault for board, fault in self.errors.items() if board not in names},
        )

    def shared_clock(self, board: str) -> BoardSharing:
        """Return how many boards share the time base in the last recording, and the correction."""
        shift = self.clock_shifts.get(board)
        if shift is None:
            return NO_SHARING
        return BoardSharing(on_one_clock=shift.board_count, clock_change_s=shift.rms_s)


def load_jointly(
    recordings: Sequence[Recording], boards: Sequence[str], allow_contradiction: bool = False
) -> JointData:
    """Load boards' samples, with a common time base for those on one bus.

    A board whose recordings contradict each other gets an error; see `require_agreement`.
    """
    ordered = in_order_of_time(recordings)
    samples: dict[str, list[GyroSamples]] = {board: [] for board in boards}
    errors: dict[str, GyrorigError] = {}
    clock_shifts: Mapping[str, TimeCorrection] = {}
    for recording in ordered:
        loaded: dict[str, GyroSamples] = {}
        for board in boards:
            try:
                loaded[board] = load_changing_samples(recording, board)
                samples[board].append(loaded[board])
            except GyrorigError as fault:
                errors.setdefault(board, fault)
        exchanges = {
            board: board_samples.exchanges
            for board, board_samples in loaded.items()
            if board_samples.exchanges is not None
        }
        clock_shifts = fit_shared_time(exchanges)
        for board, shift in clock_shifts.items():
            shift.apply(loaded[board].time_s)  # in place: the clock map shares the array
    data: dict[str, BoardData] = {}
    for board in boards:
        if board in errors:
            continue
        try:
            data[board] = require_agreement(
                BoardData(
                    board,
                    ordered,
                    tuple(samples[board]),
                    allows_contradiction=allow_contradiction,
                )
            )
        except GyrorigError as fault:
            errors[board] = fault
    return JointData(ordered, data, errors, clock_shifts)
