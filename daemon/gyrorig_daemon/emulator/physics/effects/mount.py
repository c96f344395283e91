"""Board slip: a screw gives, and from an instant on the board sits turned on the stage.

The turn itself takes no time here, so that it adds no rate of its own.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class BoardSlip:
    """The mounting M is R M from an instant on."""

    rotation: FloatArray  # R, (3, 3)
    at_s: float

    def turned(self, time_s: FloatArray, vectors: FloatArray) -> FloatArray:
        """See `sensor.MountEffect`."""
        return np.where((time_s >= self.at_s)[:, None], vectors @ self.rotation.T, vectors)
