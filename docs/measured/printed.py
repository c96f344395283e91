"""Results of other programs on the same files, as these programs printed them."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.data import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ImuTkResult:
    """x' = T K (x - b): counts into rad/s in the accelerometer's frame."""

    T: FloatArray  # (3, 3)
    T_std: FloatArray  # (3, 3), zero on the diagonal, which is not fitted
    K_rad_s: FloatArray  # (3,), per count
    K_std_rad_s: FloatArray  # (3,)
    b_counts: FloatArray  # (3,)
    fitted_bias_counts: FloatArray  # (3,), if the program also fits the bias

    def compute_gain(self, scale_rad_s: float) -> FloatArray:
        """Return G of our model: reading in counts x `scale_rad_s` per true rate."""
        return np.asarray(np.linalg.inv(self.T @ np.diag(self.K_rad_s)) * scale_rad_s)

    def propagate_std(
        self, function: Callable[[FloatArray], FloatArray], scale_rad_s: float
    ) -> FloatArray:
        """Return the standard deviation of a function of the gain, from its nine parameters.

        The program does not print the correlations of the parameters, so they are zero here.
        """
        made = function(self.compute_gain(scale_rad_s))
        square = np.zeros_like(made)
        for i, j in np.ndindex(3, 3):
            moved = self.T.copy()
            moved[i, j] += self.T_std[i, j]
            square += (function(replace(self, T=moved).compute_gain(scale_rad_s)) - made) ** 2
        for i in range(3):
            scales = self.K_rad_s.copy()
            scales[i] += self.K_std_rad_s[i]
            square += (
                function(replace(self, K_rad_s=scales).compute_gain(scale_rad_s)) - made
            ) ** 2
        return np.asarray(np.sqrt(square), np.float64)


# imu_tk (Kyle-ak/imu_tk, commit 7780270), `test_imu_calib xsens_acc.mat xsens_gyro.mat`: threshold
# multiplier 6, 37 moves, first 50 s at rest, g = 9.81744; the bias is the mean of the first rest.
# Its standard deviations are from the covariance of the least squares, scaled by the residual.
IMU_TK = ImuTkResult(
    T=np.array(
        [
            [1.0, 0.00593634, 0.00111101],
            [0.00808812, 1.0, -0.0535569],
            [0.0253067, -0.0025513, 1.0],
        ]
    ),
    T_std=np.array([[0.0, 0.0010, 0.0011], [0.0010, 0.0, 0.0014], [0.0011, 0.0010, 0.0]]),
    K_rad_s=np.array([2.09295e-4, 2.09899e-4, 2.09483e-4]),
    K_std_rad_s=np.array([1.4e-7, 1.3e-7, 1.9e-7]),
    b_counts=np.array([32777.1, 32459.8, 32511.8]),
    fitted_bias_counts=np.array([32771.1, 32458.4, 32513.3]),
)

# tomisuarez2/ImuCalibration, commit 1c30280, "optmization result data/params_gyro.csv": six
# misalignments, then these. This is the result of the example in that repository. The repository
# does not state whether the result is from this file.
IMU_CALIBRATION_SCALE_RAD_S = np.array(
    [1.373743743438648286e-4, 1.329249743689399734e-4, 1.339443406342994032e-4]
)  # per count
IMU_CALIBRATION_BIAS_COUNTS = np.array(
    [-4.274617614746093750e02, 1.479479370117187500e02, -8.072266387939453125e01]
)
