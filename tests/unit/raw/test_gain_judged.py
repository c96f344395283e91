"""A gain that no mount and no data sheet allows is told; one that they allow is not."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.raw.gain import look_at_gain, nearest

SCALE = np.diag([0.97, 1.04, 1.01])
RNG = np.random.default_rng(4)


def mounted(deg: float = 4.0) -> FloatArray:
    direction = RNG.normal(size=3)
    turn = Rotation.from_rotvec(np.radians(deg) * direction / np.linalg.norm(direction))
    return SCALE @ turn.as_matrix()


def causes(gain: FloatArray) -> list[tuple[str, tuple[str, ...]]]:
    return [(f.cause, f.where) for look in look_at_gain(gain) for f in look.findings]


@pytest.mark.parametrize("deg", [0.0, 3.0, 15.0])
def test_a_board_as_it_should_be_is_not_named(deg: float) -> None:
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


def test_a_turned_mount_is_said_and_no_cause_named() -> None:
    """A quarter turn is a mount too: nothing in a recording tells it from exchanged axes."""
    gain = mounted() @ Rotation.from_euler("z", 90, degrees=True).as_matrix()
    assert causes(gain) == []
    assert "turned on the stage" in look_at_gain(gain)[0].said


def test_a_mirror_beside_a_turn_is_told_as_one() -> None:
    gain = mounted() @ Rotation.from_euler("z", 90, degrees=True).as_matrix()
    gain[2] *= -1.0
    assert [cause for cause, _ in causes(gain)] == ["sign_flip"]


@pytest.mark.parametrize(("factor", "doublings"), [(0.5, -1.0), (2.0, 1.0), (0.125, -3.0)])
def test_another_range_is_named(factor: float, doublings: float) -> None:
    (look,) = [x for x in look_at_gain(factor * mounted()) if x.findings]
    assert look.findings[0].cause == "wrong_full_scale"
    assert look.findings[0].size == doublings


def test_an_odd_scale_is_no_other_range() -> None:
    assert causes(0.76 * mounted()) == []  # an uncalibrated MTi's counts, measured


def test_what_is_not_known_is_not_judged() -> None:
    gain = mounted()
    gain[:, 0] = np.nan
    assert causes(gain) == []
    assert all("not looked for" in look.said for look in look_at_gain(gain))


def test_the_nearest_is_that_of_the_best_assignment() -> None:
    """Each row's largest entry, where those are all apart: the plain way to the same."""
    for _ in range(50):
        turn = Rotation.random(random_state=RNG.integers(1 << 30)).as_matrix()
        at = np.argmax(np.abs(turn), axis=1)
        if len(set(at)) < 3 or np.min(np.max(np.abs(turn), axis=1)) < 0.8:
            continue
        plain = np.zeros((3, 3))
        plain[range(3), at] = np.sign(turn[range(3), at])
        assert np.array_equal(nearest(turn), plain)
