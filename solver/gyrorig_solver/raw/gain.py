"""Axes that have changed places, count the other way round, or are read by a wrong range.

The base model takes these whole: they leave no residual, only a gain far from what a mount and
a data sheet allow. Told by the nearest signed permutation P of the gain, and by the scale's
distance from 1. Where P is a turn (determinant +1) the board may as well sit turned on the
stage, and nothing in a recording tells: that is said, and no cause is named.
"""

import itertools
import math

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.raw.result import AXES, Look, RawFinding

AXES_CHECK, RANGE_CHECK = "axes and signs", "full scale"
MIRRORS = ("axis_swap", "sign_flip")
FARTHEST = 0.5  # of the gain, scales taken out, from P: beyond it the mount is oblique
NEAR_POWER = 0.2  # of a scale from a power of two; data sheets promise 2 to 15 % of one
AXES_REMEDY = "mend the order and the signs of the words in the driver or in the board's columns"
RANGE_REMEDY = (
    "read the range register back, and set the board's full scale to what it is: "
    "all rates are off by that factor until then"
)
TURNED = (
    "the axes come as if the board were turned on the stage: {how}. A turned mount and "
    "exchanged axes look the same; look at the board"
)


def look_at_gain(gain: FloatArray, tolerance: float | None = None) -> tuple[Look, Look]:
    """Judge a fitted gain against mounts and data sheets.

    Args:
        gain: G = S T M, shape (3, 3), nan where it is not known.
        tolerance: of the scale by the sensor's data sheet, None where there is none.
    """
    if not np.all(np.isfinite(gain)):
        said = "not looked for: the motion does not show the whole gain"
        return Look(AXES_CHECK, said), Look(RANGE_CHECK, said)
    rows = np.linalg.norm(gain, axis=1)  # not the factor S, which takes a mirror's sign
    return _axes(gain / rows[:, None]), _range(rows, tolerance or 0.15)


def nearest(gain: FloatArray) -> FloatArray:
    """Return the signed permutation that a gain is nearest to, shape (3, 3)."""
    best, distance = np.eye(3), math.inf
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            tried = np.eye(3)[list(order)] * np.array(signs)[:, None]
            off = float(np.linalg.norm(gain - tried))
            if off < distance - 1e-12:
                best, distance = tried, off
    return best


def _axes(gain: FloatArray) -> Look:
    found = nearest(gain)
    if np.array_equal(found, np.eye(3)):
        return Look(AXES_CHECK, "each axis turns about its own and to its own side", (), MIRRORS)
    how = _how(found)
    oblique = float(np.linalg.norm(gain - found)) > FARTHEST
    if oblique and np.linalg.det(gain) > 0.0:
        return Look(AXES_CHECK, f"the board sits obliquely on the stage, nearest to {how}")
    if np.linalg.det(found) > 0.0:
        return Look(AXES_CHECK, TURNED.format(how=how))
    pairs = [
        (i, j) for i, j in ((0, 1), (1, 2), (0, 2)) if abs(found[i, j]) == abs(found[j, i]) == 1
    ]
    negative = [i for i in range(3) if found[i].sum() < 0.0]
    turned = tuple(AXES[i] for i in negative)
    if pairs and not negative:
        (one, other) = pairs[0]
        both = (AXES[one], AXES[other])
        said = f"axes {AXES[one]} and {AXES[other]} have changed places: no mount mirrors a board"
        return _mirrored(said, (_swapped("axis_swap", "exchanged", both, said),))
    if not pairs and np.array_equal(np.abs(found), np.eye(3)):
        said = f"axis {' and '.join(turned)} counts the other way round: no mount mirrors a board"
        if len(negative) == 3:
            said += "; the unit's pan_sign and tilt_sign may be wrong instead"
        return _mirrored(said, (_swapped("sign_flip", "flipped", turned, said),))
    said = (
        f"the axes come mirrored: {how}. One sign is wrong, or two axes have changed places, "
        "and the board sits turned beside"
    )
    return _mirrored(said, (_swapped("sign_flip", "flipped", turned, said),))


def _mirrored(said: str, findings: tuple[RawFinding, ...]) -> Look:
    return Look(AXES_CHECK, said, findings, MIRRORS)


def _swapped(cause: str, name: str, where: tuple[str, ...], said: str) -> RawFinding:
    return RawFinding(cause, "link", where, 1, 1, 0.0, name, 1.0, "1", said, AXES_REMEDY)


def _how(found: FloatArray) -> str:
    """Return which stage axis each sensor axis follows, in words."""
    words = []
    for axis in range(3):
        at = int(np.flatnonzero(found[axis])[0])
        words.append(f"{AXES[axis]} follows {'-' if found[axis, at] < 0.0 else '+'}{AXES[at]}")
    return ", ".join(words)


def _range(scale: FloatArray, tolerance: float) -> Look:
    middle = float(np.exp(np.mean(np.log(scale))))
    doublings = round(math.log2(middle))
    usual = f"scale {middle:.3f} of the nominal one; data sheets allow ±{tolerance:.2g}"
    if not doublings or abs(middle / 2.0**doublings - 1.0) > max(tolerance, NEAR_POWER):
        return Look(RANGE_CHECK, usual, (), ("wrong_full_scale",))
    told = 2.0**-doublings
    said = (
        f"the counts are {middle:.3g} times what the configured range says: the sensor's true "
        f"full scale is about {told:g} times the configured one"
    )
    finding = RawFinding(
        "wrong_full_scale", "link", (), 1, 1, 0.0, "doublings", float(doublings), "1",
        said, RANGE_REMEDY,
    )  # fmt: skip
    return Look(RANGE_CHECK, said, (finding,))
