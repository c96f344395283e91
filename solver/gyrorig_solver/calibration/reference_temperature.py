"""The temperature to which the bias of a calibration belongs.

What to use when: `bias_temperature_degc`, to compare the biases of several calibrations.
"""

from gyrorig_solver.calibration.calibration_document import CalibrationDocument, Parameter
from gyrorig_solver.model.catalogue import catalogue


def bias_temperature_degc(calibration: CalibrationDocument) -> float | None:
    """Return the temperature of the stated bias, in degC; None if the calibration has none.

    With a curve, or with a cause of a bias that depends on the temperature, it is the reference
    temperature. Otherwise it is the mean of the last recording, absolute or not.
    """
    if calibration.temperature is not None:
        return calibration.temperature.reference_degc
    for term in catalogue().values():
        reference = calibration.parameters.get(f"{term.cause}.reference")
        if term.depends_on_temperature and term.stage == "bias" and reference is not None:
            reference_degc = _first_value(reference)
            if reference_degc is not None:
                return reference_degc
    return calibration.quality.mean_temperature_degc


def _first_value(parameter: Parameter) -> float | None:
    value = parameter.value
    return next(iter(value), None) if isinstance(value, list) else value
