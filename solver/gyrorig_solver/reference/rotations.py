"""Vectorised rotation algebra: products along a path, and increments between attitudes.

What to use when: `prefix_products` for the attitudes along a path of small turns (for the
gravity estimator), and `path_product` for the attitude at its end only; `relative_vectors` for the
turn between neighbouring attitudes. Single rotations: scipy's Rotation, or `model.gain_matrix` for
the matrices of a mount.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from gyrorig_solver.data import FloatArray


def prefix_products(vectors_rad: FloatArray) -> FloatArray:
    """Return R_k = exp(v_0) exp(v_1) ... exp(v_k), shape (n, 3, 3).

    Args:
        vectors_rad: rotation vectors in the frame of the turning body, shape (n, 3).

    Prefix scan in log2(n) vectorised passes (Hillis and Steele 1986).
    """
    products = Rotation.from_rotvec(vectors_rad).as_matrix()
    step = 1
    while step < len(products):
        products[step:] = products[:-step] @ products[step:]
        step *= 2
    return np.asarray(products, dtype=np.float64)


def path_product(vectors_rad: FloatArray) -> FloatArray:
    """Return exp(v_0) exp(v_1) ... exp(v_n-1), shape (3, 3).

    Args:
        vectors_rad: rotation vectors in the frame of the turning body, shape (n, 3), n > 0.

    Neighbours are multiplied in pairs: n products in all, where `prefix_products` needs
    n log2(n).
    """
    products = Rotation.from_rotvec(vectors_rad).as_matrix()
    while len(products) > 1:
        pairs = products[:-1:2] @ products[1::2]
        products = np.concatenate([pairs, products[-1:]]) if len(products) % 2 else pairs
    return np.asarray(products[0], dtype=np.float64)


def relative_vectors(orientation_xyzw: FloatArray) -> FloatArray:
    """Return the turn from each attitude to the next, in the body's frame.

    Args:
        orientation_xyzw: unit quaternions, body into world, shape (n, 4); signs are free.

    Returns:
        Rotation vectors in rad, shape (n - 1, 3), of at most pi each.
    """
    attitude = Rotation.from_quat(orientation_xyzw)
    return np.asarray((attitude[:-1].inv() * attitude[1:]).as_rotvec(), dtype=np.float64)


def integrated_rate(vectors_rad: FloatArray, duration_s: FloatArray) -> FloatArray:
    """Return the integral of the body rate over each of several consecutive turns.

    A rotation vector is not that integral if the axis moves: Bortz' equation with a rate that is
    linear in time gives integral = phi - phi x w' h^2 / 12, with an error of fourth order. The
    derivative w' is computed from the two neighbouring steps.

    Args:
        vectors_rad: turns between attitudes, shape (n, 3).
        duration_s: of each turn, h, shape (n,).

    Source: Bortz, IEEE Trans. AES-7(1), 1971, eq. 8, integrated for a linear rate.
    """
    rate, derivative = vectors_rad / duration_s[:, None], np.zeros_like(vectors_rad)
    # Half of the steps on both sides, and the whole step between them.
    apart_s = duration_s[1:-1] + (duration_s[:-2] + duration_s[2:]) / 2.0
    derivative[1:-1] = (rate[2:] - rate[:-2]) / apart_s[:, None]
    change = derivative * duration_s[:, None] ** 2
    return np.asarray(vectors_rad - np.cross(vectors_rad, change) / 12.0, dtype=np.float64)


def turn_vectors(rate_rad_s: FloatArray, step_s: FloatArray) -> FloatArray:
    """Return the rotation vector of each step between samples of a body rate.

    The rate is treated as linear between two samples: mean rate times the step, plus the coning
    term (w_k x w_{k+1}) h^2 / 12 of the same equation.

    Args:
        rate_rad_s: rate at the samples, body frame, shape (n, 3).
        step_s: the n - 1 steps between them.

    Returns:
        Rotation vectors, shape (n - 1, 3).
    """
    before, after = rate_rad_s[:-1], rate_rad_s[1:]
    step = step_s[:, None]
    # The columns in cyclic order: `np.cross` takes longer than all other terms.
    cross = before[:, [1, 2, 0]] * after[:, [2, 0, 1]] - before[:, [2, 0, 1]] * after[:, [1, 2, 0]]
    coning = cross * step**2 / 12.0
    return np.asarray((before + after) / 2.0 * step + coning, dtype=np.float64)
