"""The bias follows the temperature.

b(T) = sum over p of k_p (T - T0)^p, p = 1 to the order, T0 the recordings' mean. The die is
not where the thermometer is: with lag > 0 the thermometer is late, T_die = T + lag dT/dt;
with lag < 0 the die is, T_die' = (T - T_die)/|lag|; to first order both are T + lag dT/dt.
Data sheets: 0.03 dps/K (L3G4200D, its front page's table as remembered), 0.24 dps/K
(MPU-6500), 0.005 (ICM-42688-P); +-20 dps over 125 K (MPU-6050) is 0.16 dps/K. Lags of 10 to
60 s between sensor and die; without one a lagged bias is called a warm-up.
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import LinearTerm, scanned
from gyrorig_solver.model.terms.protocol import Link, Part, TermParameter
from gyrorig_solver.model.terms.scene import Scene, by_axis
from gyrorig_solver.model.terms.wording import DEG, XYZ, listed

SPAN_K = 10.0  # over which a polynomial is described; typical sizes are those at its end
LEAST_SPAN_K = 0.5  # thermometers report 0.1 to 1 K
_TYPICAL_DPS_K = 0.03
_LARGEST_DPS_K = 0.5
LONGEST_LAG_S = 120.0
NAMES = ("slope", "square", "cube")


class ThermalBias(LinearTerm):
    """Coefficients of each order for x, y, z, then the lag."""

    cause = "thermal_bias"
    part: Part = "sensor"
    link: Link = "bias"
    confused_with = ("warm_up", "bias_ramp", "bias_step", "bias_random_walk")
    excitation = "heat, cool and heat again while resting between moves"
    harm = "the bias is right at the temperature of the recording only"

    def __init__(self, order: int = 1) -> None:
        """Take a polynomial of order 1 to 3."""
        if not 1 <= order <= len(NAMES):
            raise ValueError(f"order {order} is not 1 to {len(NAMES)}")
        self.order = order
        sizes = []
        for power, name in enumerate(NAMES[:order], start=1):
            # A curvature is taken as strong as a tenth of the slope at the span's end.
            scale = DEG * SPAN_K ** (1 - power) * 0.1 ** min(power - 1, 1)
            sizes.append(
                TermParameter(
                    name=name,
                    unit="rad/s/K" + (f"^{power}" if power > 1 else ""),
                    typical=_TYPICAL_DPS_K * scale,
                    lower=-_LARGEST_DPS_K * scale,
                    upper=_LARGEST_DPS_K * scale,
                    prior_std=_LARGEST_DPS_K * scale,
                    parts=XYZ,
                )
            )
        lag = TermParameter(
            name="lag",
            unit="s",
            typical=20.0,
            lower=-LONGEST_LAG_S,
            upper=LONGEST_LAG_S,
            prior_std=30.0,
            role="shape",
        )
        self.parameters = (*sizes, lag)

    def basis(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return powers of the die's temperature on each axis, (3 order, blocks, 3)."""
        degc = at_die(scene, float(values[-1]))
        powers = np.stack([degc ** (p + 1) for p in range(self.order)])
        seen = scene.seen(np.repeat(powers[:, :, None], 3, axis=2))
        return np.concatenate([by_axis(one) for one in seen])

    def missing(self, scene: Scene) -> str | None:
        """Say that there is no temperature, or that it stayed the same."""
        return no_temperature(scene)

    def bank(self, scene: Scene) -> FloatArray:
        """Scan the lag."""
        return scanned(self, lag=np.array([-60.0, -30.0, -15.0, 0.0, 15.0, 30.0, 60.0]))

    def sentence(self, values: FloatArray) -> str:
        """Say the slopes."""
        slopes = listed(values[:3] / DEG * 1e3, XYZ, "mdeg/s per kelvin")
        late = f", the thermometer {values[-1]:.0f} s late" if values[-1] else ""
        return f"the bias follows the temperature: {slopes}{late}"


def at_die(scene: Scene, lag_s: float) -> FloatArray:
    """Return the die's temperature minus the mean, shape (n,); zeros without a thermometer."""
    temperature = scene.setting.temperature
    return np.zeros(scene.n) if temperature is None else temperature.at(scene.time_s, lag_s)


def no_temperature(scene: Scene) -> str | None:
    """Return why thermal causes cannot be looked at, None where they can."""
    if scene.setting.temperature is None:
        return "the recording has no temperature; record the board's thermometer"
    span = scene.setting.temperature.span_k
    if span < LEAST_SPAN_K:
        return f"the temperature changed by {span:.1f} K only; warm the board by 10 K or more"
    return None


TERM = ThermalBias()
