"""One linearisation of the fit to reference attitudes, in the DCT domain.

What to use when: only inside `attitude_solver` and what reads its result.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import FloatArray, IntArray

# Share of the power of the gyro's slope that must be motion, to show the time offset. At rest, the
# slope had up to 2.2 times the power of the noise with this factor; in slow motion, 15 000 times.
MIN_SLOPE_SHARE = 0.75


@dataclass(frozen=True, slots=True, eq=False)
class LinearisedModel:
    """One linearisation in the DCT domain, all segments stacked, band-limited."""

    residual: FloatArray  # (n, 3)
    jacobian: FloatArray  # (n, 3, p), by G and each recording's (b, tau)
    variance: FloatArray  # (n, 3)
    regressor_noise: FloatArray  # (n, 3), variance of the estimated true rate
    slope_noise: FloatArray  # (n, 3), variance of the derivative by the lag, from the gyro's noise
    lag_index: IntArray  # (n,), the parameter of each row's time offset
    glitches: int

    def information(self) -> FloatArray:
        """Return J' V^-1 J minus the contribution of the regressor's noise, (p, p)."""
        weighted = self.jacobian / self.variance[:, :, None]
        info = np.einsum("nij,nik->jk", weighted, self.jacobian)
        for i in range(3):
            for j in range(3):
                noise_contribution = np.sum(self.regressor_noise[:, j] / self.variance[:, i])
                info[3 * i + j, 3 * i + j] -= min(
                    noise_contribution, 0.999 * info[3 * i + j, 3 * i + j]
                )
        # The slope of noise is no motion: at rest, the whole information on the lag is noise.
        for k in np.unique(self.lag_index).tolist():
            share = self.slope_share(k)
            info[k, k] *= share if share > MIN_SLOPE_SHARE else 0.001
        return np.asarray(info, dtype=np.float64)

    def slope_share(self, lag: int) -> float:
        """Return the share of the power of the gyro's slope that is motion, not noise.

        Args:
            lag: index of the time offset of a recording.
        """
        rows = self.lag_index == lag
        power = np.sum(self.jacobian[rows, :, lag] ** 2 / self.variance[rows])
        noise = np.sum(self.slope_noise[rows] / self.variance[rows])
        return 1.0 - float(noise) / max(float(power), 1e-30)

    def leverage(self, covariance: FloatArray) -> FloatArray:
        """Return the share of each residual's variance that the fit removes, (n, 3)."""
        predicted = np.einsum("nij,jk,nik->ni", self.jacobian, covariance, self.jacobian)
        return np.asarray(np.clip(predicted / self.variance, 0.0, 0.5), dtype=np.float64)

    def score(self) -> FloatArray:
        """Return J' V^-1 r, shape (p,)."""
        return np.asarray(
            np.einsum("nij,ni->j", self.jacobian, self.residual / self.variance), dtype=np.float64
        )
