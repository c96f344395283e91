"""Nameless tests of what a fit against reference attitudes leaves: on what does it depend?

Smooth functions of each covariate, projected off all that the fit can follow, like a cause;
and what is no function of a rate at an instant: how quickly the rates change (a low-pass, on
either side, or the reference's own smoothing) and how the axis turns between two attitudes.

What to use when: `groups_of` for the tests of some scenes; `attitude_signatures` to make them.

Source of the turning axis: the mean rate that a rotation vector gives over a step lacks
w x dw/dt dt^2/12 of the mean of the rate (Bortz 1971, "A new mathematical formulation for
strapdown inertial navigation", IEEE Trans. AES-7, eq. 38 to second order).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.chance import chi2_tail
from gyrorig_solver.discover.attitude_terms import MovingBias
from gyrorig_solver.discover.result import Signature
from gyrorig_solver.discover.scores import Seen
from gyrorig_solver.estimate.attitude_space import AttitudeSpace
from gyrorig_solver.model.terms.bases import LinearTerm, start_values
from gyrorig_solver.model.terms.scene import Scene, by_axis

KNOTS, FEW_KNOTS = 7, 6


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """One nameless test."""

    covariate: str
    words: str
    signal: Callable[[Scene], FloatArray]  # to (k, blocks, 3)


def groups_of(scenes: Sequence[Scene]) -> list[Group]:
    """Return the tests that some scenes allow."""
    largest = np.max([np.abs(s.sensor_rate_rad_s).max(axis=0) for s in scenes], axis=0)
    begin = min(float(s.edges_s[0]) for s in scenes)
    end = max(float(s.edges_s[-1]) for s in scenes)
    fastest = max(float(_speed(s).max()) for s in scenes)
    speeds, times = np.linspace(0.0, fastest, KNOTS), np.linspace(begin, end, KNOTS)
    few = np.linspace(begin, end, FEW_KNOTS)
    moving = partial(_effect, MovingBias())
    return [
        Group("own_rate", "on each axis' own rate", partial(_own, largest)),
        Group("speed", "on the speed, as a gain", partial(_gain, _speed, speeds)),
        Group("time", "on the time, as a gain", partial(_gain, _time, times)),
        Group("bias_time", "on the time, as a bias", partial(_bias, _time, few)),
        Group("moving_bias", "on whether the board moves, as a bias", moving),
        Group("frequency", "on how quickly the rates change, as a filter", _filtered),
        Group("turning_axis", "on how the axis turns between attitudes", _turning_axis),
    ]


def attitude_signatures(space: AttitudeSpace) -> list[Signature]:
    """Return all nameless tests of a space's residual, the least likely by chance first."""
    groups = groups_of(space.scenes)
    found = []
    for group in groups:
        looked = space.look(space.signals(group.signal))
        seen = Seen.of(looked)
        if not seen.degrees_of_freedom:
            continue
        p_value = chi2_tail(seen.statistic, seen.degrees_of_freedom)
        found.append(
            Signature(
                group.covariate,
                group.words,
                seen.statistic,
                seen.degrees_of_freedom,
                min(1.0, p_value * len(groups)),
            )
        )
    return sorted(found, key=lambda one: (one.p_value, -one.statistic))


def _time(scene: Scene) -> FloatArray:
    return scene.time_s


def _speed(scene: Scene) -> FloatArray:
    return np.asarray(np.linalg.norm(scene.rate_rad_s, axis=1), dtype=np.float64)


def _hats(x: FloatArray, knots: FloatArray) -> FloatArray:
    """Return hats, 1 at their own knot and 0 at the others, (k, n)."""
    width = max(float(knots[1] - knots[0]), 1e-12)
    return np.asarray(np.clip(1.0 - np.abs(x - knots[:, None]) / width, 0.0, None), np.float64)


def _gain(of: Callable[[Scene], FloatArray], knots: FloatArray, scene: Scene) -> FloatArray:
    return scene.read(_hats(of(scene), knots)[:, :, None] * scene.sensor_rate_rad_s)


def _bias(of: Callable[[Scene], FloatArray], knots: FloatArray, scene: Scene) -> FloatArray:
    seen = scene.read(np.repeat(_hats(of(scene), knots)[:, :, None], 3, axis=2))
    return np.concatenate([by_axis(one) for one in seen])


def _own(largest: FloatArray, scene: Scene) -> FloatArray:
    rate, found = scene.sensor_rate_rad_s, []
    for axis in range(3):
        shown = np.zeros((KNOTS, scene.n, 3))
        knots = np.linspace(-largest[axis], largest[axis], KNOTS)
        shown[:, :, axis] = _hats(rate[:, axis], knots)
        found.append(scene.read(shown))
    return np.concatenate(found)


def _effect(term: LinearTerm, scene: Scene) -> FloatArray:
    return term.basis(scene, start_values(term))


def _filtered(scene: Scene) -> FloatArray:
    """Return each axis' second and third derivative: gain and delay by the frequency squared.

    Of block means, whose differences hold less of what is faster than the band.
    """
    step_s = scene.step_s * scene.block
    second = np.gradient(np.gradient(scene.read(scene.sensor_rate_rad_s), axis=0), axis=0)
    third = np.gradient(second, axis=0)
    return np.concatenate([by_axis(second / step_s**2), by_axis(third / step_s**3)])


def _turning_axis(scene: Scene) -> FloatArray:
    rate = scene.rate_rad_s
    across = np.cross(rate, np.gradient(rate, scene.step_s, axis=0))
    return by_axis(scene.read(np.asarray(across @ scene.gain.T, dtype=np.float64)))
