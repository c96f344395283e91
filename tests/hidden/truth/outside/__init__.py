"""Effects that are in no catalogue, and some that are nearly in it, for hidden tests only.

What to use when: `OUTSIDE` and `NEARLY` for the shapes by name. No `--hide` reaches them.
"""

from tests.hidden.truth.outside.nearly import NEARLY
from tests.hidden.truth.outside.shape import Shape
from tests.hidden.truth.outside.strange import OUTSIDE

SHAPES: dict[str, Shape] = {**OUTSIDE, **NEARLY}

__all__ = ["NEARLY", "OUTSIDE", "SHAPES", "Shape"]
