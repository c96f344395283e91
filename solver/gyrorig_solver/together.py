"""Boards that were on one unit at once, solved together: one motion, one time on a bus.

What to use when: `solve_on_one_unit` where `are_on_one_unit` says so; the estimator is in
`estimate.on_one_unit`, what boards of a bus share in `clocks.shared`. `load_together` for the
samples alone.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

from gyrorig_protocol.errors import GyrorigError
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.clocks.shared import Moved, shared_time
from gyrorig_solver.estimate.extension import Extension
from gyrorig_solver.estimate.likelihood import Solution
from gyrorig_solver.estimate.on_one_unit import fit_on_one_unit
from gyrorig_solver.estimate.result import GyroFit
from gyrorig_solver.estimate.ties import is_of_unit
from gyrorig_solver.model.terms.bound import label
from gyrorig_solver.on_unit import Begun, begun
from gyrorig_solver.samples import GyroSamples, load_samples

# Of recordings fitted for all their boards at once: 16 boards took 200 MB for 3.7 MB of them.
MOST_BYTES = 40_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Loaded:
    """The boards of one recording."""

    samples: Mapping[str, GyroSamples]
    faults: Mapping[str, GyrorigError]  # of the others
    moved: Mapping[str, Moved]  # of those that share their time with others


def load_together(recording: Recording, boards: Sequence[str]) -> Loaded:
    """Return boards' samples, the times of those on one bus made one time.

    Args:
        recording: of all of them.
        boards: by name.
    """
    samples: dict[str, GyroSamples] = {}
    faults: dict[str, GyrorigError] = {}
    for board in boards:
        try:
            samples[board] = load_samples(recording, board)
        except GyrorigError as fault:
            faults[board] = fault
    asked = {name: one.exchanges for name, one in samples.items() if one.exchanges is not None}
    moved = shared_time(asked)
    for board, one in moved.items():
        one.off(samples[board].time_s)  # which are its clock's too
    return Loaded(samples, faults, moved)


def solve_on_one_unit(
    recordings: Sequence[Recording],
    boards: Sequence[str],
    extend: Sequence[str] = (),
    named: Mapping[str, Sequence[Extension]] = MappingProxyType({}),
) -> dict[str, GyroFit | GyrorigError]:
    """Calibrate boards that were on one unit at once, together; see `estimate.on_one_unit`.

    Each board is fitted by itself first: what cannot be fitted, or does not agree with the
    others, is returned as it is alone. Boards of a bus have one time (`clocks.shared`), and
    causes that are the unit's one size.

    Args:
        recordings: in any order; each board is in each of them.
        boards: by name.
        extend: causes of the catalogue to fit to each of them.
        named: causes as a search named them, of each board; those of which boards were told
            by others are the unit's.

    Returns:
        Each board's fit, or why there is none.
    """
    ordered = sorted(recordings, key=lambda recording: recording.start_ns)
    loaded = [load_together(recording, boards) for recording in ordered]
    ready: dict[str, Begun] = {}
    alone: dict[str, Solution] = {}
    fits: dict[str, GyroFit | GyrorigError] = {}
    for board in boards:
        try:
            for one in loaded:
                if board in one.faults:
                    raise one.faults[board]
            own = [(r, one.samples[board]) for r, one in zip(ordered, loaded, strict=True)]
            ready[board] = begun(own, extend, named.get(board, ()))
            alone[board] = ready[board].solution()
        except GyrorigError as fault:
            fits[board] = fault
    together = fit_on_one_unit(alone, _common(alone.values()))
    missing = tuple(f"{r.path.name}: {loss.text}" for r in ordered for loss in r.losses)
    for board, before in alone.items():
        solution = together.solutions.get(board, before)
        more = _beside(board, loaded)
        if solution is not before:
            more["boards_together"] = float(len(together.solutions))
        warnings: tuple[str, ...] = ()
        if board in together.left_out:
            warnings = (f"solved without the boards beside it: {together.left_out[board]}",)
        try:
            fit = ready[board].concluded(solution, warnings, more)
            fits[board] = replace(fit, warnings=(*missing, *fit.warnings))
        except GyrorigError as fault:
            fits[board] = fault
    return fits


def _common(alone: Iterable[Solution]) -> frozenset[str]:
    """Return the labels of causes that are the unit's: by their kind, or by all boards' say."""
    return frozenset(
        label(cause.term)
        for one in alone
        for cause in one.extensions
        if cause.told is not None or is_of_unit(cause.term)
    )


def _beside(board: str, loaded: Sequence[Loaded]) -> dict[str, float]:
    """Return how many boards share a board's time, and how far it moved for that; the last's."""
    moved = loaded[-1].moved.get(board)
    if moved is None:
        return {}
    return {"boards_on_one_clock": float(moved.boards), "clock_moved_s": moved.rms_s}


def are_on_one_unit(recordings: Sequence[Recording], boards: Sequence[str]) -> bool:
    """Return whether boards can be fitted together: on a unit at once, and not too much."""
    if len(boards) < 2 or not all("/ptu/position" in one.topics for one in recordings):
        return False
    if not all(set(boards) <= set(one.board_ids) for one in recordings):
        return False
    return sum(one.path.stat().st_size for one in recordings) <= MOST_BYTES
