"""Figures of an earlier, independent audit of the paper, made with other code.

Recipe of the reference values: Table 3 multiplied out and run through eq. 8 to 10 with numpy's
`cholesky`; pan-tilt paths of 75 s in four periods, pan 60 and tilt 30 degrees, with a perfect
gyro, integrated and fitted. They were taken down as rounded below before this code existed; a
tolerance is half a unit of the last digit where the recipe is exact, more where the audit's
law of motion along a leg is not known.
"""

import numpy as np
import pytest
from docs.paper import check_estimators, check_paths, check_tables
from docs.paper.motion import along, calibrated, paths, rotation_about_tilt_axis
from docs.paper.printed import GY80, MPU

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate.paper import paper_angles, paper_matrices
from gyrorig_solver.estimate.paper.paper_method import PaperResult

HALF = 5.001e-5  # of the fourth digit


def _named(start: str) -> list[tuple[float, float]]:
    return next(corners for name, corners in paths().items() if name.startswith(start))


def _perfect(start: str) -> PaperResult:
    motion = along(_named(start))
    return calibrated(motion, motion.body_rate_rad_s(), "static")


def test_products_of_table_3() -> None:
    gy80 = [[0.9471, -0.0074, -0.0456], [-0.0147, 0.9621, -0.1476], [0.0155, 0.0034, 0.8956]]
    mpu = [[0.9854, 0.0346, 0.0309], [0.0261, 1.0246, 0.0332], [0.0167, 0.0014, 0.9531]]
    np.testing.assert_allclose(GY80.STM, gy80, atol=HALF)
    np.testing.assert_allclose(MPU.STM, mpu, atol=HALF)


def test_gy80_rotation_vector_and_mpu_misprint() -> None:
    assert paper_matrices.orthogonality_error(GY80.M) < 2e-4
    M = GY80.M
    twist = np.array([M[2, 1] - M[1, 2], M[0, 2] - M[2, 0], M[1, 0] - M[0, 1]])
    angle = np.arccos((np.trace(M) - 1.0) / 2.0)
    vector = np.degrees(twist / (2.0 * np.sin(angle)) * angle)
    assert vector == pytest.approx([8.76, -2.79, 0.24], abs=0.02)
    assert np.linalg.norm(MPU.M[1]) == pytest.approx(0.989, abs=5e-4)
    assert MPU.M[0] @ MPU.M[1] == pytest.approx(0.025, abs=5e-4)
    assert np.linalg.det(MPU.M) == pytest.approx(0.9887, abs=HALF)
    assert check_tables.corrected_row(MPU) == pytest.approx([-0.0361, 0.9989, 0.0309], abs=HALF)
    corrected = MPU.S @ MPU.T @ check_tables.corrected(MPU)
    assert corrected[1, 0] == pytest.approx(-0.0002, abs=HALF)


def test_sensing_axes() -> None:
    assert check_tables.axis_angles_deg(GY80.STM)[2] == pytest.approx(98.5, abs=0.05)
    assert check_tables.axis_angles_deg(MPU.STM) == pytest.approx([86.5, 87.2, 88.0], abs=0.05)
    corrected = check_tables.axis_angles_deg(MPU.S @ MPU.T @ check_tables.corrected(MPU))
    assert np.abs(corrected - 90.0).max() == pytest.approx(2.8, abs=0.05)


def test_lu_of_the_printed_product() -> None:
    lower = paper_matrices.lower_factor(GY80.STM)
    assert lower is not None
    S, T = paper_matrices.split_lower(lower, "by_shape")
    assert T[2, 1] == pytest.approx(-0.1368, abs=HALF)
    M = paper_matrices.misalignment(S, T, GY80.STM)
    assert abs((M @ M.T)[1, 2]) == pytest.approx(0.0136, abs=HALF)
    _, T = paper_matrices.split_lower(lower, "product")
    assert T[2, 1] == pytest.approx(-0.1504, abs=HALF)


def _one_angle(scale: list[float], mount_deg: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    gain = np.diag(scale) @ rotation_about_tilt_axis(np.radians(mount_deg))
    gain[2, 1] = 0.0
    lower = paper_matrices.lower_factor(gain)
    assert lower is not None
    S, T = paper_matrices.split_lower(lower, "product")
    return S, T, paper_matrices.misalignment(S, T, gain)


def test_one_mount_angle_explains_the_gy80() -> None:
    S, T, M = _one_angle([0.948, 0.973, 0.906], 8.8)
    predicted = (S[1, 1], S[2, 2], T[2, 1], M[1, 2], M[2, 1])
    assert predicted == pytest.approx((0.973, 0.8848, -0.1548, -0.1530, 0.1530), abs=1.5e-4)
    printed = (0.9734, 0.8854, -0.1504, -0.1524, 0.1522)
    assert predicted == pytest.approx(printed, abs=0.005)


def test_one_mount_angle_explains_the_mpu() -> None:
    _, T, M = _one_angle([1.0, 1.0, 1.0], -2.0)
    assert (T[2, 1], M[1, 2], M[2, 1]) == pytest.approx((0.0349, 0.0349, -0.0349), abs=HALF)


def test_t_zy_rests_on_one_entry() -> None:
    gain = GY80.STM.copy()
    gain[2, 1] = 0.15
    lower = paper_matrices.lower_factor(gain)
    assert lower is not None
    S, T = paper_matrices.split_lower(lower, "product")
    assert T[2, 1] == pytest.approx(0.013, abs=5e-4)
    assert S[2, 2] == pytest.approx(0.908, abs=5e-4)


def test_tilt_at_pan_sixty() -> None:
    pan, tilt = np.radians([[0.0, 60.0, 60.0], [0.0, 0.0, 30.0]])
    angle = paper_angles.euler_angles_rad(paper_angles.composed_attitude(pan, tilt))[-1]
    assert np.degrees(angle) == pytest.approx([16.1, -25.7, 56.3], abs=0.05)


@pytest.mark.parametrize(
    ("path", "end_deg", "largest_deg"),
    [
        ("A pan", (0.0, 0.0), 0.0),
        ("B rect", (-120.0, 32.2), 120.0),
        ("B2", (-480.0, 0.0), 480.0),
        ("D tilt", (0.0, 0.0), 0.0),
        ("E pan", (0.0, 0.0), 30.0),
        ("G rect", (0.0, 0.0), 60.0),
    ],
)
def test_geometric_phase(path: str, end_deg: tuple[float, float], largest_deg: float) -> None:
    """-P sin T a rectangle, whatever the law along a leg."""
    end, largest = check_paths.offsets_deg(along(_named(path)))
    assert end[1:] == pytest.approx(end_deg, abs=0.05)
    assert largest.max() == pytest.approx(largest_deg, abs=0.05)


def test_false_bias() -> None:
    rectangle = check_paths.false_bias_dps(along(_named("B rect")))
    assert rectangle[1:] == pytest.approx([-1.64, 0.29], abs=0.005)
    plain = check_paths.false_bias_dps(along(_named("A pan")))
    assert plain == pytest.approx([0.075, 0.0, -0.150], abs=5e-4)


@pytest.mark.parametrize("path", ["A pan", "D tilt", "E pan"])
def test_cholesky_fails_where_roll_was_not_seen(path: str) -> None:
    result = _perfect(path)
    assert "cholesky_impossible" in result.failures
    assert np.linalg.matrix_rank(result.STM, tol=1e-6) == 2


def test_columns_of_the_nested_paths() -> None:
    assert _perfect("E pan").STM[1:, 2] == pytest.approx([0.50, 0.866], abs=0.005)
    assert _perfect("D tilt").STM[0, 0] == pytest.approx(0.29, abs=0.005)


def test_factors_of_rectangles_for_a_perfect_gyro() -> None:
    """The law along a leg is not the audit's: agreement to a few hundredths is what counts."""
    rectangle, alternating = _perfect("B rect"), _perfect("G rect")
    assert rectangle.S is not None
    assert rectangle.T is not None
    assert np.diag(rectangle.S) == pytest.approx([0.53, 0.90, 0.79], abs=0.02)
    assert rectangle.T[2, 1] == pytest.approx(0.89, abs=0.02)
    assert alternating.S is not None
    assert alternating.T is not None
    assert np.diag(alternating.S) == pytest.approx([0.90, 1.18, 0.96], abs=0.03)
    assert alternating.T[2, :2] == pytest.approx([0.56, -0.07], abs=0.02)


def test_plain_path_shows_nine_of_twelve_in_the_rate_domain_too() -> None:
    plain = check_estimators.rate_design(along(_named("A pan")))
    both_tilts = check_estimators.rate_design(along(_named("H pan")))
    assert 3 * check_estimators.rate_rank(plain) == 9
    assert 3 * check_estimators.rate_rank(both_tilts) == 12


def test_rate_domain_beats_the_paper_on_the_same_samples() -> None:
    """The audit: 0.86 and 0.49 for the paper on path G, 0.0005 by rates; noise is another."""
    motion = along(_named("G rect"))
    rate = check_estimators.samples_rad_s(motion)
    truth = check_estimators.true_gain()
    line = np.abs(calibrated(motion, rate, "quasi_static").STM - truth).max()
    static = np.abs(calibrated(motion, rate, "static").STM - truth).max()
    rates = np.abs(check_estimators.rate_gain(motion, rate) - truth).max()
    assert line == pytest.approx(0.86, abs=0.05)
    assert static == pytest.approx(0.49, abs=0.02)
    assert rates < 0.003


def test_percentages_of_section_five() -> None:
    for board, mean, geometric in ((GY80, 6.43, 6.51), (MPU, 0.89, 0.95)):
        scale = np.diag(board.S)
        assert 100.0 * (1.0 - scale.mean()) == pytest.approx(mean, abs=0.006)
        assert 100.0 * (1.0 - np.prod(scale) ** (1.0 / 3.0)) == pytest.approx(geometric, abs=0.006)
