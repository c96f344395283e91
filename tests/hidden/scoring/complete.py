"""Residual of each cause's effect after its own term, without noise: goal 9.

What to use when: `Remainder` is one line that `tests/hidden/completeness.py --json` wrote;
`table_text` makes the table, with the limit of the goal.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
from docs.markdown import table
from tests.hidden.scoring.goals import COMPLETE_LEFT

UNSEEN = 1.0  # energy below which the base model absorbs the effect completely


@dataclass(frozen=True, slots=True)
class Remainder:
    """Energies of one cause at its typical size, whitened: twice the nats."""

    cause: str
    place: str
    program: str
    soak_k: float
    effect: float  # after the base model
    left: float  # after the base model and its term

    @property
    def share(self) -> float:
        """Share of the effect; 0 if the base model absorbs it."""
        return self.left / self.effect if self.effect >= UNSEEN else 0.0


def read(path: Path) -> list[Remainder]:
    """Return the results of `completeness.py`."""
    return msgspec.json.decode(path.read_bytes(), type=list[Remainder])


def table_text(remainders: Sequence[Remainder]) -> str:
    """Return the table, sorted by decreasing share of the residual."""
    rows = [
        (f"`{left.cause}`" + (f" {left.place}" if left.place else ""),
         f"`{left.program}`" + (f", {left.soak_k:g} K" if left.soak_k else ""),
         f"{left.effect:.4g}",
         "absorbed by the base model" if left.effect < UNSEEN else f"{100.0 * left.share:.3f} %",
         "" if left.effect < UNSEEN else "met" if left.share <= COMPLETE_LEFT else "missed")
        for left in sorted(remainders, key=lambda left: (left.effect < UNSEEN, -left.share))
    ]  # fmt: skip
    head = ("cause", "session", "energy of the effect", "residual after its term", "goal 9 (0.2 %)")
    return table(head, rows)
