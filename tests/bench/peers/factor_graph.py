"""GTSAM on the same rate model: one custom factor for each second, analytic Jacobians.

What to use when: `installed` first; then `solve`. GTSAM is no dependency of this project: where
it is not installed the bench says so and goes on. Its own IMU factors carry no gain,
so the model is ours to write; a factor a sample would only be slower.
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


def installed() -> bool:
    """True where GTSAM can be imported."""
    return find_spec(PACKAGE) is not None


def version() -> str:
    """Which one."""
    return installed_version(PACKAGE)


def solve(table: Table) -> FloatArray:
    """Return G, bias and offset by GTSAM's Levenberg-Marquardt, and the roots of its marginals."""
    gtsam = import_module(PACKAGE)
    stage = CubicSpline(table.time_s, table.stage_rad_s)
    slope = stage.derivative()
    sigma = table.measured_rad_s[table.static].std(axis=0) + 1e-9
    graph, key = gtsam.NonlinearFactorGraph(), 0
    at = np.flatnonzero(table.use)
    for part in np.array_split(at, max(1, round(at.size / table.rate_hz))):
        noise = gtsam.noiseModel.Diagonal.Sigmas(np.tile(sigma, part.size))
        error = partial(_error, stage, slope, table.time_s[part], table.measured_rad_s[part])
        graph.add(gtsam.CustomFactor(noise, [key], error))
    start = gtsam.Values()
    start.insert(key, np.concatenate([np.eye(3).ravel(), np.zeros(4)]))
    estimate = gtsam.LevenbergMarquardtOptimizer(graph, start).optimize()
    std = np.full(13, np.nan)
    # Where a direction is hidden it refuses the covariance, and does not say which.
    with contextlib.suppress(RuntimeError):
        std = np.sqrt(np.diag(gtsam.Marginals(graph, estimate).marginalCovariance(key)))
    return np.stack([estimate.atVector(key), std])


def _error(
    stage: Any,
    slope: Any,
    time_s: FloatArray,
    measured_rad_s: FloatArray,
    factor: Any,
    values: Any,
    jacobians: list[FloatArray] | None,
) -> FloatArray:
    """Return what the model of one second has too much, and its derivatives."""
    x = values.atVector(factor.keys()[0])
    gain = x[:9].reshape(3, 3)
    turned = stage(time_s - x[12])
    if jacobians is not None:
        by = np.zeros((time_s.size, 3, 13))
        for row in range(3):
            by[:, row, 3 * row : 3 * row + 3] = turned
            by[:, row, 9 + row] = 1.0
        by[:, :, 12] = -slope(time_s - x[12]) @ gain.T
        jacobians[0] = by.reshape(-1, 13)
    return np.asarray((turned @ gain.T + x[9:12] - measured_rad_s).ravel())
