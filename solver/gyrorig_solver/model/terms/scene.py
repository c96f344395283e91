"""What a physical cause may look at: a part of one board's series at the fit's current state.

What to use when: `Scene.build` from plain arrays: the edges of a grid of intervals, already
moved by the lag of the samples behind the motion, and the reference's pan and tilt there;
`seen` and `seen_at_stage` to learn what of a rate shows in the block means; `turned` and
`turn_column` to go from angles of the axes to stage rates.

The grid has `fine` intervals to a sample instant, an odd number so that one is centred on
it, and `block` instants to a mean. On the series' own fine grid that is what the samples
saw, exactly. A coarser grid (a few intervals to a block, each standing for an instant) is
as good for derivatives and several times faster.

A scene may be one that other causes have changed already: `with_angles`, `with_rate`,
`with_sensor`, `with_output` and `with_delay` are what each link of the chain from motor to
stamp passes on; `at_stage`, `at_sensor` and `at_output` look at a link with nothing behind it.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from scipy.sparse import csr_array

from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.model.between import Between
from gyrorig_solver.model.low_pass import LowPass
from gyrorig_solver.model.terms.temperature import Temperature
from gyrorig_solver.reference.course import Course
from gyrorig_solver.reference.kinematics import AxisTurn

STANDARD_GRAVITY_M_S2 = 9.80665  # CGPM 1901
MOVING_RAD_S = 1e-4  # an axis slower than this stands; a step (0.05 deg) takes 10 s then


@dataclass(frozen=True, slots=True)
class Site:
    """Where the rig stands (contract: metadata `gyrorig.site`); None where it is not said."""

    latitude_deg: float | None = None  # north positive
    heading_deg: float | None = None  # of the base's y axis, clockwise from true north
    gravity_m_s2: float = STANDARD_GRAVITY_M_S2


@dataclass(frozen=True, slots=True, eq=False)
class Setting:
    """What stays the same over a recording of one board."""

    site: Site = Site()
    temperature: Temperature | None = None
    rad_per_step: tuple[float, float] | None = None  # pan and tilt, with the unit's sign
    courses: tuple[tuple[int, Course], ...] = ()  # axis (0 pan, 1 tilt) and profile of moves
    begin_s: float = 0.0  # of the recording, on its time axis
    end_s: float = 0.0
    power_on_s: float | None = None  # of the board; None: not known
    full_scale_rad_s: float | None = None  # of the configured range
    quantum_rad_s: float = 0.0  # one count
    sample_period_s: float | None = None
    # By how much causes have changed these limits of pan and tilt: share, base speed (rad/s).
    laid: tuple[tuple[float, float], tuple[float, float]] = ((0.0, 0.0), (0.0, 0.0))
    recording: str = ""  # its name
    number: int = 0  # of the recording, among those that are fitted together


@dataclass(frozen=True, eq=False)
class Scene:
    """A part of a series; see the module. Arrays over n intervals."""

    edges_s: FloatArray  # (n + 1,)
    angle_rad: FloatArray  # (2, n + 1), pan and tilt at the edges
    known: BoolArray  # (n,), False where the motion is not known
    rate_rad_s: FloatArray  # (n, 3), of the stage, its own frame; zero where not known
    turn: AxisTurn  # what small changes of the angles (in rad) do to that rate
    gain: FloatArray  # (3, 3), G = S T M
    bias_rad_s: FloatArray  # (3,)
    setting: Setting
    use: BoolArray  # (blocks * block,), instants that take part
    block: int
    fine: int
    lead: int  # instants before the first block, in which the filter settles
    low_pass: LowPass | None
    has_angles: bool  # False: a reference without pan and tilt
    arrived: tuple[float, float]  # direction of each axis' last move before this part, or 0
    # What causes further up the chain have changed already; None: nothing.
    runs: BoolArray | None = None  # (2, n), whether the motors turn, whatever the stage does
    sensor_added_rad_s: FloatArray | None = None  # (n, 3), in front of the low-pass
    output_added_rad_s: FloatArray | None = None  # (n, 3), behind it
    delay_s: FloatArray | None = None  # (instants,), how much later than stamped

    @classmethod
    def build(
        cls,
        edges_s: FloatArray,
        angle_rad: FloatArray | None,
        use: BoolArray,
        *,
        block: int,
        fine: int,
        bandwidth_hz: float | None,
        gain: FloatArray,
        bias_rad_s: FloatArray | None = None,
        rate_rad_s: FloatArray | None = None,
        known: BoolArray | None = None,
        setting: Setting | None = None,
        arrived: tuple[float, float] = (0.0, 0.0),
    ) -> Self:
        """Return the scene of one part.

        Args:
            edges_s: of the intervals, shape (n + 1,), n a multiple of `fine`; what is more
                than `use.size * fine` intervals lies before the first block.
            angle_rad: pan and tilt there, shape (2, n + 1); None where there are none.
            use: which instants take part, whole blocks.
            block: instants to a block mean.
            fine: intervals to an instant, odd.
            bandwidth_hz: of the sensor's low-pass, None where it is not to be put in.
            gain: G of the fit now.
            bias_rad_s: of the fit now.
            rate_rad_s: mean stage rate between edges, (n, 3), nan where unknown; made of
                the angles where it is not given.
            known: (n,), False where the angles are not to be believed.
            setting: of the recording.
            arrived: the sign of each axis' last motion before this part, 0 if unknown.
        """
        n = edges_s.size - 1
        angle = np.zeros((2, n + 1)) if angle_rad is None else angle_rad
        found, turn = AxisTurn.along(angle, edges_s, (1.0, 1.0))
        rate = found if rate_rad_s is None else rate_rad_s
        sure: BoolArray = np.asarray(np.isfinite(rate).all(axis=1), dtype=np.bool_)
        if known is not None:
            sure = np.asarray(sure & known)
        step_s = float(edges_s[-1] - edges_s[0]) / n
        return cls(
            edges_s=edges_s,
            angle_rad=angle,
            known=sure,
            rate_rad_s=np.where(sure[:, None], rate, 0.0),
            turn=turn,
            gain=gain,
            bias_rad_s=np.zeros(3) if bias_rad_s is None else bias_rad_s,
            setting=setting or Setting(begin_s=float(edges_s[0]), end_s=float(edges_s[-1])),
            use=use,
            block=block,
            fine=fine,
            lead=n // fine - use.size,
            low_pass=None if bandwidth_hz is None else LowPass(bandwidth_hz, 1.0 / step_s),
            has_angles=angle_rad is not None,
            arrived=arrived,
        )

    @property
    def n(self) -> int:
        """How many intervals there are."""
        return self.edges_s.size - 1

    @property
    def _first(self) -> int:
        return self.fine // 2 + self.lead * self.fine

    @property
    def blocks(self) -> int:
        """How many block means there are."""
        return self.use.size // self.block

    @cached_property
    def step_s(self) -> float:
        """The usual width of an interval."""
        return float(self.edges_s[-1] - self.edges_s[0]) / self.n

    @cached_property
    def time_s(self) -> FloatArray:
        """Middles of the intervals, shape (n,)."""
        return np.asarray((self.edges_s[:-1] + self.edges_s[1:]) / 2.0, dtype=np.float64)

    @property
    def tilt_rad(self) -> FloatArray:
        """Tilt at the middles, shape (n,)."""
        return self.turn.tilt_rad

    @cached_property
    def pan_rad(self) -> FloatArray:
        """Pan at the middles, shape (n,)."""
        return np.asarray((self.angle_rad[0, :-1] + self.angle_rad[0, 1:]) / 2.0, np.float64)

    @property
    def pan_rate_rad_s(self) -> FloatArray:
        """Pan rate, shape (n,)."""
        return self.turn.pan_rate_rad_s

    @cached_property
    def tilt_rate_rad_s(self) -> FloatArray:
        """Tilt rate, shape (n,)."""
        return np.asarray(np.diff(self.angle_rad[1]) / self.turn.width_s, np.float64)

    @cached_property
    def moving(self) -> BoolArray:
        """Whether pan and tilt turn, shape (2, n)."""
        if self.runs is not None:
            return self.runs
        rates = np.stack([self.pan_rate_rad_s, self.tilt_rate_rad_s])
        return np.asarray(np.abs(rates) > MOVING_RAD_S, dtype=np.bool_)

    def pushed(self, axis: int) -> float:
        """Return the direction of an axis' last motion before this part, 0 if unknown."""
        before = [
            course
            for moved, course in self.setting.courses
            if moved == axis and course.start_s[0] < self.edges_s[0]
        ]
        if self.arrived[axis] or not before:
            return self.arrived[axis]
        last = max(before, key=lambda course: float(course.start_s[0]))
        at = np.searchsorted(last.start_s, self.edges_s[0], side="right")
        turned = last.speed[:at] + 0.5 * last.acceleration[:at]
        some = np.flatnonzero(turned)
        counted = 1.0 if self.setting.rad_per_step is None else self.setting.rad_per_step[axis]
        return float(np.sign(turned[some[-1]] * counted)) if some.size else 0.0

    @cached_property
    def sensor_rate_rad_s(self) -> FloatArray:
        """What the sensor turns by its own axes, G omega, shape (n, 3), without bias."""
        rate = np.asarray(self.rate_rad_s @ self.gain.T, dtype=np.float64)
        return rate if self.sensor_added_rad_s is None else rate + self.sensor_added_rad_s

    @cached_property
    def specific_force_m_s2(self) -> FloatArray:
        """What an accelerometer at rest reads in the stage frame, level rig, shape (n, 3)."""
        g = self.setting.site.gravity_m_s2
        zero = np.zeros(self.n)
        return np.column_stack([zero, g * np.sin(self.tilt_rad), g * np.cos(self.tilt_rad)])

    @cached_property
    def filtered_rad_s(self) -> FloatArray:
        """G omega behind the low-pass, shape (n, 3)."""
        rate = self.low_passed(self.sensor_rate_rad_s)
        return rate if self.output_added_rad_s is None else rate + self.output_added_rad_s

    @cached_property
    def filtered_slope_rad_s2(self) -> FloatArray:
        """Its time derivative, shape (n, 3)."""
        return np.asarray(np.gradient(self.filtered_rad_s, self.step_s, axis=0), np.float64)

    def low_passed(self, sensor_rate: FloatArray) -> FloatArray:
        """Return mean rates of shape (..., n, 3) behind the sensor's low-pass, begun as steady.

        As the fit's own prediction does: see `LowPass.apply_to_means`.
        """
        if self.low_pass is None:
            return sensor_rate
        means = np.ascontiguousarray(np.swapaxes(sensor_rate, -1, -2))
        return np.swapaxes(self.low_pass.apply_to_means(means), -1, -2)

    @cached_property
    def instants_s(self) -> FloatArray:
        """When the blocks' samples were taken, (instants,), shape of `use`."""
        return np.ascontiguousarray(self.time_s[self._first :: self.fine])

    def mean(self, at_instants: FloatArray) -> FloatArray:
        """Return block means, (..., blocks, 3), of (..., instants, 3).

        Zero where no instant of a block takes part.
        """
        if self.block == 1:
            return at_instants if self._all_used else np.where(self.use[:, None], at_instants, 0.0)
        shape = (*at_instants.shape[:-2], self.blocks, self.block, 3)
        shaped = at_instants.reshape(shape)
        if self._all_used:
            return np.asarray(shaped.mean(axis=-2), dtype=np.float64)
        weight = self.use.reshape(self.blocks, self.block, 1)
        count = np.maximum(weight.sum(axis=1), 1)
        return np.asarray(np.where(weight, shaped, 0.0).sum(axis=-2) / count, np.float64)

    def read(self, output: FloatArray) -> FloatArray:
        """Return the block means of what leaves the low-pass, shape (..., n, 3)."""
        if self.delay_s is None:
            return self.mean(output[..., self._first :: self.fine, :])
        return self._read_late(np.ascontiguousarray(np.swapaxes(output, -1, -2)))

    def _read_late(self, output: FloatArray) -> FloatArray:
        """Return block means of what leaves the low-pass, (..., 3, n), at the late instants."""
        rows = output.reshape(-1, self.n)
        found = np.empty((len(rows), self.use.size))
        for k, row in enumerate(rows):
            found[k] = self._late @ row
        shaped = found.reshape(*output.shape[:-1], self.use.size)
        return self.mean(np.swapaxes(shaped, -1, -2))

    @cached_property
    def _late(self) -> csr_array:
        """What takes a signal (n,) to the instants, as late as they are."""
        late = self.instants_s if self.delay_s is None else self.instants_s + self.delay_s
        return Between.of(self.time_s, late).operator(self.step_s)

    def later(self, delay_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what the sensor would show if each instant were later, and its slope.

        Args:
            delay_s: shape (instants,); what the scene has already comes on top.

        Returns:
            G omega behind the low-pass and its time derivative, (instants, 3) each, by
            cubic Hermite interpolation; constant beyond the ends.
        """
        if not delay_s.any():
            return self._now
        whole = delay_s if self.delay_s is None else delay_s + self.delay_s
        return self._later(whole)

    def _later(self, whole: FloatArray) -> tuple[FloatArray, FloatArray]:
        there = Between.of(self.time_s, self.instants_s + whole)
        return there.read(self.filtered_rad_s, self.filtered_slope_rad_s2)

    @cached_property
    def now_rad_s(self) -> FloatArray:
        """What the sensor shows at its instants, as they are, (instants, 3)."""
        return self._now[0]

    @cached_property
    def _now(self) -> tuple[FloatArray, FloatArray]:
        return self._later(np.zeros(self.use.size) if self.delay_s is None else self.delay_s)

    def seen(self, sensor_rate: FloatArray) -> FloatArray:
        """Return what of a rate at the sensor, (..., n, 3), shows in the block means."""
        if self.low_pass is None:
            return self.read(sensor_rate)
        means = np.ascontiguousarray(np.swapaxes(sensor_rate, -1, -2))
        if self.delay_s is not None:
            return self._read_late(self.low_pass.apply_to_means(means))
        instants = self.low_pass.apply_to_instants(means, self.fine)
        return self.mean(np.swapaxes(instants[..., self.lead :], -1, -2))

    def seen_at_stage(self, stage_rate: FloatArray) -> FloatArray:
        """Return what of a change of the stage's rate, (..., n, 3), shows."""
        sure = stage_rate if self._whole else np.where(self.known[:, None], stage_rate, 0.0)
        # As linear as the low-pass: turned last, where fewest values are left.
        return np.asarray(self.seen(sure) @ self.gain.T, dtype=np.float64)

    @cached_property
    def _all_used(self) -> bool:
        return bool(self.use.all())

    @cached_property
    def _whole(self) -> bool:
        return bool(self.known.all())

    def seen_briefly(self, first: int, stage_rate: FloatArray) -> FloatArray:
        """Return `seen_at_stage` of a change that is zero but in a few intervals.

        Args:
            first: index of its first interval.
            stage_rate: shape (m, 3).
        """
        if self.delay_s is not None:
            whole = np.zeros((self.n, 3))
            inside = whole[first : first + len(stage_rate)]
            inside[:] = stage_rate[: len(inside)]
            return self.seen_at_stage(whole)
        found = np.zeros((self.blocks, 3))
        per = self.fine * self.block
        settle = 0 if self.low_pass is None else int(3.0 / self.low_pass.bandwidth_hz / self.step_s)
        lead = self.lead * self.fine
        begin = max(0, (first - lead) // per)
        end = min(self.blocks, -((lead - first - len(stage_rate) - settle) // per))
        if end <= begin:
            return found
        start = lead + begin * per
        window = np.zeros(((end - begin) * per + 1, 3))  # one more before, at rest
        skip = max(0, start - first)
        inside = stage_rate[skip:]
        at = first + skip - start + 1
        inside = inside[: len(window) - at]
        sure = self.known[first + skip : first + skip + len(inside), None]
        window[at : at + len(inside)] = np.where(sure, inside, 0.0) @ self.gain.T
        out = self.low_passed(window)[1:]
        use = self.use[begin * self.block : end * self.block].reshape(-1, self.block, 1)
        values = out[self.fine // 2 :: self.fine].reshape(-1, self.block, 3)
        total = np.where(use, values, 0.0).sum(axis=1)
        found[begin:end] = total / np.maximum(use.sum(axis=1), 1)
        return found

    def turned(self, change_rad: FloatArray) -> FloatArray:
        """Return the change of the stage's rate, (n, 3), exactly, by angles off at the edges.

        Args:
            change_rad: true minus told pan and tilt, shape (2, n + 1).
        """
        if not change_rad[1].any():
            return self.turn_column(0, change_rad[0])  # linear in what pan does
        rate, _ = AxisTurn.along(self.angle_rad + change_rad, self.edges_s, (1.0, 1.0))
        return np.asarray(rate - self._told_rad_s, dtype=np.float64)

    @cached_property
    def _told_rad_s(self) -> FloatArray:
        return AxisTurn.along(self.angle_rad, self.edges_s, (1.0, 1.0))[0]

    # ---- what the next link of the chain sees

    def with_angles(self, change_rad: FloatArray) -> Self:
        """Return the scene with the stage at other angles, shape (2, n + 1)."""
        angle = self.angle_rad + change_rad
        rate, turn = AxisTurn.along(angle, self.edges_s, (1.0, 1.0))
        more = np.where(self.known[:, None], rate - self._told_rad_s, 0.0)
        return replace(
            self,
            angle_rad=angle,
            turn=turn,
            rate_rad_s=self.rate_rad_s + more,
            runs=self.moving,
        )

    def with_rate(self, change_rad_s: FloatArray) -> Self:
        """Return the scene with the stage, or what is on it, turning otherwise, (n, 3)."""
        more = np.where(self.known[:, None], change_rad_s, 0.0)
        return replace(self, rate_rad_s=self.rate_rad_s + more)

    def with_sensor(self, change_rad_s: FloatArray) -> Self:
        """Return the scene with more rate in front of the low-pass, sensor frame, (n, 3)."""
        before = self.sensor_added_rad_s
        more = change_rad_s if before is None else before + change_rad_s
        return replace(self, sensor_added_rad_s=more)

    def with_output(self, change_rad_s: FloatArray) -> Self:
        """Return the scene with more rate behind the low-pass, (n, 3)."""
        before = self.output_added_rad_s
        more = change_rad_s if before is None else before + change_rad_s
        return replace(self, output_added_rad_s=more)

    def with_delay(self, delay_s: FloatArray) -> Self:
        """Return the scene with instants later than stamped, (instants,)."""
        return replace(self, delay_s=delay_s if self.delay_s is None else self.delay_s + delay_s)

    def at_stage(self) -> Self:
        """Return a scene in which every interval of the stage's own rate is a block."""
        return replace(self._bare(), gain=np.eye(3), low_pass=None)

    def at_sensor(self) -> Self:
        """Return a scene in which every interval in front of the low-pass is a block."""
        return replace(self._bare(), low_pass=None)

    def at_output(self) -> Self:
        """Return a scene in which every interval behind the low-pass is a block."""
        return self._bare()

    def _bare(self) -> Self:
        every = np.ones(self.n, dtype=np.bool_)
        return replace(self, use=every, block=1, fine=1, lead=0, delay_s=None)

    def turn_column(self, axis: int, change_rad: FloatArray) -> FloatArray:
        """Return that change, (n, 3), to first order, for one axis, shape (n + 1,)."""
        return self.turn.rate(axis, change_rad, slice(0, self.n))


def by_axis(seen: FloatArray) -> FloatArray:
    """Return a signal of three sensor axes taken apart, shape (3, blocks, 3)."""
    apart = np.zeros((3, *seen.shape))
    for axis in range(3):
        apart[axis, :, axis] = seen[:, axis]
    return apart
