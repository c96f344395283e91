"""The few ways in which a cause may act, so that each cause's file holds only its physics.

What to use when: `LinearTerm` where the effect is a sum of sizes times signals at the
sensor; `AngleTerm` and `LinearAngleTerm` where the stage's angles are not what they were
told to be; `TimeTerm` where samples were taken at other times; `CurvedTerm` for any other
effect; `UnseenTerm` where nothing shows in the mean.
"""

from abc import ABC, abstractmethod

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.model.terms.protocol import (
    Kind,
    Link,
    Part,
    Scope,
    TermParameter,
    indices,
    value_parameters,
)
from gyrorig_solver.model.terms.scene import Scene

DERIVATIVE_STEP = 1e-3  # of a parameter's typical size, where no derivative is written out


class BaseTerm(ABC):
    """What all causes share; see `protocol.Term`."""

    cause: str
    part: Part
    kind: Kind = "effect"
    link: Link = "sensor"
    reshapes: bool = False
    as_if_shown: bool = False
    scope: Scope = "board"
    parameters: tuple[TermParameter, ...]
    confused_with: tuple[str, ...] = ()
    excitation: str
    harm: str
    derivative_step = DERIVATIVE_STEP  # wider where the effect changes by steps

    @abstractmethod
    def effect(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the exact change of the measured rate, (blocks, 3), at values (k,)."""

    def passed(self, scene: Scene, values: FloatArray) -> Scene:
        """Return the scene as the causes further down the chain see it.

        The effect itself, looked at where it arises, is what is passed on.
        """
        if self.link in ("axes", "mount"):
            return scene.with_rate(self.effect(scene.at_stage(), values))
        if self.link in ("sensor", "threshold", "bias"):
            return scene.with_sensor(self.effect(scene.at_sensor(), values))
        if self.link == "limit":
            return scene.with_output(self.effect(scene.at_output(), values))
        if self.link == "readout":
            return scene
        raise NotImplementedError(f"{self.cause} does not say what {self.link} passes on")

    @abstractmethod
    def sentence(self, values: FloatArray) -> str:
        """Say to a person at the rig what these values mean."""

    def missing(self, scene: Scene) -> str | None:
        """Return None: it can always be looked at."""
        return None

    def tilt_zero_std_rad(self, values: FloatArray) -> float:
        """Return zero: the stage stands where it is told to."""
        return 0.0

    def bandwidth_share(self, values: FloatArray) -> float:
        """Return one: the noise passes the low-pass that is configured."""
        return 1.0

    def unheld(self, scene: Scene, values: FloatArray) -> FloatArray | None:
        """Return None: what it does is passed on with the scene."""
        return None

    def unsure(self, scene: Scene, values: FloatArray) -> BoolArray | None:
        """Return None: what it shows does not hang on the last tenth of a millisecond."""
        return None

    def columns(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the derivative by the values, (k, blocks, 3), by central differences."""
        found = np.zeros((values.size, scene.blocks, 3))
        for k in range(values.size):
            found[k] = self._difference(scene, values, k)
        return found

    def slopes(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the columns: no step changes them much."""
        return self.columns(scene, values)

    def passes(self, scene: Scene, values: FloatArray) -> FloatArray | None:
        """Return None: it cuts nothing off."""
        return None

    def bank(self, scene: Scene) -> FloatArray:
        """Return one row: where a fit begins."""
        return start_values(self)[None, :]

    def directions(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the derivative by the sizes, (d, blocks, 3)."""
        return self.columns(scene, values)[self.sizes]

    @property
    def sizes(self) -> list[int]:
        """Which values are sizes."""
        return indices(self, role="size")

    def _difference(self, scene: Scene, values: FloatArray, k: int) -> FloatArray:
        parameter = value_parameters(self)[k]
        step = np.zeros(values.size)
        step[k] = self.derivative_step * parameter.typical
        back = step if values[k] - step[k] >= parameter.lower else 0.0 * step
        higher, lower = self.effect(scene, values + step), self.effect(scene, values - back)
        return np.asarray((higher - lower) / (step[k] + back[k]), dtype=np.float64)


class LinearTerm(BaseTerm):
    """A sum of sizes times signals; the signals may depend on shapes and events."""

    @abstractmethod
    def basis(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the signal of each size as the series shows it, (sizes, blocks, 3)."""

    def effect(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the sum, shape (blocks, 3)."""
        return np.tensordot(values[self.sizes], self.basis(scene, values), axes=1)

    def columns(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the signals, and differences by what shapes them, (k, blocks, 3)."""
        found = np.zeros((values.size, scene.blocks, 3))
        found[self.sizes] = self.basis(scene, values)
        if values[self.sizes].any():
            for k in indices(self, role="shape") + indices(self, role="event"):
                found[k] = self._difference(scene, values, k)
        return found

    def directions(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the signals, (sizes, blocks, 3)."""
        return self.basis(scene, values)


class CurvedTerm(BaseTerm):
    """Any effect; what to look for is the effect at each finite size of the bank."""

    def directions(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the effect of each size alone, per unit of it, (sizes, blocks, 3).

        Where the row of the bank has no size, its derivative there.
        """
        found = []
        for k in self.sizes:
            if values[k] == 0.0:
                found.append(self._difference(scene, values, k))
                continue
            alone = values.copy()
            alone[[other for other in self.sizes if other != k]] = 0.0
            found.append(self.effect(scene, alone) / values[k])
        return np.stack(found)


class AngleTerm(CurvedTerm):
    """The stage is not at the angles that the unit believes."""

    part: Part = "ptu"
    link: Link = "stage"
    reshapes: bool = True
    scope: Scope = "unit"

    @abstractmethod
    def change(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return true minus told pan and tilt at the edges, (2, n + 1)."""

    def effect(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return what the angles' change does to the measured rate, (blocks, 3)."""
        return scene.seen_at_stage(scene.turned(self.change(scene, values)))

    def passed(self, scene: Scene, values: FloatArray) -> Scene:
        """Return the scene with the angles off."""
        return scene.with_angles(self.change(scene, values))

    def missing(self, scene: Scene) -> str | None:
        """Say that a reference without pan and tilt tells nothing of a unit."""
        return None if scene.has_angles else "the reference has no pan and tilt; use a unit"


class LinearAngleTerm(AngleTerm):
    """Angles off by a sum of sizes times shapes; columns are then first order, analytic."""

    reshapes: bool = False

    @abstractmethod
    def shapes(self, scene: Scene, values: FloatArray) -> list[tuple[int, FloatArray]]:
        """Return axis and change at the edges, (n + 1,), for a unit of each size."""

    def change(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the sum of the shapes, (2, n + 1)."""
        total = np.zeros_like(scene.angle_rad)
        for size, (axis, shape) in zip(values[self.sizes], self.shapes(scene, values), strict=True):
            total[axis] += size * shape
        return total

    def columns(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the derivative by the values, (k, blocks, 3)."""
        found = np.zeros((values.size, scene.blocks, 3))
        found[self.sizes] = self.directions(scene, values)
        if values[self.sizes].any():
            for k in indices(self, role="shape") + indices(self, role="event"):
                found[k] = self._difference(scene, values, k)
        return found

    def directions(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the derivative by the sizes, (sizes, blocks, 3)."""
        rates = [scene.turn_column(axis, s) for axis, s in self.shapes(scene, values)]
        return scene.seen_at_stage(np.stack(rates))


class TimeTerm(CurvedTerm):
    """The samples were not taken when their stamps say."""

    part: Part = "clock"
    link: Link = "clock"

    @abstractmethod
    def delay(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return how much later than stamped each instant was, s, (instants,)."""

    @abstractmethod
    def delay_columns(self, scene: Scene, values: FloatArray) -> dict[int, FloatArray]:
        """Return the delay's derivative by each value that has one written out."""

    def passed(self, scene: Scene, values: FloatArray) -> Scene:
        """Return the scene with its instants later."""
        return scene.with_delay(self.delay(scene, values))

    def effect(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the change of the measured rate, (blocks, 3)."""
        value, _ = scene.later(self.delay(scene, values))
        return scene.mean(value - scene.now_rad_s)

    def columns(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return slope times the delay's derivative, (k, blocks, 3)."""
        found = np.zeros((values.size, scene.blocks, 3))
        _, slope = scene.later(self.delay(scene, values))
        written = self.delay_columns(scene, values)
        for k in range(values.size):
            if k in written:
                found[k] = scene.mean(slope * written[k][:, None])
            elif values[self.sizes].any():
                found[k] = self._difference(scene, values, k)
        return found

    def directions(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the derivative by the sizes where they are zero, else as `CurvedTerm`."""
        if values[self.sizes].any():
            return super().directions(scene, values)
        return self.columns(scene, values)[self.sizes]


class UnseenTerm(BaseTerm):
    """Nothing shows in the mean of the series: noise, or a fault of the raw stream."""

    link: Link = "readout"

    def effect(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return zeros, shape (blocks, 3)."""
        return np.zeros((scene.blocks, 3))

    def columns(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return zeros, shape (k, blocks, 3)."""
        return np.zeros((values.size, scene.blocks, 3))


def start_values(term: BaseTerm) -> FloatArray:
    """Return where a fit of a term begins, shape (k,): no effect."""
    return np.array([p.start for p in value_parameters(term)], dtype=np.float64)


def event_times(scene: Scene, count: int) -> FloatArray:
    """Return times spread over the recording, (count,), not at its ends."""
    begin, end = scene.setting.begin_s, scene.setting.end_s
    return np.asarray(begin + (end - begin) * (np.arange(count) + 0.5) / count, np.float64)


def since(scene: Scene, event_s: float) -> FloatArray:
    """Return 0 before an event and 1 after it, (n,); the interval it falls in has its share."""
    share = (scene.edges_s[1:] - event_s) / scene.turn.width_s
    return np.clip(share, 0.0, 1.0)


def scanned(term: BaseTerm, **values: FloatArray) -> FloatArray:
    """Return the bank that scans parameters over a full grid, all else at its start.

    Args:
        term: whose bank it is.
        values: by parameter name, shape (m,) each; all parts get the same one.
    """
    named = [p.name for p in value_parameters(term)]
    grid = np.meshgrid(*values.values(), indexing="ij")
    rows = np.tile(start_values(term), (grid[0].size, 1))
    for name, column in zip(values, grid, strict=True):
        for k in (k for k, own in enumerate(named) if own == name):
            rows[:, k] = column.ravel()
    return rows
