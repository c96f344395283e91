"""Rows without an acceleration, which are nan, in the readers of accelerations."""

import numpy as np

from gyrorig_protocol.recording.encoding.sensor_imu_packing import pack_sensor_imu
from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate.attitude.block_segments import AccelerometerReadings


def test_a_covariate_is_interpolated_between_the_known_rows() -> None:
    time_s: FloatArray = np.linspace(0.0, 0.99, 100)
    force: FloatArray = np.outer(time_s, [1.0, 2.0, 0.0])
    force[:, 2] = 9.81
    gaps = force.copy()
    gaps[1::2] = np.nan
    at = AccelerometerReadings(((time_s, gaps),)).at(0, time_s[:99])
    assert at is not None
    np.testing.assert_allclose(at, force[:99], atol=1e-12)


def test_a_message_states_an_acceleration_that_was_not_measured() -> None:
    """The first covariance is -1 then, as sensor_msgs/Imu defines it."""
    force = np.array([[1.0, 2.0, 3.0], [np.nan, np.nan, np.nan]])
    payloads = pack_sensor_imu(np.array([1, 2]), "f", np.zeros((2, 3)), np.zeros((3, 3)), force)
    numbers = payloads[:, -37 * 8 :].copy().view("<f8")
    assert numbers[0, 25:29].tolist() == [1.0, 2.0, 3.0, 0.0]
    assert numbers[1, 25:29].tolist() == [0.0, 0.0, 0.0, -1.0]
