"""The motor loses steps in a move: count and angle differ from then on.

angle - s from the event on, the whole at once: the rotor falls back by whole cycles of four
full steps, 0.411 deg on a PTU-E46-17.5 (0.1029 deg a full step). High speed, acceleration,
load, low move power or supply do it. A pulse of rate once, and every later angle is off.

A pulse is as short as the low-pass lets it be, so it has to be looked for everywhere: the
bank holds at most a few times; `pulses` has the signal of every time at once, to be weighed
against a residual, and what it shows best are the times to look from.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.arrays import FloatArray, IntArray
from gyrorig_solver.model.terms.bases import LinearAngleTerm, scanned
from gyrorig_solver.model.terms.protocol import Link, Scope, TermParameter
from gyrorig_solver.model.terms.scene import Scene
from gyrorig_solver.model.terms.wording import DEG, PAN_TILT, listed

SPACING_S = 0.02  # of the bank's times; the low-pass makes a pulse about as wide
MOST_LOOKS = 2000


@dataclass(frozen=True, slots=True, eq=False)
class Pulses:
    """What a loss of 1 rad would show at each of r times, in m blocks each."""

    time_s: FloatArray  # (r,)
    axis: IntArray  # (r,), 0 pan, 1 tilt
    first: IntArray  # (r,), first block
    values: FloatArray  # (r, m, 3)


def pulses(scene: Scene, per_block: int = 2) -> Pulses:
    """Return the pulses of losses all over the moves of each axis.

    The lean that a loss on tilt leaves behind is not in it, nor are missing samples.

    Args:
        scene: a part of a series.
        per_block: times looked from to a block.
    """
    per = scene.fine * scene.block
    every = max(1, per // per_block)
    step_s = scene.step_s
    settle = 0 if scene.low_pass is None else int(3.0 / scene.low_pass.bandwidth_hz / step_s)
    blocks = 1 + -(-(settle + per) // per)
    phases = range(0, per, every)
    shapes = np.zeros((len(phases), blocks * per + 2, 1))  # two more before, at rest
    for row, phase in enumerate(phases):
        shapes[row, phase + 1 : phase + 4, 0] = np.array([1.0, 22.0, 1.0]) / 24.0 / step_s
    out = scene.low_passed(shapes)[:, 2 + scene.fine // 2 :: scene.fine, 0][
        :, : blocks * scene.block
    ]
    kernel = out.reshape(len(phases), blocks, scene.block).mean(axis=2)
    lead = scene.lead * scene.fine
    found = []
    for axis in (0, 1):
        k = np.arange(lead, scene.n, every)
        k = k[scene.moving[axis, k] & scene.known[k]]
        first = (k - lead) // per
        k, first = k[first + blocks <= scene.blocks], first[first + blocks <= scene.blocks]
        stage = np.zeros((k.size, 3))
        if axis == 0:
            stage[:, 1], stage[:, 2] = np.sin(scene.tilt_rad[k]), np.cos(scene.tilt_rad[k])
        else:
            stage[:, 0] = 1.0
        shape = kernel[((k - lead) % per) // every]
        values = -shape[:, :, None] * (stage @ scene.gain.T)[:, None, :]
        found.append((scene.time_s[k], np.full(k.size, axis), first, values))
    time_s, axes, firsts, values = (np.concatenate(part) for part in zip(*found, strict=True))
    return Pulses(time_s, axes, firsts, values)


class LostSteps(LinearAngleTerm):
    """Angle lost by pan and tilt, then when."""

    cause = "lost_steps"
    link: Link = "rotor"
    scope: Scope = "recording"
    parameters = (
        TermParameter(
            name="angle",
            unit="rad",
            typical=0.411 * DEG,
            lower=-10.0 * DEG,
            upper=10.0 * DEG,
            prior_std=2.0 * DEG,
            parts=PAN_TILT,
        ),
        TermParameter(
            "time", "s", typical=1.0, lower=-np.inf, upper=np.inf, prior_std=np.inf, role="event"
        ),
    )
    confused_with = ("backlash", "clock_step", "board_slip")
    excitation = "a return to the first poses at the end, and homing once more"
    harm = "lost on pan: little; on tilt: M is a mean of two"

    def shapes(self, scene: Scene, values: FloatArray) -> list[tuple[int, FloatArray]]:
        """Return minus the step at the event."""
        k = self._interval(scene, float(values[2]))
        shape = np.zeros(scene.n + 1)
        shape[max(0, k + 1) :] = -1.0
        if 1 <= k < scene.n - 2:
            shape[k : k + 4] = -np.cumsum(self._shares(scene, k, float(values[2])))
        return [(0, shape), (1, shape)]

    def bank(self, scene: Scene) -> FloatArray:
        """Look from all over the moves."""
        runs = scene.moving.any(axis=0) & scene.known
        every = max(1, round(SPACING_S / scene.step_s), -(-int(runs.sum()) // MOST_LOOKS))
        return scanned(self, time=scene.time_s[runs][::every])

    def directions(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the derivative by the sizes, zero for an axis that stands at the event.

        On pan it is a pulse and cheap; on tilt the lean that stays counts too.
        """
        found = np.zeros((2, scene.blocks, 3))
        k = self._interval(scene, float(values[2]))
        if not 1 <= k < scene.n - 2:
            return found
        if scene.moving[0, k]:
            fallen = np.cumsum([0.0, *self._shares(scene, k, float(values[2]))])
            pulse = scene.turn.rate(0, -fallen, slice(k - 1, k + 3))
            found[0] = scene.seen_briefly(k - 1, pulse)
        if scene.moving[1, k]:
            shape = self.shapes(scene, values)[1][1]
            found[1] = scene.seen_at_stage(scene.turn_column(1, shape))
        return found

    def columns(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the derivative by the values, (3, blocks, 3)."""
        found = np.zeros((3, scene.blocks, 3))
        rates = [scene.turn_column(axis, s) for axis, s in self.shapes(scene, values)]
        found[:2] = scene.seen_at_stage(np.stack(rates))
        if values[:2].any():
            found[2] = self._difference(scene, values, 2)
        return found

    def sentence(self, values: FloatArray) -> str:
        """Say how much and when."""
        said = listed(values[:2] / DEG, PAN_TILT, "deg")
        return f"the motors lose steps at {values[2]:.2f} s: {said}"

    def _interval(self, scene: Scene, event_s: float) -> int:
        """Return the interval whose middle is the last before the event."""
        if event_s <= scene.time_s[0]:
            return -1
        k = int(np.searchsorted(scene.time_s, event_s, side="right")) - 1
        return k if k < scene.n - 1 or event_s < scene.edges_s[-1] else scene.n

    def _shares(self, scene: Scene, k: int, event_s: float) -> FloatArray:
        """Return what four intervals, from `k - 1` on, have of the pulse.

        Its moments about the event are those that make the low-pass see it there and as
        short as it is: it takes them for means of something smooth, and sharpens them by
        h^2/4 where straight lines between them are wider by h^2/6.
        """
        step = (scene.time_s[k - 1 : k + 3] - event_s) / scene.step_s
        moments = np.array([1.0, 0.0, 1.0 / 12.0, 0.0])
        return np.asarray(np.linalg.solve(np.vander(step, 4, increasing=True).T, moments))


TERM = LostSteps()
