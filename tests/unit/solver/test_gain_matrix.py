"""G = S T M against scipy's rotations and against numerical derivatives."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gyrorig_solver.model import factor_jacobian, factorise
from gyrorig_solver.model.gain_matrix import left_jacobian, rotation_matrix, rotation_vector


@pytest.mark.parametrize("seed", range(40))
def test_factors_multiply_back_and_m_is_a_rotation(seed: int) -> None:
    gain = np.random.default_rng(seed).normal(size=(3, 3))
    factors = factorise(gain)
    assert np.allclose(factors.gain, gain, atol=1e-10)
    assert np.linalg.det(factors.M) == pytest.approx(1.0, abs=1e-12)
    assert np.allclose(factors.M.T @ factors.M, np.eye(3), atol=1e-12)
    assert np.all(np.diag(factors.T) == 1.0)


def test_known_factors_are_recovered() -> None:
    rotation = Rotation.from_rotvec([0.02, -0.15, 0.01]).as_matrix()
    lower = np.array([[1, 0, 0], [0.01, 1, 0], [-0.02, 0.005, 1]])
    scale = np.array([0.95, 1.02, 0.88])
    factors = factorise(np.diag(scale) @ lower @ rotation)
    assert np.allclose(factors.scale, scale, atol=1e-12)
    assert np.allclose(factors.nonorthogonality, [0.01, -0.02, 0.005], atol=1e-12)
    assert np.allclose(factors.misalignment_rad, [0.02, -0.15, 0.01], atol=1e-12)


def test_mirrored_axis_has_a_negative_scale() -> None:
    factors = factorise(np.diag([1.0, -0.98, 1.01]) @ rotation_matrix(np.array([0.01, 0.02, 0.0])))
    assert np.sign(factors.scale).tolist() == [1.0, -1.0, 1.0]
    assert np.linalg.norm(factors.misalignment_rad) < 0.05


def test_singular_gain_is_rejected() -> None:
    with pytest.raises(ValueError, match="singular"):
        factorise(np.diag([1.0, 0.0, 1.0]))


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 0.5, 2.0, 3.1, np.pi])
def test_rotation_vectors_agree_with_scipy(angle: float) -> None:
    axis = np.array([1.0, -2.0, 0.5]) / np.linalg.norm([1.0, -2.0, 0.5])
    matrix = Rotation.from_rotvec(axis * angle).as_matrix()
    assert np.allclose(rotation_matrix(axis * angle), matrix, atol=1e-12)
    back = rotation_vector(matrix)
    assert np.allclose(Rotation.from_rotvec(back).as_matrix(), matrix, atol=1e-7)


def test_jacobian_agrees_with_central_differences() -> None:
    rng = np.random.default_rng(5)
    gain = np.eye(3) + rng.normal(scale=0.1, size=(3, 3))
    step = 1e-6
    numeric = np.empty((9, 9))
    for k in range(9):
        change = step * np.eye(9)[k].reshape(3, 3)
        up, down = factorise(gain + change), factorise(gain - change)
        numeric[:, k] = (up.as_vector() - down.as_vector()) / (2.0 * step)
    assert np.allclose(factor_jacobian(factorise(gain)), numeric, atol=1e-7)


def test_left_jacobian_agrees_with_central_differences() -> None:
    r = np.array([0.3, -0.7, 0.2])
    for k in range(3):
        h = 1e-6 * np.eye(3)[k]
        turn = rotation_matrix(r + h) @ rotation_matrix(r - h).T
        assert np.allclose(rotation_vector(turn) / 2e-6, left_jacobian(r)[:, k], atol=1e-7)
