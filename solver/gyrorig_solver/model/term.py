"""The interface of a physical cause: its card, its parameters and its effect on the rate.

What to use when: derive a cause from one of the classes in `term_kinds`, not from `Term` directly.
A fit uses `effect` and `jacobian`. The function `why_not_testable` of `testability` uses
`missing_data` and `missing_excitation`. The search also uses `template_bank` and
`tangent_signals`. Reports use the card: title, remedy, picture and so on.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.profile import SensorProfile
from gyrorig_solver.data import BoolArray, FloatArray, IntArray
from gyrorig_solver.data.link_remedies import LinkRemedy
from gyrorig_solver.model.cause_categories import (
    BRIEF_COVARIATES,
    Kind,
    Part,
    Quantity,
    Role,
    Scope,
    Stage,
    TemplateSearch,
)
from gyrorig_solver.model.recording_context import Site
from gyrorig_solver.model.signal_arrays import zero_signals
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.reference.unit.motion_law import LawQuantity

NO_ANGLES = (
    "the reference does not give the pose of the board at each moment; use a reference that does"
)
LONG_RECORDING = (
    "the recording is long, so that the fit uses means over {:.2g} s; solve a shorter one to test "
    "what acts for milliseconds"
)
DERIVATIVE_STEP = 1e-3  # of a parameter's typical size, for finite differences


@dataclass(frozen=True, slots=True)
class BinnedDependence:
    """A plot of a residual's mean, gain or lag in bins of one predictor."""

    quantity: Quantity
    covariate: str
    bins: int = 24
    ranked: bool = False  # equal counts per bin; otherwise few bins contain the rare large values


@dataclass(frozen=True, slots=True)
class TermParameter:
    """One physical quantity of a cause, with one value for each component."""

    name: str
    unit: str
    typical_size: float  # on an ordinary rig; the width of the expected range
    lower: float  # the physical cause is always within [lower, upper]
    upper: float
    prior_std: float  # of a weak prior: a few times the possible range
    components: tuple[str, ...] = ()  # x, y, z or pan, tilt; () is one value
    role: Role = "size"
    start: float = 0.0  # initial value of a fit; zero for a size
    is_integer: bool = False  # a count

    @property
    def value_count(self) -> int:
        """The number of values."""
        return max(1, len(self.components))

    @property
    def value_names(self) -> tuple[str, ...]:
        """The name of each value, as in a covariance."""
        return tuple(f"{self.name}.{part}" for part in self.components) or (self.name,)

    def log_prior_of_size(self, value: float) -> float:
        """Return the logarithm of the prior density of a size, a Cauchy distribution."""
        relative = value / self.typical_size
        return -math.log(math.pi * self.typical_size * (1.0 + relative**2))


@dataclass(frozen=True, slots=True, eq=False)
class PulseTemplates:
    """The signal of a size of one at each of r times, over m blocks."""

    time_s: FloatArray  # (r,)
    axis: IntArray  # (r,), 0 pan, 1 tilt
    first_block: IntArray  # (r,), first block
    values: FloatArray  # (r, m, 3)


def size_parameter(
    name: str,
    unit: str,
    components: tuple[str, ...] = (),
    *,
    typical: float,
    limit: float,
    prior_std: float,
    lower: float | None = None,
    factor: float = 1.0,
) -> TermParameter:
    """Return a size within ±limit, or from `lower` to the limit; `factor` scales all numbers."""
    return TermParameter(
        name,
        unit,
        typical_size=typical * factor,
        lower=-limit * factor if lower is None else lower * factor,
        upper=limit * factor,
        prior_std=prior_std * factor,
        components=components,
    )


def shape_parameter(
    name: str,
    unit: str,
    components: tuple[str, ...] = (),
    *,
    typical: float,
    lower: float,
    upper: float,
    prior_std: float,
    start: float = 0.0,
) -> TermParameter:
    """Return a shape within its limits."""
    return TermParameter(name, unit, typical, lower, upper, prior_std, components, "shape", start)


EVENT_TIME = TermParameter(
    "time",
    "s",
    typical_size=1.0,
    lower=-np.inf,
    upper=np.inf,
    prior_std=np.inf,
    role="event",
)


class Term(ABC):
    """One physical cause: a parametric model of its effect on the measured rate.

    The k values of a term are the values of its parameters, one after the other. The attributes
    without a default are the card that every cause must fill in.
    """

    cause: str  # the id in the catalogue; it never changes
    title: str  # one clause for the heading of a report
    equation: str  # with the names of the parameters; the left side is the value with the cause
    part: Part
    kind: Kind = "effect"
    stage: Stage = "sensor"
    scope: Scope = "board"
    parameters: tuple[TermParameter, ...]
    confused_with: tuple[str, ...] = ()  # causes that look similar, the most similar first
    remedy: str  # what to do at the rig
    file_remedy: str = ""  # in place of `remedy` for data that somebody else recorded
    covariates: tuple[str, ...] | None  # for the specification test; None: no predictor known
    picture: BinnedDependence | None  # None: the residual over time, around the event
    excitation: str  # what a recording needs to show the cause and to separate it
    effect_if_ignored: str  # on a calibration whose model lacks this cause

    needs_angles: bool = False  # the reference must give the pose at each time
    depends_on_upstream: bool = False  # its effect changes with small changes before it
    ignores_clipping: bool = False  # its derivatives ignore the clipping of the rate
    derivative_step: float = DERIVATIVE_STEP  # larger if the effect changes in steps
    # Special cases of the search.
    is_always_present: bool = False  # only its size is unknown: it is tried before all others
    template_search: TemplateSearch = "grid"
    holds_shapes: bool = False  # a fit is not smooth in the shapes: they are found like an event
    occurrence: int = 1  # the number of an event among those of one kind in a recording
    equivalent_causes: tuple[str, ...] = ()  # the same function on one of its axes
    first_order_equivalent: str = ""  # the cause that replaces it in the first scan
    scale_follows_temperature: bool = False  # its size is a change of the scale factor per kelvin
    # its size changes the scale factor with this power of the rate; None: with no power
    scale_rate_power: int | None = None
    confounded_with_gain: bool = False  # the gain absorbs it, so its size can stay unobservable
    is_whole_steps: bool = False  # its size is at least one step
    nameless_description: str = ""  # if given, it is reported as unexplained, not as a cause
    is_noise_process: bool = False  # the noise model contains it
    similar_in_draws: str = ""  # of a random cause: effects that scatter like its draws
    unseen_places: tuple[str, ...] = ()  # no motion shows it there: the gain absorbs it
    is_persistent: bool = False  # a property of the unit: its sizes are kept for later recordings
    depends_on_temperature: bool = False  # its temperature is relative to the recordings' mean
    starts_at_typical_size: bool = False  # because the derivative is zero at size zero
    law_quantity: LawQuantity | None = None  # of the motion law; its values are pan and tilt
    attitude_form: "Term | None" = None  # replaces it with a reference of attitudes
    form_without_bandwidth: "Term | None" = None  # replaces it if no low-pass is recorded
    reference_alternative: str = ""  # the same error in a reference of attitudes
    is_configuration_error: bool = False  # every rate is wrong with it: it is listed first
    implied_by: str = ""  # a cause that, with a positive size, already explains this one
    unknown_site_remark: str = ""  # for a known cause: why it was not removed, with the remedy
    polynomial_orders: range = range(0)  # of a polynomial whose order the data select

    @abstractmethod
    def effect(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the exact change of the measured rate, (blocks, 3), at values (k,)."""

    @abstractmethod
    def describe(self, values: FloatArray) -> str:
        """Return a sentence that explains these values to the person at the rig."""

    def remedy_for(self, link: str) -> str:
        """Return what to do, by the link of the board (see `LinkRemedy`)."""
        return LinkRemedy(self.remedy, self.file_remedy).for_link(link)

    def propagate(self, state: SignalState, values: FloatArray) -> SignalState:
        """Return the signal that later stages see, with this cause applied."""
        if self.stage in ("axes", "mount"):
            return state.with_rate(self.effect(state.at_stage(), values))
        if self.stage in ("sensor", "threshold", "bias"):
            return state.with_sensor(self.effect(state.at_sensor(), values))
        if self.stage == "limit":
            return state.with_output(self.effect(state.at_output(), values))
        if self.stage == "readout":
            return state
        raise NotImplementedError(f"{self.cause} does not define what stage {self.stage} changes")

    @property
    def is_of_unit(self) -> bool:
        """Whether only a pan-tilt unit can have this cause."""
        return self.part == "ptu"

    @property
    def is_event(self) -> bool:
        """Whether it happens at a time that is a value of its fit; it can happen again."""
        roles = {parameter.role for parameter in self.parameters}
        return "event" in roles and "shape" not in roles

    @property
    def is_brief(self) -> bool:
        """Whether it acts for milliseconds only: after edges of moves, as pulses or as a line."""
        return self.needs_moves or self.template_search in ("pulses", "spectral_lines")

    @property
    def needs_moves(self) -> bool:
        """Whether it acts after edges of moves only, so that a rest has no effect of it."""
        is_at_edges = any(name in BRIEF_COVARIATES for name in self.covariates or ())
        return is_at_edges and self.template_search not in ("pulses", "spectral_lines")

    def missing_data(self, state: SignalState) -> str | None:
        """Return what a recording lacks to compute the effect, with the remedy; None if nothing."""
        return NO_ANGLES if self.needs_angles and state.lacks_angles else None

    def missing_excitation(self, state: SignalState) -> str | None:
        """Return why bias and gain absorb the effect, with the remedy; None if they do not.

        The effect is known, but does not change in this recording. Another one can show it.
        """
        return NO_ANGLES if self.needs_angles and not state.has_angles else None

    def time_offset_ambiguity_s(self, values: FloatArray, duration_s: float) -> float:
        """Return the possible difference of a later recording's time offset from the fitted one.

        Args:
            values: of the cause, (k,).
            duration_s: of the recording.
        """
        return 0.0

    def is_known_at(self, site: Site) -> bool:
        """Return whether the size of a cause of the kind `known` follows from the site."""
        return False

    def with_order(self, order: int) -> "Term":
        """Return this cause as a polynomial of an order in `polynomial_orders`."""
        raise NotImplementedError(f"{self.cause} is not a polynomial")

    def pulse_templates(self, state: SignalState) -> PulseTemplates:
        """Return the signal of every time, for the template search `pulses`."""
        raise NotImplementedError(f"{self.cause} has no pulses")

    def lag_shape(self, time_s: FloatArray, values: FloatArray) -> FloatArray:
        """Return the delay per unit of size at some times (n,), for the search `lag_series`."""
        raise NotImplementedError(f"{self.cause} has no lag by time")

    def data_sheet_limit(self, parameter: str, profile: SensorProfile) -> float | None:
        """Return the data sheet's limit of a parameter's size, in the displayed unit.

        Args:
            parameter: the name without the cause; "" for the only one.
            profile: of the sensor.
        """
        return None

    def tilt_zero_std_rad(self, values: FloatArray) -> float:
        """Return the standard deviation of the tilt zero that this cause makes uncertain."""
        return 0.0

    def noise_bandwidth_hz(self, values: FloatArray, bandwidth_hz: float | None) -> float | None:
        """Return the true cut-off frequency of the noise, in Hz; None without a low-pass.

        Args:
            values: of the cause, (k,).
            bandwidth_hz: without this cause; None without a low-pass.
        """
        return bandwidth_hz

    def off_grid_effect(self, state: SignalState, values: FloatArray) -> FloatArray | None:
        """Return the part of the effect that the sample grid cannot represent, (blocks, 3).

        The result is None if there is no such part. `propagate` does not pass this part on.
        """
        return None

    def timing_sensitive_mask(self, state: SignalState, values: FloatArray) -> BoolArray | None:
        """Return the blocks whose effect changes within 0.1 ms, (blocks,); None if none.

        The fit leaves these blocks out.
        """
        return None

    def jacobian(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the derivatives by the values, (k, blocks, 3), by central differences."""
        jacobian = zero_signals(values.size, state.block_count)
        for k in range(values.size):
            jacobian[k] = self._finite_difference(state, values, k)
        return jacobian

    def local_jacobian(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the derivatives at exactly these values, not over a finite step."""
        return self.jacobian(state, values)

    def incremental_gain(self, state: SignalState, values: FloatArray) -> FloatArray | None:
        """Return d(output)/d(rate), (n, 3); None is the identity."""
        return None

    def template_bank(self, state: SignalState) -> FloatArray:
        """Return the values (b, k) at which a search starts: shapes, events, finite sizes."""
        return start_values(self)[None, :]

    def tangent_signals(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the signals of a search at one row of the bank, (sizes, blocks, 3).

        A derivative at size zero, or at a distant size, matches little of a nonlinear effect: 16 %
        of the energy of a backlash when the size is wrong by a factor of four.
        """
        return self.jacobian(state, values)[self.size_indices]

    @property
    def size_indices(self) -> list[int]:
        """The indices of the values that are sizes."""
        return value_indices(self, role="size")

    def difference_values(self, values: FloatArray, k: int) -> tuple[FloatArray, FloatArray, float]:
        """Return two sets of values for a finite difference by one of them, and its width."""
        parameter = value_parameters(self)[k]
        step = np.zeros(values.size)
        step[k] = self.derivative_step * parameter.typical_size
        backward_step = step if values[k] - step[k] >= parameter.lower else 0.0 * step
        return values + step, values - backward_step, float(step[k] + backward_step[k])

    def _finite_difference(self, state: SignalState, values: FloatArray, k: int) -> FloatArray:
        upper, lower, width = self.difference_values(values, k)
        return np.asarray(self._effect_difference(state, upper, lower) / width, dtype=np.float64)

    def _effect_difference(
        self, state: SignalState, upper: FloatArray, lower: FloatArray
    ) -> FloatArray:
        """Return the effect at one set of values minus that at another, (blocks, 3)."""
        return self.effect(state, upper) - self.effect(state, lower)


def value_names(term: Term) -> tuple[str, ...]:
    """Return the name of each value of a term, shape (k,)."""
    return tuple(name for parameter in term.parameters for name in parameter.value_names)


def value_parameters(term: Term) -> tuple[TermParameter, ...]:
    """Return the parameter of each value of a term, shape (k,)."""
    return tuple(p for p in term.parameters for _ in range(p.value_count))


def start_values(term: Term) -> FloatArray:
    """Return the initial values of a fit, shape (k,): no effect."""
    return np.array([p.start for p in value_parameters(term)], dtype=np.float64)


def components_of(term: Term) -> tuple[str, ...]:
    """Return the components that can act alone (x, y, z or pan, tilt), or ()."""
    components: dict[str, None] = {}
    for parameter in term.parameters:
        if parameter.role == "size":
            components.update(dict.fromkeys(parameter.components))
    return tuple(components)


def value_indices(term: Term, component: str | None = None, role: Role | None = None) -> list[int]:
    """Return the indices of the values of a component and a role; by default of all.

    A value without a component belongs to every component.
    """
    positions, position = [], 0
    for parameter in term.parameters:
        for own_component in parameter.components or ("",):
            matches = component is None or own_component in ("", component)
            if matches and (role is None or parameter.role == role):
                positions.append(position)
            position += 1
    return positions
