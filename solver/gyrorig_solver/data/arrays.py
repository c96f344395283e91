"""Array types used in the signatures of the solver."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
RealArray = NDArray[np.floating[Any]]  # of single or double precision
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
