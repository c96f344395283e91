"""Measured data of a recording: samples, clocks and checks of the raw stream.

It exports the array types and `TemperatureCurve`. Import the rest from its module: code that
applies a calibration needs only numpy, and `samples` loads scipy and the MCAP reader.

What to use when: `samples.load_samples` for the gyro samples of one board on the capture clock.
`clocks` maps device time to capture time, `stream` checks the counts without a model,
`count_columns` keeps long columns as counts, and `arrays` has the array types.
"""

from gyrorig_solver.data.arrays import BoolArray, FloatArray, IntArray, RealArray
from gyrorig_solver.data.temperature_curve import TemperatureCurve

__all__ = [
    "BoolArray",
    "FloatArray",
    "IntArray",
    "RealArray",
    "TemperatureCurve",
]
