"""Attitudes that a filter computes from a gyro and an accelerometer, as loggers store them.

What to use when: `mahony_attitudes` and `madgwick_attitudes` for the attitudes after each sample.

Sources: R. Mahony, T. Hamel, J.-M. Pflimlin, IEEE Transactions on Automatic Control 53 (2008)
1203, equation 32, with the direction of gravity only; S. Madgwick, "An efficient orientation filter
for inertial and inertial/magnetic sensor arrays" (2010), equations 12, 25, 26 and 33. Nothing here
is shared with the solver.
"""

import math

import numpy as np

from gyrorig_solver.data import FloatArray


def mahony_attitudes(
    gyro_rad_s: FloatArray, force: FloatArray, rate_hz: float, kp: float = 1.0, ki: float = 0.0
) -> FloatArray:
    """Return the attitude after each sample, xyzw, body to world, (n, 4).

    Args:
        gyro_rad_s: shape (n, 3).
        force: specific force in any unit, shape (n, 3).
        rate_hz: of the samples.
        kp: gain of the direction's error, rad/s for each rad.
        ki: gain of its integral, which estimates the bias.
    """
    q, sums, step_s = _first_attitude(force[0]), [0.0, 0.0, 0.0], 1.0 / rate_hz
    attitudes = np.zeros((len(force), 4))
    for k, (rate, acceleration) in enumerate(zip(gyro_rad_s.tolist(), force.tolist(), strict=True)):
        error = _cross(_unit(acceleration), _gravity_direction(q))
        sums = [total + ki * step_s * e for total, e in zip(sums, error, strict=True)]
        corrected = [w + kp * e + s for w, e, s in zip(rate, error, sums, strict=True)]
        derivative = _half_product(q, corrected)
        q = _unit([a + step_s * b for a, b in zip(q, derivative, strict=True)])
        attitudes[k] = (*q[1:], q[0])
    return attitudes


def madgwick_attitudes(
    gyro_rad_s: FloatArray, force: FloatArray, rate_hz: float, beta: float = 0.033
) -> FloatArray:
    """Return the attitude after each sample, xyzw, body to world, (n, 4).

    Args:
        gyro_rad_s: shape (n, 3).
        force: specific force in any unit, shape (n, 3).
        rate_hz: of the samples.
        beta: size of the gradient step; the publication recommends 0.033 for gravity.
    """
    q, step_s = _first_attitude(force[0]), 1.0 / rate_hz
    attitudes = np.zeros((len(force), 4))
    for k, (rate, acceleration) in enumerate(zip(gyro_rad_s.tolist(), force.tolist(), strict=True)):
        w, x, y, z = q
        f = [a - b for a, b in zip(_gravity_direction(q), _unit(acceleration), strict=True)]
        gradient = [
            -2.0 * y * f[0] + 2.0 * x * f[1],
            2.0 * z * f[0] + 2.0 * w * f[1] - 4.0 * x * f[2],
            -2.0 * w * f[0] + 2.0 * z * f[1] - 4.0 * y * f[2],
            2.0 * x * f[0] + 2.0 * y * f[1],
        ]
        derivative = _half_product(q, rate)
        q = _unit(
            [
                a + step_s * (b - beta * c)
                for a, b, c in zip(q, derivative, _unit(gradient), strict=True)
            ]
        )
        attitudes[k] = (*q[1:], q[0])
    return attitudes


def _gravity_direction(q: list[float]) -> list[float]:
    """Return the upward direction in the body frame."""
    w, x, y, z = q
    return [2.0 * (x * z - w * y), 2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)]


def _half_product(q: list[float], rate: list[float]) -> list[float]:
    """Return the derivative of a quaternion at a body rate."""
    (w, x, y, z), (a, b, c) = q, rate
    return [
        0.5 * (-x * a - y * b - z * c),
        0.5 * (w * a + y * c - z * b),
        0.5 * (w * b - x * c + z * a),
        0.5 * (w * c + x * b - y * a),
    ]


def _cross(u: list[float], v: list[float]) -> list[float]:
    return [
        u[1] * v[2] - u[2] * v[1],
        u[2] * v[0] - u[0] * v[2],
        u[0] * v[1] - u[1] * v[0],
    ]


def _unit(values: list[float]) -> list[float]:
    length = math.sqrt(sum(v * v for v in values))
    return [v / length for v in values] if length > 0.0 else values


def _first_attitude(force: FloatArray) -> list[float]:
    """Return an attitude without heading whose gravity agrees with the first sample."""
    x, y, z = _unit(force.tolist())
    return _unit([1.0 + z, y, -x, 0.0])
