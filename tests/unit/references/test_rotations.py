"""Products of rotations against one-by-one products, and rates against closed forms."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.support.rotation_error import total_rotation

from gyrorig_solver.reference import path_product, prefix_products, turn_vectors
from gyrorig_solver.reference.rotations import integrated_rate, relative_vectors


@pytest.mark.parametrize("n", [1, 2, 3, 7, 64, 101])
def test_products_equal_one_by_one(n: int) -> None:
    vectors = np.random.default_rng(n).normal(size=(2, n, 3))
    prefix = prefix_products(vectors[0])
    np.testing.assert_allclose(path_product(vectors[0]), prefix[-1], atol=1e-12)
    for path in range(2):
        product = Rotation.identity()
        for k, vector in enumerate(vectors[path]):
            product = product * Rotation.from_rotvec(vector)
            if path == 0:
                np.testing.assert_allclose(prefix[k], product.as_matrix(), atol=1e-12)
        result = total_rotation(vectors)[path]
        assert (result.inv() * product).magnitude() < 1e-12


def test_signs_of_quaternions_do_not_matter() -> None:
    q = Rotation.from_rotvec(np.outer(np.arange(9) * 0.3, [0.0, 0.0, 1.0])).as_quat()
    q[::2] *= -1.0
    np.testing.assert_allclose(relative_vectors(q), np.tile([0.0, 0.0, 0.3], (8, 1)), atol=1e-12)


def coning(step_s: float) -> tuple[np.ndarray, np.ndarray]:
    """A cone of 0.4 rad at 3 Hz: attitudes and the exact integral of the body rate.

    Attitude = exp(-phi z) exp(a x) exp(phi z), phi = w t: the body rate is
    (a's part) w (exp(-phi z) exp(-a x) exp(phi z) (-z) + z), integrated on a fine grid.
    """
    a, w = 0.4, 2 * np.pi * 3.0

    def attitude(t: np.ndarray) -> Rotation:
        turn = Rotation.from_rotvec(np.outer(w * t, [0.0, 0.0, 1.0]))
        return turn.inv() * Rotation.from_rotvec([a, 0.0, 0.0]) * turn

    def rate(t: np.ndarray) -> np.ndarray:
        z = np.array([0.0, 0.0, 1.0])
        return w * (z - attitude(t).inv().apply(z))

    t = np.arange(40) * step_s
    fine, weight = np.polynomial.legendre.leggauss(12)
    nodes = t[:-1, None] + (fine + 1.0) / 2.0 * step_s
    values = rate(nodes.ravel()).reshape(39, 12, 3)
    return attitude(t).as_quat(), np.einsum("kmi,m->ki", values, weight) * step_s / 2.0


def test_integrated_rate_takes_the_cone_out() -> None:
    errors = {}
    for step_s in (0.01, 0.005):
        q, exact = coning(step_s)
        vectors = relative_vectors(q)
        plain = np.abs(vectors - exact)[1:-1].max()
        errors[step_s] = np.abs(integrated_rate(vectors, np.full(len(vectors), step_s)) - exact)[
            1:-1
        ].max()
        assert errors[step_s] < plain / 15.0
    # Fourth order over a step and better: halving the step leaves a sixteenth or less.
    assert errors[0.005] < errors[0.01] / 14.0


def test_turn_vectors_follow_the_cone() -> None:
    z, w = np.array([0.0, 0.0, 1.0]), 2 * np.pi * 3.0
    errors = []
    for step_s in (0.002, 0.001):
        q = coning(step_s)[0][: round(0.03 / step_s)]
        rate = w * (z - Rotation.from_quat(q).inv().apply(z))
        end = prefix_products(turn_vectors(rate, np.full(len(q) - 1, step_s)))[-1]
        true = (Rotation.from_quat(q[0]).inv() * Rotation.from_quat(q[-1])).as_matrix()
        errors.append(np.abs(end - true).max())
    assert errors[1] < 1e-5
    assert errors[1] < errors[0] / 3.0  # second order in the step
