"""Removal of wrong attitudes: single outliers, jumps, and swapped markers.

The turn of the gyro between two attitudes shows which attitudes are wrong. Two large residuals that
cancel come from one wrong attitude; it is left out. A residual without such a counterpart is a
jump: the segment ends there. If the world frame jumped, the rates of the body after it are right.
If the frame of the body jumped, as after a swap of two markers, the rates after it belong to
another body frame; that part is left out.

What to use when: `remove_outliers` after a first fit, `remove_swapped` after a fit without
outliers.
"""

from dataclasses import replace

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.estimate.attitude.attitude_solver import AttitudeSolver
from gyrorig_solver.reference import AttitudeReference

# Residual turns in robust standard deviations and in rad; smaller ones are noise of the reference.
OUTLIER_SIGMA = 12.0
MIN_OUTLIER_RAD = 0.02
# Body frames that differ by less are one frame; a fit of a few seconds is not more accurate.
MIN_SWAP_RAD = np.radians(3.0)
MIN_FRAME_S = 2.0  # a shorter segment does not show its body frame


def remove_outliers(
    solver: AttitudeSolver, reference: AttitudeReference
) -> tuple[AttitudeReference, int, int]:
    """Return the reference without outliers and cut at jumps, and the numbers of both.

    Args:
        solver: a fit of this reference alone.
        reference: on the times of the fit.
    """
    orientation = reference.orientation_xyzw.copy()
    is_cut = np.zeros(reference.time_s.size, dtype=np.bool_)
    if reference.is_cut is not None:
        is_cut |= reference.is_cut
    outliers = jumps = 0
    for segment in solver.segments:
        track = segment.track
        rows = np.concatenate([[True], np.diff(track.begin_s) > 0.0])  # one per step
        bias = segment.bias_share[:, None] * solver.biases[0]
        measured = segment.mean_rate(solver.lag_s_of(0))[0] - bias
        turn = (measured @ np.linalg.inv(solver.gain).T - track.rate_rad_s) * track.duration_s[
            :, None
        ]
        turn, begin_s, end_s = turn[rows], track.begin_s[rows], track.end_s[rows]
        speed = np.linalg.norm(track.rate_rad_s[rows], axis=1)
        fast = np.abs(turn[speed >= np.median(speed)])
        limit = np.maximum(OUTLIER_SIGMA * 1.4826 * np.median(fast, axis=0), MIN_OUTLIER_RAD)
        for first, last in _groups(np.any(np.abs(turn) > limit, axis=1)):
            inside = (reference.time_s > begin_s[first]) & (reference.time_s < end_s[last])
            outliers += int(np.sum(inside & np.all(np.isfinite(orientation), axis=1)))
            orientation[inside] = np.nan
            if np.any(np.abs(turn[first : last + 1].sum(axis=0)) > limit):
                jumps += 1
                is_cut[np.searchsorted(reference.time_s, begin_s[first])] = True
    if not outliers and not jumps:
        return reference, 0, 0
    return replace(reference, orientation_xyzw=orientation, is_cut=is_cut), outliers, jumps


def _groups(is_large: BoolArray) -> list[tuple[int, int]]:
    """Return the first and last step of each group of neighbouring large residuals."""
    edges = np.diff(np.concatenate([[False], is_large, [False]]).astype(np.int8))
    first, end = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    return [(int(a), int(b) - 1) for a, b in zip(first, end, strict=True)]


def remove_swapped(
    solver: AttitudeSolver, reference: AttitudeReference
) -> tuple[AttitudeReference, str]:
    """Return the reference without the segments of another body frame, and a text about these.

    Args:
        solver: a fit of this reference alone, cut at its jumps.
        reference: on the times of the fit.
    """
    gains: list[FloatArray | None] = []
    lengths: list[float] = []
    for k, segment in enumerate(solver.segments):
        length_s = float(segment.track.edge_s[-1] - segment.track.edge_s[0])
        measured = solver.band_limit(k, segment.mean_rate(solver.lag_s_of(0))[0])
        rate = solver.band_limit(k, segment.track.rate_rad_s)
        design = np.column_stack([rate, np.ones(rate.shape[0])])
        moves = np.linalg.svd(rate, compute_uv=False)[-1] > 1e-3 * np.sqrt(rate.shape[0])
        if length_s < MIN_FRAME_S or not moves:
            gains.append(None)
        else:
            fitted = np.linalg.lstsq(design, measured, rcond=None)[0]
            gains.append(np.asarray(fitted[:3].T, dtype=np.float64))
        lengths.append(length_s)
    seeds = [k for k, gain in enumerate(gains) if gain is not None]
    if len(seeds) < 2:
        return reference, ""
    angles = {seed: {k: _angle_between(gains[k], gains[seed]) for k in seeds} for seed in seeds}
    total_s = {
        seed: sum(lengths[k] for k in seeds if angles[seed][k] < MIN_SWAP_RAD) for seed in seeds
    }
    main = max(seeds, key=lambda seed: total_s[seed])
    swapped = [k for k in seeds if angles[main][k] >= MIN_SWAP_RAD]
    if not swapped:
        return reference, ""
    orientation, texts = reference.orientation_xyzw.copy(), []
    for k, segment in enumerate(solver.segments):
        begin_s, end_s = float(segment.track.begin_s[0]), float(segment.track.end_s[-1])
        if k in swapped:
            texts.append(
                f"from {begin_s:.1f} s to {end_s:.1f} s (turned by "
                f"{np.degrees(angles[main][k]):.0f} deg)"
            )
        if k in swapped or gains[k] is None:
            inside = (reference.time_s >= begin_s) & (reference.time_s <= end_s)
            orientation[inside] = np.nan
    text = (
        "the attitudes jump to another frame of the body, as after a swap of two markers: "
        f"{', '.join(texts)}; the solver left these attitudes out"
    )
    return replace(reference, orientation_xyzw=orientation), text


def _angle_between(gain: FloatArray | None, other: FloatArray | None) -> float:
    """Return the rotation between two gains, rad."""
    if gain is None or other is None or abs(np.linalg.det(other)) < 1e-6:
        return 0.0
    left, _, right = np.linalg.svd(np.linalg.inv(other) @ gain)
    cosine = (np.trace(left @ right) - 1.0) / 2.0
    return float(np.arccos(np.clip(cosine, -1.0, 1.0)))
