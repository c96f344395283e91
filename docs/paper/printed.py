"""Numbers of Tables 1 to 3, exactly as the paper prints them.

Source: Delgado, Silva, Quiroz, Kurka, "Automatic Calibration of Low Cost Inertial Gyroscopes
with a PTU". The paper prints Table 2 without a unit.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PrintedBoard:
    """One column of Tables 1 to 3."""

    name: str
    sensitivity: float  # Table 1, "Sensitivity", with a degree sign only
    bias_static: FloatArray  # Table 2
    bias_quasi_static: FloatArray  # Table 2
    S: FloatArray  # Table 3
    T: FloatArray
    M: FloatArray
    improvement_percent: float  # section V

    @property
    def STM(self) -> FloatArray:
        """The gain matrix, as the product of the three printed factors."""
        return np.asarray(self.S @ self.T @ self.M)


GY80 = PrintedBoard(
    name="GY80",
    sensitivity=0.00875,
    bias_static=np.array([0.106, -0.004, -0.034]),
    bias_quasi_static=np.array([-0.090, 0.040, -0.127]),
    S=np.diag([0.9482, 0.9734, 0.8854]),
    T=np.array([[1.0, 0.0, 0.0], [-0.0155, 1.0, 0.0], [-0.0312, -0.1504, 1.0]]),
    M=np.array([[0.9988, -0.0078, -0.0481], [0.0004, 0.9883, -0.1524], [0.0487, 0.1522, 0.9871]]),
    improvement_percent=5.93,
)

MPU = PrintedBoard(
    name="MPU 6515",
    sensitivity=0.07445,
    bias_static=np.array([0.0135, 0.0258, 0.0074]),
    bias_quasi_static=np.array([0.0327, -0.0021, 0.0300]),
    S=np.diag([0.9865, 1.0352, 0.9517]),
    T=np.array([[1.0, 0.0, 0.0], [0.0359, 1.0, 0.0], [0.0481, 0.0321, 1.0]]),
    M=np.array([[0.9989, 0.0351, 0.0313], [-0.0106, 0.9885, 0.0309], [-0.0302, -0.0320, 0.9990]]),
    improvement_percent=0.96,
)

BOARDS = (GY80, MPU)
