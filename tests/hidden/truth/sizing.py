"""How large an effect has to be to be so and so visible, by its own noise-free difference.

What to use when: `Sizer` for one rig under one program: `visibility` of given sizes,
`sized` for the size at a wanted non-centrality. The energy of most effects goes with the
square of their size; for the others a secant in logarithms goes on until it fits.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from tests.hidden.truth.detectable import detectable_of
from tests.hidden.truth.session import BOARD, ORIGIN_NS, Course, More
from tests.hidden.truth.variance import jitter_noncentrality, walk_noncentrality
from tests.support.noncentrality import NuisanceProjector, Visibility

from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.emulator_settings import InjectionRequest, RigSettings
from gyrorig_daemon.emulator.injection import CAUSES
from gyrorig_daemon.emulator.noise_free_rates import NoiseFreeRates, RigTwin
from gyrorig_daemon.emulator.rig_truth import sample_rig_truth

FloatArray = NDArray[np.float64]

NEAR = 0.02  # of the wanted non-centrality
COUNTED = (
    "lost_samples", "repeated_samples", "corrupt_samples", "axis_swap", "sign_flip",
    "wrong_full_scale",
)  # fmt: skip
IN_VARIANCE = ("sample_jitter", "bias_random_walk")
_ROUNDS = 16
_SMOOTH = 6  # rounds of secants
_ROUGHLY = 0.3  # where no size fits, as for what begins with a jump
_KEPT = 10  # rates, as they are asked for again
_STEEPEST = 8.0  # of the energy with size, in logarithms


@dataclass(frozen=True, slots=True)
class VisibleSize:
    """A size and what it shows."""

    size: float
    seen: Visibility
    detectable: float  # non-centrality that has to be there

    @property
    def times(self) -> float:
        """How many times the minimal detectable size it is."""
        return math.sqrt(max(self.seen.noncentrality, 0.0) / self.detectable)


class Sizer:
    """Visibility of what may be hidden in one rig under one program."""

    def __init__(self, settings: RigSettings, course: Course) -> None:
        """Take the rig, and what its axes are told."""
        self._settings = replace(settings, injections=(), noise_free=True)
        self._course = course
        truth = sample_rig_truth(self._settings)
        self._board = truth.boards[BOARD].to_document()
        self._twins = RigTwin(self._settings, ORIGIN_NS, course.orders, course.until_ns, truth)
        self._known: dict[tuple[InjectionRequest, ...], NoiseFreeRates] = {}
        self._plain: NoiseFreeRates | None = None
        self._plain_space: NuisanceProjector | None = None

    def rates(self, *hide: InjectionRequest, more: More | None = None) -> NoiseFreeRates:
        """Return the rates with something hidden, and without it."""
        known = self._known.get(hide) if more is None else None
        if known is not None:
            return known
        settings = replace(self._settings, injections=hide)
        rates = self._twins.rates(EmulatedRig(settings, ORIGIN_NS, extra_effects=more))[BOARD]
        if more is None:
            self._known[hide] = rates
            if len(self._known) > _KEPT:
                del self._known[next(iter(self._known))]
        return rates

    def space(self, rates: NoiseFreeRates) -> NuisanceProjector:
        """Return the space beside what a calibration estimates of such rates."""
        if rates.aligned_rad_s is not rates.plain_rad_s:
            return self._space_with_rates(rates)
        if self._plain_space is None:
            self._plain_space = self._space_with_rates(rates)
        return self._plain_space

    def visibility(self, *hide: InjectionRequest, more: More | None = None) -> Visibility:
        """Return how visible it is."""
        rates = self.rates(*hide, more=more)
        return self.space(rates).visibility(rates)

    def beside_others(self, orders: Sequence[InjectionRequest | None]) -> list[float | None]:
        """Return each effect's non-centrality with the effects of the others taken off too."""
        left: list[FloatArray | None] = []
        for order in orders:
            rates = None if order is None else self.rates(order)
            left.append(None if rates is None else self.space(rates).projected_effect(rates))
        shares: list[float | None] = []
        for k, signal in enumerate(left):
            if signal is None:
                shares.append(None)
                continue
            others = [o for j, o in enumerate(left) if j != k and o is not None]
            rest = signal
            if others:
                basis = np.stack(others, axis=1)
                rest = signal - basis @ np.linalg.lstsq(basis, signal, rcond=None)[0]
            shares.append(float(rest @ rest))
        return shares

    def of_cause(self, name: str, place: str) -> Callable[[float], Visibility]:
        """Return how visible a cause is, by its size."""
        if name == "sample_jitter":
            plain = self._plain_rates()
            unit = jitter_noncentrality(self.space(plain), plain)
            return lambda size: Visibility(unit * size**4, 0.0)
        if name == "bias_random_walk":
            return lambda size: Visibility(self._walk(place, size), 0.0)
        return lambda size: self.visibility(InjectionRequest(name, place, size))

    def sized(
        self,
        seen: Callable[[float], Visibility],
        wanted: tuple[float, float],
        start: float,
        most: float,
    ) -> VisibleSize | None:
        """Return the size at which an effect is so many times its minimal detectable size.

        Args:
            seen: how visible it is, by size; grows with the size's amount.
            wanted: how many times, and the minimal detectable non-centrality.
            start: a size to begin with; its sign is kept.
            most: amount that it may have at most.

        Returns:
            None where it needs more than the most.
        """
        times, least = wanted
        aim = math.log(times**2 * least)
        sign, x, top = math.copysign(1.0, start), math.log(min(abs(start), most)), math.log(most)
        low, high = -math.inf, math.inf
        best: tuple[float, VisibleSize] | None = None
        before: tuple[float, float] | None = None
        for round_ in range(_ROUNDS):
            visibility = seen(sign * math.exp(x))
            y = math.log(max(visibility.noncentrality, 1e-12))
            if best is None or abs(y - aim) < best[0]:
                best = abs(y - aim), VisibleSize(sign * math.exp(x), visibility, least)
            if best[0] < NEAR or (y < aim and x >= top - 1e-12):
                break
            low, high = (max(low, x), high) if y < aim else (low, min(high, x))
            slope = 2.0
            if before is not None and abs(x - before[0]) > 1e-9:
                slope = min(max((y - before[1]) / (x - before[0]), 0.5), _STEEPEST)
            before = x, y
            x = min(x + min(max((aim - y) / slope, -4.0), 4.0), top)
            if not low < x < high or (round_ > _SMOOTH and math.isfinite(high - low)):
                x = 0.5 * (low + high)  # what jumps with the size is halved until it fits
        return best[1] if best is not None and best[0] < _ROUGHLY else None

    def size_of_cause(self, name: str, place: str, times: float, sign: float) -> VisibleSize | None:
        """Return a cause's size at so many times the minimal detectable one, None above the most.

        A rate that is never exceeded is the smaller the more it shows; steps are lost whole.
        """
        cause, seen, least = CAUSES[name], self.of_cause(name, place), detectable_of(name)
        if name == "saturation":
            peak = float(np.abs(self._plain_rates().plain_rad_s).max())
            size = self.sized(lambda x: seen(peak - x), (times, least), 0.05 * peak, 0.8 * peak)
            return None if size is None else VisibleSize(peak - size.size, size.seen, least)
        if cause.is_integer:
            at_one = seen(1.0)
            if at_one.noncentrality <= 0.0:
                return None
            steps = max(round(times / VisibleSize(1.0, at_one, least).times), 1)
            return (
                VisibleSize(sign * steps, seen(sign * steps), least)
                if steps <= cause.sampled_max
                else None
            )
        return self.sized(seen, (times, least), sign * cause.typical, cause.sampled_max)

    def _plain_rates(self) -> NoiseFreeRates:
        if self._plain is None:
            self._plain = self.rates()
        return self._plain

    def _walk(self, place: str, size: float) -> float:
        order = InjectionRequest("bias_random_walk", place, size)
        settings = replace(self._settings, injections=(order,))
        walk = sample_rig_truth(settings).injected[0].array("walk")
        plain = self._plain_rates()
        count = int(self.space(plain).inside.sum())
        return walk_noncentrality(self._board, walk, count)

    def _space_with_rates(self, rates: NoiseFreeRates) -> NuisanceProjector:
        return NuisanceProjector(rates, self._board, self._course.moves_s, self._course.span_s)
