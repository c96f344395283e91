"""Effects outside the catalogue, and effects similar to a cause, for hidden tests only.

What to use when: `OUTSIDE` and `NEARLY` for the shapes by name. The option `--hide` does not have
these names.
"""

from tests.hidden.truth.outside.nearly import NEARLY
from tests.hidden.truth.outside.shape import Shape
from tests.hidden.truth.outside.strange import OUTSIDE

SHAPES: dict[str, Shape] = {**OUTSIDE, **NEARLY}

__all__ = ["NEARLY", "OUTSIDE", "SHAPES", "Shape"]
