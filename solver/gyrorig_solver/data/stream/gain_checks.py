"""Check of a fitted gain for exchanged axes, wrong signs and a wrong full scale.

The base model absorbs these errors completely: they leave no residual, only a gain that no mount
and no data sheet allow. The check uses the nearest signed permutation P of the gain, and the ratio
of the scale to 1. If P is a rotation (determinant +1), the board can also be mounted rotated. A
recording cannot separate the two cases; the check reports this and names no cause.
"""

import itertools
import math

import numpy as np

from gyrorig_solver.data.arrays import FloatArray
from gyrorig_solver.data.link_remedies import WRONG_AXES, WRONG_FULL_SCALE, LinkRemedy
from gyrorig_solver.data.stream.count_stream import AXES, CheckResult, StreamFinding

AXES_CHECK_NAME, FULL_SCALE_CHECK_NAME = "axes and signs", "full scale"
MIRROR_CAUSES = ("axis_swap", "sign_flip")
MAX_MOUNT_DISTANCE = 0.5  # of the unscaled gain from P; above it the mount is oblique
MAX_POWER_OF_TWO_ERROR = 0.2  # of a scale from a power of two; data sheets allow 2 to 15 %
REVERSED_TEXT = LinkRemedy(
    rig="the unit's pan_sign and tilt_sign", file="the signs of the reference's angles"
)
TURNED_TEXT = (
    "the board is mounted in a rotated position: {how}. Exchanged axes would give the same data; "
    "check the mounting of the board"
)


def check_gain(
    gain: FloatArray, tolerance: float | None = None, link: str = "serial"
) -> tuple[CheckResult, CheckResult]:
    """Check the axes and the full scale of a fitted gain.

    Args:
        gain: G = S T M, shape (3, 3), nan if not known.
        tolerance: of the scale in the sensor's data sheet, None if not known.
        link: on which the samples arrived, for the remedies.
    """
    if not np.all(np.isfinite(gain)):
        summary = "not checked, because the gain is not fully known"
        return CheckResult(AXES_CHECK_NAME, summary), CheckResult(FULL_SCALE_CHECK_NAME, summary)
    row_norms = np.linalg.norm(gain, axis=1)  # without the sign of a mirrored sensor, unlike S
    return (
        _check_axes(gain / row_norms[:, None], link),
        _check_full_scale(row_norms, tolerance or 0.15, link),
    )


def nearest_signed_permutation(gain: FloatArray) -> FloatArray:
    """Return the signed permutation nearest to a gain, shape (3, 3)."""
    nearest_matrix, distance = np.eye(3), math.inf
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            candidate = np.eye(3)[list(order)] * np.array(signs)[:, None]
            candidate_distance = float(np.linalg.norm(gain - candidate))
            if candidate_distance < distance - 1e-12:
                nearest_matrix, distance = candidate, candidate_distance
    return nearest_matrix


def _check_axes(gain: FloatArray, link: str) -> CheckResult:
    permutation = nearest_signed_permutation(gain)
    if np.array_equal(permutation, np.eye(3)):
        return CheckResult(
            AXES_CHECK_NAME, "each axis has the right place and sign", (), MIRROR_CAUSES
        )
    mapping_text = _axis_mapping_text(permutation)
    oblique = float(np.linalg.norm(gain - permutation)) > MAX_MOUNT_DISTANCE
    if oblique and np.linalg.det(gain) > 0.0:
        return CheckResult(
            AXES_CHECK_NAME, f"the board is mounted obliquely, nearest to {mapping_text}"
        )
    if np.linalg.det(permutation) > 0.0:
        return CheckResult(AXES_CHECK_NAME, TURNED_TEXT.format(how=mapping_text))
    pairs = [
        (i, j)
        for i, j in ((0, 1), (1, 2), (0, 2))
        if abs(permutation[i, j]) == abs(permutation[j, i]) == 1
    ]
    negative = [i for i in range(3) if permutation[i].sum() < 0.0]
    reversed_axes = tuple(AXES[i] for i in negative)
    if pairs and not negative:
        (first, second) = pairs[0]
        exchanged = (AXES[first], AXES[second])
        summary = (
            f"axes {AXES[first]} and {AXES[second]} are exchanged: the gain is mirrored, and no "
            "mount can mirror a board"
        )
        return _mirror_result(
            summary, (_axis_finding("axis_swap", "exchanged", exchanged, summary, link),)
        )
    if not pairs and np.array_equal(np.abs(permutation), np.eye(3)):
        axis_names = " and ".join(reversed_axes)
        summary = (
            f"axis {axis_names} has the wrong sign: the gain is mirrored, and no mount can mirror "
            "a board"
        )
        if len(negative) == 3:
            summary += f"; {REVERSED_TEXT.for_link(link)} can be wrong instead"
        return _mirror_result(
            summary, (_axis_finding("sign_flip", "flipped", reversed_axes, summary, link),)
        )
    summary = (
        f"the axes are mirrored: {mapping_text}. Either one sign is wrong or two axes are "
        "exchanged. In both cases the board is also mounted in a rotated position"
    )
    return _mirror_result(
        summary, (_axis_finding("sign_flip", "flipped", reversed_axes, summary, link),)
    )


def _mirror_result(summary: str, findings: tuple[StreamFinding, ...]) -> CheckResult:
    return CheckResult(AXES_CHECK_NAME, summary, findings, MIRROR_CAUSES)


def _axis_finding(
    cause: str, quantity: str, where: tuple[str, ...], description: str, link: str
) -> StreamFinding:
    return StreamFinding(
        cause, "link", where, 1, 1, 0.0, quantity, 1.0, "1", description, WRONG_AXES.for_link(link)
    )


def _axis_mapping_text(permutation: FloatArray) -> str:
    """Return the stage axis of each sensor axis, as text."""
    words = []
    for axis in range(3):
        stage_axis = int(np.flatnonzero(permutation[axis])[0])
        sign = "-" if permutation[axis, stage_axis] < 0.0 else "+"
        words.append(f"{AXES[axis]} follows {sign}{AXES[stage_axis]}")
    return ", ".join(words)


def _check_full_scale(scale: FloatArray, tolerance: float, link: str) -> CheckResult:
    mean_scale = float(np.exp(np.mean(np.log(scale))))
    doublings = round(math.log2(mean_scale))
    summary = (
        f"the scale is {mean_scale:.3f} times the nominal one; data sheets allow ±{tolerance:.2g}"
    )
    if not doublings or abs(mean_scale / 2.0**doublings - 1.0) > max(
        tolerance, MAX_POWER_OF_TWO_ERROR
    ):
        return CheckResult(FULL_SCALE_CHECK_NAME, summary, (), ("wrong_full_scale",))
    full_scale_ratio = 2.0**-doublings
    description = (
        f"the counts are {mean_scale:.3g} times those of the configured range; the true full scale "
        f"of the sensor is about {full_scale_ratio:g} times the configured one"
    )
    finding = StreamFinding(
        "wrong_full_scale", "link", (), 1, 1, 0.0, "doublings", float(doublings), "1",
        description, WRONG_FULL_SCALE.for_link(link),
    )  # fmt: skip
    return CheckResult(FULL_SCALE_CHECK_NAME, description, (finding,))
