"""How much of each cause's effect its own term leaves where there is no noise: goal 9.

What to use when: `Left` is one line of what `tests/hidden/completeness.py --json` wrote; `said` the
table, with the goal's bar beside each.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
from docs.markdown import table
from tests.hidden.scoring.goals import COMPLETE_LEFT

UNSEEN = 1.0  # energy of an effect that the base model takes up whole


@dataclass(frozen=True, slots=True)
class Left:
    """Energies of one cause at its typical size, whitened: twice the nats."""

    cause: str
    place: str
    program: str
    soak_k: float
    effect: float  # beside the base model
    left: float  # beside its term too

    @property
    def share(self) -> float:
        """Of the effect; none where the base model takes it up."""
        return self.left / self.effect if self.effect >= UNSEEN else 0.0


def read(path: Path) -> list[Left]:
    """Return what `completeness.py` wrote."""
    return msgspec.json.decode(path.read_bytes(), type=list[Left])


def said(found: Sequence[Left]) -> str:
    """Return the table, the causes that leave most first."""
    rows = [
        (f"`{one.cause}`" + (f" {one.place}" if one.place else ""),
         f"`{one.program}`" + (f", {one.soak_k:g} K" if one.soak_k else ""),
         f"{one.effect:.4g}",
         "taken up by the base" if one.effect < UNSEEN else f"{100.0 * one.share:.3f} %",
         "" if one.effect < UNSEEN else "met" if one.share <= COMPLETE_LEFT else "missed")
        for one in sorted(found, key=lambda one: (one.effect < UNSEEN, -one.share))
    ]  # fmt: skip
    head = ("cause", "session", "energy of the effect", "left by its term", "goal 9, 0.2 %")
    return table(head, rows)
