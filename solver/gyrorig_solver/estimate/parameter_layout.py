"""The order of a fit's parameters: named blocks, each with a scope and a prior.

The parameters of a board are its gain, each recording's bias and time offset, and the values of its
causes, in this order. Boards follow each other. A unit-wide cause is one block that all boards
share, at the position of the first board that has it. One board is the case N = 1.

What to use when: `ParameterLayout.of` for the parameters of a fit; `index` for the columns of one
recording's equations.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray, IntArray
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.estimate.observability import BIAS_NAMES, prior_std
from gyrorig_solver.model import GAIN_NAMES, term_label

GAIN_PARAMETERS = len(GAIN_NAMES)
SESSION_PARAMETERS = len(BIAS_NAMES) + 1  # bias and time offset of one recording
BASE_NAMES = ("gain", "bias", "time_offset")
BlockScope = Literal["board", "recording", "unit"]
TermKey = tuple[str, tuple[int, ...], tuple[float, ...]]


@dataclass(frozen=True, slots=True, eq=False)
class ParameterBlock:
    """Parameters that belong together: a gain, a bias, a time offset, or a cause's values."""

    name: str  # "gain", "bias", "time_offset", or the label of a cause
    scope: BlockScope
    board: int | None  # None: all boards share it
    recording: int | None  # None: all recordings share it
    parameter_names: tuple[str, ...]
    prior_std: FloatArray  # (k,)
    start: int  # of its first parameter

    @property
    def size(self) -> int:
        """The number of its parameters."""
        return len(self.parameter_names)

    @property
    def positions(self) -> range:
        """The positions of its parameters."""
        return range(self.start, self.start + self.size)


class ParameterLayout:
    """The parameters of a fit of one or more boards, in their order."""

    def __init__(
        self, blocks: Sequence[ParameterBlock], term_blocks: Sequence[Sequence[ParameterBlock]]
    ) -> None:
        """Use `of` instead.

        Args:
            blocks: of all parameters, in their order.
            term_blocks: for each board, the blocks of its causes.
        """
        self.blocks = tuple(blocks)
        self._term_blocks = tuple(tuple(blocks_of_board) for blocks_of_board in term_blocks)
        self._by_key = {(block.name, block.board, block.recording): block for block in blocks}
        self.size = sum(block.size for block in blocks)
        self.recording_count = sum(block.name == "bias" and block.board == 0 for block in blocks)

    @classmethod
    def of(
        cls,
        terms_of_boards: Sequence[Sequence[FittedTerm]],
        recording_count: int,
        shared_labels: Collection[str] = (),
    ) -> "ParameterLayout":
        """Return the layout of a fit.

        Args:
            terms_of_boards: the causes of each board.
            recording_count: number of recordings of each board.
            shared_labels: of the unit-wide causes.
        """
        builder = _LayoutBuilder()
        term_blocks = []
        shared_blocks: dict[TermKey, ParameterBlock] = {}
        for board, fitted_terms in enumerate(terms_of_boards):
            builder.add_base(board, recording_count)
            blocks_of_board = []
            for fitted_term in fitted_terms:
                if not is_shared_term(fitted_term, shared_labels):
                    blocks_of_board.append(builder.add_term(fitted_term, "board", board))
                    continue
                key = identify_term(fitted_term)
                if key not in shared_blocks:
                    shared_blocks[key] = builder.add_term(fitted_term, "unit", None)
                blocks_of_board.append(shared_blocks[key])
            term_blocks.append(blocks_of_board)
        return cls(builder.blocks, term_blocks)

    @property
    def board_count(self) -> int:
        """The number of boards."""
        return len(self._term_blocks)

    @property
    def prior_std(self) -> FloatArray:
        """The prior standard deviation of each parameter, shape (size,)."""
        return np.concatenate([block.prior_std for block in self.blocks])

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """The name of each parameter, with the recording and the board if there are several."""
        return tuple(
            name + self._suffix(block) for block in self.blocks for name in block.parameter_names
        )

    @property
    def first_term(self) -> int:
        """The position of the first cause of a single board."""
        return GAIN_PARAMETERS + SESSION_PARAMETERS * self.recording_count

    def term_blocks(self, board: int = 0) -> tuple[ParameterBlock, ...]:
        """Return the blocks of a board's causes, in the order of the causes."""
        return self._term_blocks[board]

    def term_index(self, board: int = 0) -> IntArray:
        """Return the positions of the values of a board's causes."""
        return _positions(self._term_blocks[board])

    def index(
        self, recording: int, board: int = 0, offset_recording: int | None = None
    ) -> IntArray:
        """Return the positions of the columns of one recording's equations: G, b, tau, causes.

        Args:
            recording: number of the recording.
            board: number of the board.
            offset_recording: take the time offset of that recording.
        """
        offset = recording if offset_recording is None else offset_recording
        return _positions(
            [
                self._by_key["gain", board, None],
                self._by_key["bias", board, recording],
                self._by_key["time_offset", board, offset],
                *self._term_blocks[board],
            ]
        )

    def board_index(self, board: int) -> IntArray:
        """Return the positions of one board's parameters: G, each (b, tau), causes."""
        base = [block for block in self.blocks if block.board == board and block.name in BASE_NAMES]
        return _positions([*base, *self._term_blocks[board]])

    def session_index(self) -> IntArray:
        """Return the positions of each recording's bias and time offset, of all boards."""
        return _positions([block for block in self.blocks if block.scope == "recording"])

    def is_shared(self, index: IntArray) -> BoolArray:
        """Return which of some positions belong to all boards."""
        shared = _positions([block for block in self.blocks if block.scope == "unit"])
        return np.asarray(np.isin(index, shared), dtype=np.bool_)

    def _suffix(self, block: ParameterBlock) -> str:
        text = ""
        if block.recording is not None and self.recording_count > 1:
            text += f" of recording {block.recording + 1}"
        if block.board is not None and self.board_count > 1:
            text += f" of board {block.board + 1}"
        return text


class _LayoutBuilder:
    """Appends blocks in sequence."""

    def __init__(self) -> None:
        self.blocks: list[ParameterBlock] = []
        self._size = 0

    def add_base(self, board: int, recording_count: int) -> None:
        """Append the gain, and the bias and time offset of each recording."""
        self._add("gain", "board", board, None, GAIN_NAMES)
        for recording in range(recording_count):
            self._add("bias", "recording", board, recording, BIAS_NAMES)
            self._add("time_offset", "recording", board, recording, ("time_offset",))

    def add_term(
        self, fitted_term: FittedTerm, scope: BlockScope, board: int | None
    ) -> ParameterBlock:
        """Append the fitted values of a cause."""
        label = term_label(fitted_term.term)
        return self._add(label, scope, board, None, fitted_term.names, fitted_term.prior_std)

    def _add(
        self,
        name: str,
        scope: BlockScope,
        board: int | None,
        recording: int | None,
        names: tuple[str, ...],
        std: FloatArray | None = None,
    ) -> ParameterBlock:
        std = prior_std(names) if std is None else std
        block = ParameterBlock(name, scope, board, recording, names, std, self._size)
        self.blocks.append(block)
        self._size += block.size
        return block


def is_shared_term(fitted_term: FittedTerm, shared_labels: Collection[str]) -> bool:
    """Return whether a term is fitted as unit-wide."""
    return bool(fitted_term.free_indices.size) and term_label(fitted_term.term) in shared_labels


def identify_term(fitted_term: FittedTerm) -> TermKey:
    """Return the key that identifies a term on two boards: its name and all fixed values."""
    fixed_values = np.delete(fitted_term.values, fitted_term.free_indices)
    return (
        term_label(fitted_term.term),
        tuple(fitted_term.free_indices.tolist()),
        tuple(np.round(fixed_values, 12).tolist()),
    )


def _positions(blocks: Sequence[ParameterBlock]) -> IntArray:
    return np.array([k for block in blocks for k in block.positions], dtype=np.int64)


def eliminate_parameters(
    information: FloatArray, keep: IntArray, prior_std: FloatArray
) -> FloatArray:
    """Return the information about some parameters, with all others eliminated (Schur complement).

    Args:
        information: of all parameters, (p, p).
        keep: positions of the parameters to keep.
        prior_std: of all parameters, (p,).
    """
    drop = np.setdiff1d(np.arange(information.shape[0]), keep)
    if not drop.size:
        return information
    # A weak prior, because a recording at rest does not determine its offset.
    dropped_information = information[np.ix_(drop, drop)] + np.diag(1e-6 / prior_std[drop] ** 2)
    cross = information[np.ix_(keep, drop)]
    reduced = information[np.ix_(keep, keep)] - cross @ np.linalg.solve(
        dropped_information, cross.T
    )
    return np.asarray((reduced + reduced.T) / 2.0, dtype=np.float64)
