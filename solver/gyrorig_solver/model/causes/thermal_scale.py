"""Scale-factor temperature sensitivity: the scale factor depends on the temperature.

y_i += k_i (T - T0) (G omega)_i with T0 the mean of the recordings. Data sheets: +-2 % over 125 K
(L3G4200D, MPU-6050), 0.016 %/K; 0.005 to 0.03 %/K for others.
"""

from gyrorig_protocol.profile import SensorProfile
from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.causes.thermal_bias import (
    die_temperature_rise,
    missing_temperature,
    missing_warming,
)
from gyrorig_solver.model.signal_arrays import split_axes
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import BinnedDependence, size_parameter
from gyrorig_solver.model.term_kinds import LinearTerm
from gyrorig_solver.model.value_format import XYZ, format_list


class ThermalScale(LinearTerm):
    """The slope k for x, y, z."""

    cause = "thermal_scale"
    title = "Temperature changes the scale factor"
    equation = "y_i = y_i + slope_i (T - T0) (G omega)_i"
    part = "sensor"
    parameters = (size_parameter("slope", "1/K", XYZ, typical=1.6e-4, limit=2e-3, prior_std=1e-3),)
    confused_with = ("board_slip", "thermal_bias", "clock_skew")
    remedy = "record at the temperature of use, or let `gyrorig solve` fit this cause"
    covariates = ("time",)
    picture = BinnedDependence("gain", "temperature", 10)
    depends_on_temperature = True
    scale_follows_temperature = True
    excitation = "the same fast moves at temperatures 20 K apart"
    effect_if_ignored = "the scale factor is valid at the temperature of the recording only"

    def basis_signals(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the rate of each axis times the temperature, (3, blocks, 3)."""
        return split_axes(
            state.measure_sensor_rate(
                die_temperature_rise(state, 0.0)[:, None] * state.sensor_rate_rad_s
            )
        )

    def missing_data(self, state: SignalState) -> str | None:
        """Return that the recording has no temperature, or None."""
        return missing_temperature(state)

    def missing_excitation(self, state: SignalState) -> str | None:
        """Return that the temperature hardly changes, or None."""
        return missing_warming(state)

    def data_sheet_limit(self, parameter: str, profile: SensorProfile) -> float | None:
        """Return the drift of the sensitivity, ppm/K."""
        drift = profile.scale_per_kelvin
        return None if parameter or drift is None else drift * 1e6

    def describe(self, values: FloatArray) -> str:
        text = format_list(values * 100.0, XYZ, "% per kelvin")
        return f"the scale factor depends on the temperature: {text}"


TERM = ThermalScale()
