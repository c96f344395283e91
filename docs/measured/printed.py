"""Results of others on the same files, as their own programs printed them."""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.arrays import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ImuTkResult:
    """x' = T K (x - b): counts into rad/s in the accelerometer's frame."""

    T: FloatArray  # (3, 3)
    K_rad_s: FloatArray  # (3,), per count
    b_counts: FloatArray  # (3,)
    bias_freed_counts: FloatArray  # (3,), when its program also fits the bias

    def gain(self, scale_rad_s: float) -> FloatArray:
        """G of our model: reading in counts x `scale_rad_s` per true rate."""
        return np.asarray(np.linalg.inv(self.T @ np.diag(self.K_rad_s)) * scale_rad_s)


# imu_tk (Kyle-ak/imu_tk, commit 7780270), `test_imu_calib xsens_acc.mat xsens_gyro.mat`: threshold
# multiplier 6, 37 moves, first 50 s at rest, g = 9.81744; bias held at the mean of the first rest.
IMU_TK = ImuTkResult(
    T=np.array(
        [
            [1.0, 0.00593634, 0.00111101],
            [0.00808812, 1.0, -0.0535569],
            [0.0253067, -0.0025513, 1.0],
        ]
    ),
    K_rad_s=np.array([2.09295e-4, 2.09899e-4, 2.09483e-4]),
    b_counts=np.array([32777.1, 32459.8, 32511.8]),
    bias_freed_counts=np.array([32771.1, 32458.4, 32513.3]),
)

# tomisuarez2/ImuCalibration, commit 1c30280, "optmization result data/params_gyro.csv": six
# misalignments, then these. Their example's own result; that it is of this very file is not said.
IMU_CALIBRATION_SCALE_RAD_S = np.array(
    [1.373743743438648286e-4, 1.329249743689399734e-4, 1.339443406342994032e-4]
)  # per count
IMU_CALIBRATION_BIAS_COUNTS = np.array(
    [-4.274617614746093750e02, 1.479479370117187500e02, -8.072266387939453125e01]
)
