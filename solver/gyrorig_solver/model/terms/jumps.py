"""Jumps of an axis' speed, and the double pulses that they make behind the low-pass.

A stepper starts and stops at its base speed at once. What goes with its acceleration then
makes a pulse up and one down within no time, and a sample taken while the filter begins to
answer sees which of the two came: no grid of milliseconds holds that. The answer of the
filter, a second-order Butterworth, is written out instead.

What to use when: `jumps` for times and sizes, `sharp_angle` for that part of an angle on the
grid, `double_pulses` for what it shows.
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.scene import Scene

LIKE_TOLD = 0.3  # of a jump: the angle does not do it where it is off by more
FORGOTTEN = 12.0  # times the filter's slowest decay


def jumps(scene: Scene, axis: int) -> tuple[FloatArray, FloatArray]:
    """Return when an axis' speed jumps and by how much, s and rad/s, (j,) each.

    Only where the angles do so too: ramps may have been rounded on the way.
    """
    times, sizes = [], []
    resolution = scene.setting.rad_per_step
    edges_s, angle = scene.edges_s, scene.angle_rad[axis]
    for moved, course in scene.setting.courses if resolution is not None else ():
        if moved != axis or resolution is None:
            continue
        length = np.diff(course.start_s)
        last = np.append(0.0, course.speed[:-1] + course.acceleration[:-1] * length)
        for at_s, size in zip(course.start_s, course.speed - last, strict=True):
            k = int(np.searchsorted(edges_s, at_s, side="right")) - 1
            if size == 0.0 or not 1 <= k < edges_s.size - 2:
                continue
            near = slice(k - 1, k + 3)
            told = course.position_steps(edges_s[near]) * resolution[axis]
            off = np.diff(angle[near] - told) / np.diff(edges_s[near])
            if abs(off[-1] - off[0]) < LIKE_TOLD * abs(size * resolution[axis]):
                times.append(float(at_s))
                sizes.append(float(size) * resolution[axis])
    return np.array(times, dtype=np.float64), np.array(sizes, dtype=np.float64)


def sharp_angle(edges_s: FloatArray, time_s: FloatArray, size_rad_s: FloatArray) -> FloatArray:
    """Return the part of an angle that jumps of its speed make, at the edges, (n + 1,)."""
    found = np.zeros_like(edges_s)
    for at_s, size in zip(time_s, size_rad_s, strict=True):
        found += size * np.maximum(edges_s - at_s, 0.0)
    return found


def double_pulses(
    scene: Scene, axis: int, time_s: FloatArray, size_rad_s: FloatArray
) -> FloatArray:
    """Return what the change of such an acceleration shows in the block means, (blocks, 3).

    A rate of size x delta'(t - time) about the axis, behind the sensor's low-pass.
    """
    found = np.zeros((scene.use.size, 3))
    if scene.low_pass is None:
        return scene.mean(found)
    omega = 2.0 * np.pi * scene.low_pass.bandwidth_hz
    tilt = np.interp(time_s, scene.edges_s, scene.angle_rad[1])
    one, none = np.ones_like(tilt), np.zeros_like(tilt)
    stage = [none, np.sin(tilt), np.cos(tilt)] if axis == 0 else [one, none, none]
    shown = np.stack(stage, axis=1) @ scene.gain.T
    reach_s = FORGOTTEN * np.sqrt(2.0) / omega
    # Of what is read late the sample saw what came later.
    read_s = scene.instants_s + (0.0 if scene.delay_s is None else scene.delay_s)
    first = np.searchsorted(read_s, time_s, side="right")
    stop = np.searchsorted(read_s, time_s + reach_s)
    for k, (begin, end) in enumerate(zip(first.tolist(), stop.tolist(), strict=True)):
        x = (read_s[begin:end] - time_s[k]) * (omega / np.sqrt(2.0))
        answer = size_rad_s[k] * omega**2 * np.exp(-x) * (np.cos(x) - np.sin(x))
        found[begin:end] += answer[:, None] * shown[k]
    return scene.mean(found)
