"""The range that the sensor is set to is not the one that its counts are read by.

y' = 2^v y for all axes, v a whole number on most parts (250, 500, 1000, 2000 deg/s; an
L3G4200D has 250, 500, 2000): the scale takes it whole. It is told by the scale's distance
from 1, where a data sheet promises 2 to 15 %.
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import CurvedTerm, scanned
from gyrorig_solver.model.terms.protocol import Kind, Link, Part, TermParameter
from gyrorig_solver.model.terms.scene import Scene


class WrongFullScale(CurvedTerm):
    """One exponent of two."""

    cause = "wrong_full_scale"
    part: Part = "link"
    link: Link = "readout"
    kind: Kind = "gauge"
    parameters = (
        TermParameter("doublings", "1", typical=1.0, lower=-4.0, upper=4.0, prior_std=2.0),
    )
    confused_with = ("clock_skew",)
    excitation = "any motion; compare the scale with the data sheet's tolerance"
    harm = "none to the calibration; who trusts the configured range is off by the factor"

    def effect(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the change of the measured rate, (blocks, 3)."""
        factor = float(np.expm1(np.log(2.0) * values[0]))
        return factor * (scene.read(scene.filtered_rad_s) + scene.bias_rad_s)

    def bank(self, scene: Scene) -> FloatArray:
        """Look from ranges apart by a factor of two and four."""
        return scanned(self, doublings=np.array([-2.0, -1.0, 1.0, 2.0]))

    def sentence(self, values: FloatArray) -> str:
        """Say the factor."""
        return f"the counts are {2.0 ** values[0]:.3g} times what the configured range says"


TERM = WrongFullScale()
