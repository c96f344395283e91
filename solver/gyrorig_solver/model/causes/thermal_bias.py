"""Bias temperature sensitivity: the bias is a polynomial of the temperature.

b(T) = sum over p of k_p (T - T0)^p, p = 1 to the order, T0 the mean of the recordings. The die and
the thermometer are at different places. With lag > 0 the thermometer is late, T_die = T + lag
dT/dt; with lag < 0 the die is late, T_die' = (T - T_die)/|lag|. To first order both are T + lag
dT/dt. Data sheets: 0.03 dps/K (L3G4200D, from memory of its front page), 0.24 dps/K (MPU-6500),
0.005 (ICM-42688-P); +-20 dps over 125 K (MPU-6050) is 0.16 dps/K. Lags between sensor and die are
10 to 60 s; without a lag in the model, the search would name a lagged bias a warm-up.
"""

import numpy as np

from gyrorig_protocol.profile import SensorProfile
from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.signal_arrays import on_all_axes, split_axes
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import BinnedDependence, shape_parameter, size_parameter
from gyrorig_solver.model.term_kinds import LinearTerm, scan_grid
from gyrorig_solver.model.value_format import DEG, XYZ, format_list

SPAN_K = 10.0  # over which a polynomial is described; typical sizes refer to its end
MIN_TEMPERATURE_SPAN_K = 0.5  # thermometers report 0.1 to 1 K
_TYPICAL_DPS_K = 0.03
_MAX_DPS_K = 0.5
MAX_LAG_S = 120.0
ORDER_NAMES = ("slope", "square", "cube")


class ThermalBias(LinearTerm):
    """The coefficients of each order for x, y, z, then the lag."""

    cause = "thermal_bias"
    title = "Temperature changes the bias"
    equation = "y_i = y_i + sum of slope_i,p (T - T0)^p, T = temperature + lag x d temperature/dt"
    part = "sensor"
    stage = "bias"
    confused_with = ("warm_up", "bias_ramp", "bias_step", "bias_random_walk")
    remedy = (
        "let the board warm up before recording and keep draughts away, or let `gyrorig solve` "
        "fit this cause, which needs the temperature of the board"
    )
    file_remedy = (
        "leave out the data before the board was warm, or let `gyrorig solve` fit this cause, "
        "which needs the temperature of the board"
    )
    covariates = ("bias_time",)
    picture = BinnedDependence("mean", "temperature")
    depends_on_temperature = True
    polynomial_orders = range(1, len(ORDER_NAMES) + 1)
    excitation = "heating, cooling and heating again, with rests between moves"
    effect_if_ignored = "the stated bias is valid at the temperature of the recording only"

    def __init__(self, order: int = 1) -> None:
        """Create a polynomial of order 1 to 3."""
        if not 1 <= order <= len(ORDER_NAMES):
            raise ValueError(f"order {order} is not 1 to {len(ORDER_NAMES)}")
        self.order = order
        sizes = []
        for power, name in enumerate(ORDER_NAMES[:order], start=1):
            # A typical curvature is a tenth of the slope at the end of the span.
            scale = DEG * SPAN_K ** (1 - power) * 0.1 ** min(power - 1, 1)
            sizes.append(
                size_parameter(
                    name,
                    "rad/s/K" + (f"^{power}" if power > 1 else ""),
                    XYZ,
                    typical=_TYPICAL_DPS_K,
                    limit=_MAX_DPS_K,
                    prior_std=_MAX_DPS_K,
                    factor=scale,
                )
            )
        lag = shape_parameter(
            "lag", "s", typical=20.0, lower=-MAX_LAG_S, upper=MAX_LAG_S, prior_std=30.0
        )
        self.parameters = (*sizes, lag)

    def basis_signals(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the powers of the die's temperature on each axis, (3 order, blocks, 3)."""
        rise_k = die_temperature_rise(state, float(values[-1]))
        powers = np.stack([rise_k ** (p + 1) for p in range(self.order)])
        measured = state.measure_sensor_rate(on_all_axes(powers))
        return split_axes(measured)

    def missing_data(self, state: SignalState) -> str | None:
        """Return that the recording has no temperature, or None."""
        return missing_temperature(state)

    def missing_excitation(self, state: SignalState) -> str | None:
        """Return that the temperature hardly changes, or None."""
        return missing_warming(state)

    def with_order(self, order: int) -> "ThermalBias":
        """Return the cause with a polynomial of this order."""
        return ThermalBias(order)

    def data_sheet_limit(self, parameter: str, profile: SensorProfile) -> float | None:
        """Return the drift of the zero-rate output, deg/s/K."""
        return profile.zero_rate_per_kelvin_dps if parameter in ("", "slope") else None

    def template_bank(self, state: SignalState) -> FloatArray:
        """Scan the lag."""
        return scan_grid(self, lag=np.array([-60.0, -30.0, -15.0, 0.0, 15.0, 30.0, 60.0]))

    def describe(self, values: FloatArray) -> str:
        slopes = format_list(values[:3] / DEG, XYZ, "deg/s per kelvin")
        lag_text = f", with a thermometer lag of {values[-1]:.0f} s" if values[-1] else ""
        return f"the bias depends on the temperature: {slopes}{lag_text}"


def die_temperature_rise(state: SignalState, lag_s: float) -> FloatArray:
    """Return the die's temperature minus the mean, shape (n,); zeros without a thermometer."""
    temperature = state.context.temperature
    return (
        np.zeros(state.interval_count)
        if temperature is None
        else temperature.die_temperature_rise(state.time_s, lag_s)
    )


def missing_temperature(state: SignalState) -> str | None:
    """Return that the recording has no temperature, or None if it has."""
    if state.context.temperature is None:
        return "the recording has no temperature; record the temperature of the board"
    return None


def missing_warming(state: SignalState) -> str | None:
    """Return that the temperature hardly changes, or None if it does."""
    temperature = state.context.temperature
    span = 0.0 if temperature is None else temperature.span_k
    if span < MIN_TEMPERATURE_SPAN_K:
        return f"the temperature changed by only {span:.1f} K; warm the board by at least 10 K"
    return None


TERM = ThermalBias()
