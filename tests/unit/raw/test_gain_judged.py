"""A gain that no mount and no data sheet allows is told; one that they allow is not."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.stream.gain_checks import check_gain, nearest_signed_permutation

SCALE = np.diag([0.97, 1.04, 1.01])
RNG = np.random.default_rng(4)


def mounted(deg: float = 4.0) -> FloatArray:
    direction = RNG.normal(size=3)
    turn = Rotation.from_rotvec(np.radians(deg) * direction / np.linalg.norm(direction))
    return SCALE @ turn.as_matrix()


def causes(gain: FloatArray) -> list[tuple[str, tuple[str, ...]]]:
    return [(f.cause, f.where) for look in check_gain(gain) for f in look.findings]


@pytest.mark.parametrize("deg", [0.0, 3.0, 15.0])
def test_a_correct_board_gives_no_finding(deg: float) -> None:
    assert causes(mounted(deg)) == []


@pytest.mark.parametrize(
    ("order", "where"), [((1, 0, 2), ("x", "y")), ((0, 2, 1), ("y", "z")), ((2, 1, 0), ("x", "z"))]
)
def test_exchanged_axes_are_named(order: tuple[int, ...], where: tuple[str, ...]) -> None:
    assert causes(mounted()[list(order)]) == [("axis_swap", where)]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_turned_sign_is_named(axis: int) -> None:
    gain = mounted()
    gain[axis] *= -1.0
    assert causes(gain) == [("sign_flip", ("xyz"[axis],))]


def test_a_rotated_mount_is_reported_without_a_cause() -> None:
    """A quarter turn is a mount too: nothing in a recording tells it from exchanged axes."""
    gain = mounted() @ Rotation.from_euler("z", 90, degrees=True).as_matrix()
    assert causes(gain) == []
    assert "mounted in a rotated position" in check_gain(gain)[0].summary


def test_a_mirrored_and_rotated_mount_is_one_finding() -> None:
    gain = mounted() @ Rotation.from_euler("z", 90, degrees=True).as_matrix()
    gain[2] *= -1.0
    assert [cause for cause, _ in causes(gain)] == ["sign_flip"]


@pytest.mark.parametrize(("factor", "doublings"), [(0.5, -1.0), (2.0, 1.0), (0.125, -3.0)])
def test_a_wrong_full_scale_is_named(factor: float, doublings: float) -> None:
    (look,) = [x for x in check_gain(factor * mounted()) if x.findings]
    assert look.findings[0].cause == "wrong_full_scale"
    assert look.findings[0].size == doublings


def test_an_unusual_scale_is_not_a_wrong_full_scale() -> None:
    assert causes(0.76 * mounted()) == []  # an uncalibrated MTi's counts, measured


def test_an_unknown_gain_is_not_checked() -> None:
    gain = mounted()
    gain[:, 0] = np.nan
    assert causes(gain) == []
    assert all("not checked" in look.summary for look in check_gain(gain))


def test_the_nearest_is_that_of_the_best_assignment() -> None:
    """Each row's largest entry, where those are all apart: the plain way to the same."""
    for _ in range(50):
        turn = Rotation.random(random_state=RNG.integers(1 << 30)).as_matrix()
        at = np.argmax(np.abs(turn), axis=1)
        if len(set(at)) < 3 or np.min(np.max(np.abs(turn), axis=1)) < 0.8:
            continue
        plain = np.zeros((3, 3))
        plain[range(3), at] = np.sign(turn[range(3), at])
        assert np.array_equal(nearest_signed_permutation(turn), plain)
