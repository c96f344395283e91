"""The bias as a function of the temperature, from rests and from tables.

What to use when: `BiasSeries` and `BiasTable` for the data, `fit_temperature` for the curve, and
`measure_bias_change` for the change of the bias, with or without a thermometer.
"""

from gyrorig_solver.estimate.temperature.bias_change import BiasChange, measure_bias_change
from gyrorig_solver.estimate.temperature.bias_series import BiasSeries, BiasTable
from gyrorig_solver.estimate.temperature.temperature_fit import (
    Hysteresis,
    TemperatureFit,
    fit_temperature,
)

__all__ = [
    "BiasChange",
    "BiasSeries",
    "BiasTable",
    "Hysteresis",
    "TemperatureFit",
    "fit_temperature",
    "measure_bias_change",
]
