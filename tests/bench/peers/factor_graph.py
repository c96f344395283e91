"""Fit the same rate model with GTSAM: one custom factor per second, with analytic Jacobians.

What to use when: call `is_installed` first, then `solve`. GTSAM is not a dependency of this
project, and the bench omits it if it is not installed. The IMU factors of GTSAM have no gain, so
this module contains the model. A factor per sample would be slower.
"""

import contextlib
from functools import partial
from importlib import import_module
from importlib.metadata import version as installed_version
from importlib.util import find_spec
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from tests.bench.accuracy.profile import FloatArray
from tests.bench.peers.recording import Table

PACKAGE = "gtsam"


def is_installed() -> bool:
    """Return whether GTSAM is installed."""
    return find_spec(PACKAGE) is not None


def read_version() -> str:
    """Return the version of GTSAM."""
    return installed_version(PACKAGE)


def solve(table: Table) -> FloatArray:
    """Fit gain, bias and time offset with GTSAM; return them and their standard uncertainties."""
    gtsam = import_module(PACKAGE)
    stage = CubicSpline(table.time_s, table.stage_rad_s)
    slope = stage.derivative()
    sigma = table.measured_rad_s[table.static].std(axis=0) + 1e-9
    graph, key = gtsam.NonlinearFactorGraph(), 0
    at = np.flatnonzero(table.use)
    for part in np.array_split(at, max(1, round(at.size / table.rate_hz))):
        noise = gtsam.noiseModel.Diagonal.Sigmas(np.tile(sigma, part.size))
        residual = partial(_residual, stage, slope, table.time_s[part], table.measured_rad_s[part])
        graph.add(gtsam.CustomFactor(noise, [key], residual))
    start = gtsam.Values()
    start.insert(key, np.concatenate([np.eye(3).ravel(), np.zeros(4)]))
    estimate = gtsam.LevenbergMarquardtOptimizer(graph, start).optimize()
    std = np.full(13, np.nan)
    # GTSAM gives no covariance if a direction is unobservable, and does not report the direction.
    with contextlib.suppress(RuntimeError):
        std = np.sqrt(np.diag(gtsam.Marginals(graph, estimate).marginalCovariance(key)))
    return np.stack([estimate.atVector(key), std])


def _residual(
    stage: Any,
    slope: Any,
    time_s: FloatArray,
    measured_rad_s: FloatArray,
    factor: Any,
    values: Any,
    jacobians: list[FloatArray] | None,
) -> FloatArray:
    """Return the residuals of one second (model minus measurement), and their derivatives."""
    x = values.atVector(factor.keys()[0])
    gain = x[:9].reshape(3, 3)
    rate = stage(time_s - x[12])
    if jacobians is not None:
        jacobian = np.zeros((time_s.size, 3, 13))
        for row in range(3):
            jacobian[:, row, 3 * row : 3 * row + 3] = rate
            jacobian[:, row, 9 + row] = 1.0
        jacobian[:, :, 12] = -slope(time_s - x[12]) @ gain.T
        jacobians[0] = jacobian.reshape(-1, 13)
    return np.asarray((rate @ gain.T + x[9:12] - measured_rad_s).ravel())
