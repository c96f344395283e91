"""A line in the output: the mains, or what supplies the board.

y_i += c_i cos(2 pi f t) + s_i sin(2 pi f t) at the samples' instants: picked up behind the
sensing element, folded by sampling and weakened by the block means, both of which come by
themselves. 50 or 60 Hz and their doubles; the true frequency, not where it is folded to.
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import LinearTerm, scanned
from gyrorig_solver.model.terms.protocol import Link, Part, Scope, TermParameter
from gyrorig_solver.model.terms.scene import Scene, by_axis
from gyrorig_solver.model.terms.wording import DEG, XYZ, listed

MAINS_HZ = (50.0, 60.0, 100.0, 120.0)
MAINS_SPREAD_HZ = 0.1  # at 50 and 60 Hz; grids keep to +-0.2 and mostly to +-0.05
MOST_LINES = 400
FEWEST_WAVES = 3.0  # of a recording: less of one is a drift, whatever made it


def waves(frequency_hz: FloatArray, rate_hz: float, length_s: float) -> FloatArray:
    """Return how many waves of lines a recording shows, folded by its sampling.

    Args:
        frequency_hz: true ones.
        rate_hz: of the sampling.
        length_s: of the recording.
    """
    folded = np.abs((frequency_hz + rate_hz / 2.0) % rate_hz - rate_hz / 2.0)
    return np.asarray(folded * length_s, dtype=np.float64)


class SupplyHum(LinearTerm):
    """Cosine, then sine, for x, y, z each; then the frequency."""

    cause = "supply_hum"
    part: Part = "sensor"
    link: Link = "readout"
    scope: Scope = "recording"
    parameters = (
        TermParameter(
            name="cosine",
            unit="rad/s",
            typical=0.03 * DEG,
            lower=-5.0 * DEG,
            upper=5.0 * DEG,
            prior_std=1.0 * DEG,
            parts=XYZ,
        ),
        TermParameter(
            name="sine",
            unit="rad/s",
            typical=0.03 * DEG,
            lower=-5.0 * DEG,
            upper=5.0 * DEG,
            prior_std=1.0 * DEG,
            parts=XYZ,
        ),
        TermParameter(
            name="frequency",
            unit="Hz",
            typical=0.01,
            lower=0.05,
            upper=2000.0,
            prior_std=100.0,
            role="shape",
            start=50.0,
        ),
    )
    confused_with = ("worm_error", "ringing")
    excitation = "rests of ten seconds and more; it is there at rest too"
    harm = "little: it is out of the motion's way; the noise looks larger"

    def basis(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return cosine and sine on each axis, (6, blocks, 3)."""
        phase = 2.0 * np.pi * float(values[6]) * (scene.instants_s - scene.setting.begin_s)
        waves = np.stack([np.cos(phase), np.sin(phase)])
        seen = scene.mean(np.repeat(waves[:, :, None], 3, axis=2))
        return np.concatenate([by_axis(one) for one in seen])

    def bank(self, scene: Scene) -> FloatArray:
        """Scan the mains as finely as the recording resolves.

        Other lines are found in the residual's periodogram and refined from there.
        """
        length_s = max(scene.setting.end_s - scene.setting.begin_s, 1.0)
        found = []
        for mains in MAINS_HZ:
            spread = MAINS_SPREAD_HZ * mains / 50.0
            count = min(MOST_LINES, 2 * int(np.ceil(2.0 * spread * length_s)) + 1)
            found.append(mains + np.linspace(-spread, spread, count))
        return scanned(self, frequency=np.concatenate(found))

    def sentence(self, values: FloatArray) -> str:
        """Say size and frequency."""
        size = np.hypot(values[:3], values[3:6]) / DEG * 1e3
        return f"a line at {values[6]:.2f} Hz shows: {listed(size, XYZ, 'mdeg/s')}"


TERM = SupplyHum()
