"""The output stops short of the range: flat tops.

y_i is cut at +-L, L = full scale (1 - s), behind the low-pass, the bias in it. A part cuts
near 32767 counts, 15 % above its nominal range; supply or firmware may cut earlier. Samples
that say "saturated" are set aside before; this is for those that do not.
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import CurvedTerm, scanned
from gyrorig_solver.model.terms.protocol import Link, Part, TermParameter
from gyrorig_solver.model.terms.scene import Scene


class Saturation(CurvedTerm):
    """How far short of the full scale, as a share of it."""

    cause = "saturation"
    part: Part = "sensor"
    link: Link = "limit"
    reshapes: bool = True
    parameters = (
        TermParameter("shortfall", "1", typical=0.2, lower=0.0, upper=0.98, prior_std=1.0),
    )
    confused_with = ("scale_cubic", "low_pass_lag")
    excitation = "moves faster than the suspected limit, for half a second each"
    harm = "the scale comes out too small"

    def effect(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return what is cut off, (blocks, 3)."""
        full = scene.setting.full_scale_rad_s
        if full is None or values[0] == 0.0:
            return np.zeros((scene.blocks, 3))
        limit = full * (1.0 - float(values[0]))
        rate = scene.filtered_rad_s + scene.bias_rad_s
        return scene.read(np.clip(rate, -limit, limit) - rate)

    def passes(self, scene: Scene, values: FloatArray) -> FloatArray | None:
        """Return 1 where the rate is inside the limits, else 0: more of it does not show."""
        full = scene.setting.full_scale_rad_s
        if full is None or values[0] == 0.0:
            return None
        limit = full * (1.0 - float(values[0]))
        return np.asarray(np.abs(scene.filtered_rad_s + scene.bias_rad_s) < limit, np.float64)

    def bank(self, scene: Scene) -> FloatArray:
        """Look from limits an eighth apart, down to a fiftieth of the range."""
        return scanned(self, shortfall=1.0 - np.geomspace(0.02, 0.98, 30))

    def missing(self, scene: Scene) -> str | None:
        """Say that the range is not known."""
        if scene.setting.full_scale_rad_s is None:
            return "the range is not known; record the board's gyro_full_scale_dps"
        return None

    def sentence(self, values: FloatArray) -> str:
        """Say the limit."""
        return f"rates are cut off at {(1.0 - values[0]) * 100.0:.3g} % of the full scale"


TERM = Saturation()
