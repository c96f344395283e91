"""Samples of a gyro made from times and rates, without a recording in between.

What to use when: `plain_samples` for tests and benchmarks of a fit.
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.clocks import ClockMap
from gyrorig_solver.data.samples import GyroSamples


def plain_samples(
    time_s: FloatArray, rate_rad_s: FloatArray, accel_m_s2: FloatArray | None = None
) -> GyroSamples:
    """Return samples as `load_samples` would, all good.

    Args:
        time_s: shape (n,).
        rate_rad_s: shape (n, 3).
        accel_m_s2: shape (n, 3), if the board has an accelerometer.
    """
    n = time_s.size
    clock = ClockMap(
        time_s=time_s,
        segment=np.zeros(n, np.int64),
        late=np.zeros(n, np.bool_),
        skew_ppm=0.0,
        wander_bound_s=0.0,
        latency_s=np.zeros(3),
        restarts=0,
        wraps=0,
    )
    return GyroSamples(
        board="T",
        metadata={},
        origin_ns=0,
        time_s=time_s,
        host_s=time_s,
        number=np.arange(n),
        segment=np.zeros(n, np.int64),
        rate_rad_s=rate_rad_s,
        usable=np.ones(n, np.bool_),
        accel_m_s2=accel_m_s2,
        temperature_degc=None,
        quantum_rad_s=1e-7,
        clock=clock,
        latency_bounds=None,
        lost=0,
        repeated=0,
        late=0,
    )
