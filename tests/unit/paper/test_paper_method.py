"""Eq. 6 to 12 as printed: what they give, and that each failure is named."""

from dataclasses import replace

import numpy as np
import pytest
from docs.paper.motion import along, calibrated, paths, rotation_about_tilt_axis
from scipy.spatial.transform import Rotation

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.estimate import calibrate_as_printed
from gyrorig_solver.estimate.paper import paper_angles, paper_matrices
from gyrorig_solver.estimate.paper.paper_method import (
    FAILURES,
    READING_OF_TABLE_3,
    PaperReading,
    PaperResult,
)

SHORT_S = 2.0  # of static test, enough for samples without noise


def _corners(start: str) -> list[tuple[float, float]]:
    return next(corners for name, corners in paths().items() if name.startswith(start))


def _perfect(start: str, reading: PaperReading = READING_OF_TABLE_3) -> PaperResult:
    motion = along(_corners(start), static_s=SHORT_S)
    return calibrated(motion, motion.body_rate_rad_s(), "static", reading)


def test_composition_against_scipy() -> None:
    """Eq. 12 written out as a loop of scipy rotations, and eq. 11 as its Euler angles."""
    rng = np.random.default_rng(1)
    pan, tilt = rng.uniform(-0.4, 0.4, (2, 40)).cumsum(axis=1) * 0.3
    turned, expected = Rotation.identity(), []
    for pan_step, tilt_step in zip(np.diff(pan), np.diff(tilt), strict=True):
        turned = Rotation.from_euler("z", pan_step) * Rotation.from_euler("x", tilt_step) * turned
        expected.append(turned.as_euler("ZYX")[::-1])
    angle = paper_angles.euler_angles_rad(paper_angles.composed_attitude(pan, tilt))
    np.testing.assert_allclose(angle[1:], np.array(expected), atol=1e-12)


@pytest.mark.parametrize("path", list(paths()))
def test_mechanism_never_rolls(path: str) -> None:
    """R = Rz(pan) Rx(tilt) has ZYX angles (tilt, 0, pan): U has rank 2 at the most."""
    motion = along(paths()[path])
    pan, tilt = motion.pan_rad, motion.tilt_rad
    attitude = paper_angles.composed_attitude(pan, tilt, "mechanism")
    angle = paper_angles.euler_angles_rad(attitude)
    np.testing.assert_allclose(angle, paper_angles.mechanism_angles_rad(pan, tilt), atol=1e-12)
    assert np.linalg.matrix_rank(angle, tol=1e-9) <= 2


def test_plain_path_gives_two_columns_and_no_cholesky() -> None:
    result = _perfect("A pan")
    np.testing.assert_allclose(result.STM, np.diag([1.0, 0.0, 1.0]), atol=1e-4)
    assert result.rank == 2
    assert np.abs(result.unseen[:, 0]) == pytest.approx([0.0, 1.0, 0.0], abs=1e-6)
    assert result.S is result.T is result.M is None
    assert result.failures == ("u_rank_deficient", "cholesky_impossible")
    assert not result.complete


def test_default_is_as_printed() -> None:
    """u of eq. 6 is (z, x, y) by eq. 11: the roll column is the last, not the second."""
    motion = along(_corners("A pan"), static_s=SHORT_S)
    result = calibrate_as_printed(
        motion.time_s,
        motion.body_rate_rad_s(),
        motion.pan_rad,
        motion.tilt_rad,
        motion.static,
    )
    assert result.reading == PaperReading("printed", "printed", "quasi_static", "line", "by_shape")
    assert result.failures[0] == "eq6_order"
    assert "u_rank_by_rounding" in result.failures
    tabled = calibrated(motion, motion.body_rate_rad_s(), "quasi_static", READING_OF_TABLE_3)
    np.testing.assert_allclose(result.U_rad[[1, 2, 0]], tabled.U_rad)


def test_a_path_that_rolls_only_by_eq_12_is_said_to() -> None:
    """Perfect gyro on a rectangle: full rank, three matrices, none of them right."""
    result = _perfect("B rect")
    assert result.complete
    assert "reference_not_the_attitude" in result.failures
    assert "integral_not_the_attitude" in result.failures
    assert result.S is not None
    assert np.abs(np.diag(result.S) - 1.0).max() > 0.4


def _factors(reading: PaperReading) -> PaperResult:
    """A mounted board on a reference with roll: angles that a gimbal of three axes could make."""
    motion = along(_corners("G rect"), static_s=SHORT_S)
    gain = np.diag([0.95, 0.97, 0.9]) @ rotation_about_tilt_axis(np.radians(8.8))
    return calibrated(motion, motion.body_rate_rad_s() @ gain.T, "static", reading)


def test_lu_by_shape_breaks_the_product_and_the_rotation() -> None:
    result = _factors(replace(READING_OF_TABLE_3, factors="by_shape"))
    assert result.S is not None
    assert result.T is not None
    assert result.ST is not None
    np.testing.assert_allclose(result.T @ result.S, result.ST, atol=1e-12)
    assert {"lu_order", "m_not_rotation"} <= set(result.failures)


def test_lu_by_position_keeps_the_product_but_not_the_diagonal() -> None:
    result = _factors(replace(READING_OF_TABLE_3, factors="by_position"))
    assert result.M is not None
    assert paper_matrices.orthogonality_error(result.M) < 1e-12
    assert "s_not_diagonal" in result.failures
    assert not {"lu_order", "m_not_rotation"} & set(result.failures)


def test_product_split_is_the_lq_decomposition() -> None:
    """Against numpy's QR of the transpose: G = L Q."""
    gain = np.array([[0.95, 0.01, -0.05], [-0.01, 0.96, -0.15], [0.02, 0.1, 0.9]])
    lower = paper_matrices.lower_factor(gain)
    assert lower is not None
    S, T = paper_matrices.split_lower(lower, "product")
    M = paper_matrices.misalignment(S, T, gain)
    Q, R = np.linalg.qr(gain.T)
    sign = np.sign(np.diag(R))
    np.testing.assert_allclose(lower, R.T * sign, atol=1e-12)
    np.testing.assert_allclose(M, (Q * sign).T, atol=1e-12)
    np.testing.assert_allclose(S @ T @ M, gain, atol=1e-12)


def test_pinv_is_numpys_where_u_has_full_rank() -> None:
    rng = np.random.default_rng(2)
    U, Y = rng.normal(size=(2, 3, 50))
    fit = paper_matrices.gain_by_pseudoinverse(Y, U)
    np.testing.assert_allclose(fit.gain, Y @ np.linalg.pinv(U), atol=1e-12)
    assert fit.rank == 3
    assert fit.unseen_directions.shape == (3, 0)


@pytest.mark.parametrize("slope", ["line", "mean"])
def test_bias_of_a_turning_away_rest(slope: paper_angles.SlopeEstimate) -> None:
    """A constant rate is found by both slopes, in the static and the quasi-static test."""
    bias = np.radians([0.106, -0.004, -0.034])
    motion = along([(0.0, 0.0), (0.0, 0.0)], duration_s=10.0, static_s=SHORT_S)
    rate = np.tile(bias, (motion.time_s.size, 1))
    result = calibrated(motion, rate, "static", replace(READING_OF_TABLE_3, slope=slope))
    assert result.bias_static_rad_s == pytest.approx(bias)
    assert result.bias_quasi_static_rad_s == pytest.approx(bias)
    assert result.rank == 0


def test_longest_static_piece_counts_and_none_is_named() -> None:
    motion = along(_corners("A pan"), static_s=SHORT_S)
    rate = motion.body_rate_rad_s() + 0.01
    static = motion.static.copy()
    static[5] = False  # splits the rest; the quasi-static test now starts at that sample
    result = calibrate_as_printed(motion.time_s, rate, motion.pan_rad, motion.tilt_rad, static)
    assert result.bias_static_rad_s == pytest.approx(0.01)
    none = np.zeros_like(static)
    arrays = (motion.time_s, rate, motion.pan_rad, motion.tilt_rad, none)
    result = calibrate_as_printed(*arrays)
    assert "no_static_test" in result.failures
    with pytest.raises(ValueError, match="no static test"):
        calibrate_as_printed(*arrays, reading=PaperReading(bias="static"))


def _arrays(count: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, BoolArray]:
    time_s = np.arange(count, dtype=np.float64)
    zero = np.zeros(count)
    return time_s, np.zeros((count, 3)), zero, zero, np.zeros(count, dtype=np.bool_)


def test_arrays_that_do_not_belong_together_are_refused() -> None:
    time_s, rate, pan, tilt, static = _arrays(10)
    with pytest.raises(ValueError, match="same length"):
        calibrate_as_printed(time_s, rate, pan[:-1], tilt, static)
    with pytest.raises(ValueError, match="increase"):
        calibrate_as_printed(time_s[::-1], rate, pan, tilt, static)
    with pytest.raises(ValueError, match="quasi-static"):
        calibrate_as_printed(time_s, rate, pan, tilt, ~static)


def test_singular_and_wrapping_angles_are_named() -> None:
    """Tilt of 90 degrees at pan 90 puts eq. 12's roll at a quarter turn, where cos theta = 0."""
    motion = along([(0.0, 0.0), (90.0, 0.0), (90.0, 90.0)], static_s=SHORT_S)
    result = calibrated(motion, motion.body_rate_rad_s(), "static")
    assert "euler_singular" in result.failures
    motion = along([(0.0, 0.0), (200.0, 0.0)], static_s=SHORT_S)
    result = calibrated(motion, motion.body_rate_rad_s(), "static")
    assert "angles_wrap" in result.failures


def test_a_mirrored_axis_is_named() -> None:
    motion = along(_corners("G rect"), static_s=SHORT_S)
    mirrored = motion.body_rate_rad_s() * [1.0, -1.0, 1.0]
    assert "m_reflection" in calibrated(motion, mirrored, "static").failures


@pytest.mark.parametrize("path", ["A pan", "B rect", "B2", "C both", "D tilt", "H pan"])
@pytest.mark.parametrize("reading", [PaperReading(), READING_OF_TABLE_3])
def test_every_failure_has_words(path: str, reading: PaperReading) -> None:
    result = _perfect(path, reading)
    assert set(result.failures) <= FAILURES.keys()
    assert len(set(result.failures)) == len(result.failures)
