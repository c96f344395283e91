"""Two axes have changed places: a word order read wrongly, a driver for another part.

y' = P y with P the exchange of two axes: the gain and the bias take it whole, as a gain far
from any rotation that a mount can have. It is told by the nearest signed permutation.
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import LinearTerm
from gyrorig_solver.model.terms.protocol import Kind, Link, Part, TermParameter
from gyrorig_solver.model.terms.scene import Scene

PAIRS = ((0, 1), (1, 2), (2, 0))


class AxisSwap(LinearTerm):
    """1 for a pair that is exchanged, 0 for one that is not."""

    cause = "axis_swap"
    part: Part = "link"
    link: Link = "readout"
    kind: Kind = "gauge"
    parameters = (
        TermParameter(
            "exchanged",
            "1",
            typical=1.0,
            lower=0.0,
            upper=1.0,
            prior_std=1.0,
            parts=("xy", "yz", "zx"),
        ),
    )
    confused_with = ("sign_flip",)
    excitation = "any motion; compare the mount with the gain's nearest signed permutation"
    harm = "none to the calibration, which holds for the axes as they come; the mount is another"

    def basis(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the difference of each pair in both places, (3, blocks, 3)."""
        rate = scene.read(scene.filtered_rad_s) + scene.bias_rad_s
        found = np.zeros((3, scene.blocks, 3))
        for k, (one, other) in enumerate(PAIRS):
            found[k, :, one] = rate[:, other] - rate[:, one]
            found[k, :, other] = rate[:, one] - rate[:, other]
        return found

    def sentence(self, values: FloatArray) -> str:
        """Say which axes."""
        said = [
            n for n, v in zip(("x and y", "y and z", "z and x"), values, strict=True) if v > 0.5
        ]
        return f"axes have changed places: {'; '.join(said) or 'none'}"


TERM = AxisSwap()
