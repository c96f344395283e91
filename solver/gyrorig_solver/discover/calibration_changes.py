"""Changes of the calibration parameters by causes.

What to use when: `CalibrationValues.of` at a fit; `changes_from` between two fits, `propagate`
for the first-order change by an unknown effect.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.discover.cause_findings import CalibrationChange
from gyrorig_solver.estimate import (
    GAIN_PARAMETERS,
    SESSION_PARAMETERS,
    ConvergedFit,
    ParameterLayout,
    propagate_to_factors,
)
from gyrorig_solver.estimate.observability import BIAS_NAMES
from gyrorig_solver.model import FACTOR_NAMES

CALIBRATION_PARAMETERS = (*FACTOR_NAMES, *BIAS_NAMES, "time_offset")
CALIBRATION_UNITS = ("1",) * 6 + ("rad",) * 3 + ("rad/s",) * 3 + ("s",)


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationValues:
    """A fit's values and standard uncertainties over `CALIBRATION_PARAMETERS`."""

    values: FloatArray  # (13,)
    std: FloatArray  # (13,), NaN if the data do not determine a value
    jacobian: FloatArray  # (13, 13), derivatives by the stated parameters of the fit
    stated: IntArray  # (13,), their indices among G and (b, tau) of each recording

    @classmethod
    def of(cls, solution: ConvergedFit) -> Self:
        """Return the calibration of a fit: the last bias, and the last time offset it shows."""
        layout = ParameterLayout.of([()], len(solution.sessions))
        first_recording = slice(0, GAIN_PARAMETERS + SESSION_PARAMETERS)
        derived = propagate_to_factors(
            solution.estimate[first_recording],
            solution.observability.covariance[first_recording, first_recording],
            solution.observability.unobservable_covariance[first_recording, first_recording],
        )
        std = np.where(
            derived.is_observable(solution.prior_std[first_recording]),
            np.sqrt(np.clip(np.diag(derived.data), 0.0, None)),
            np.nan,
        )
        stated = layout.index(
            len(solution.sessions) - 1, offset_recording=solution.offset_recording
        )
        return cls(derived.values, std, derived.jacobian, stated)

    def propagate(self, parameter_shift: FloatArray) -> FloatArray:
        """Return the first-order change of each parameter, (13,).

        Args:
            parameter_shift: the change of G and (b, tau) of each recording, (board,).
        """
        return np.asarray(self.jacobian @ parameter_shift[self.stated], dtype=np.float64)

    def changes_from(self, before: FloatArray) -> tuple[CalibrationChange, ...]:
        """Return the change of each observable parameter from `before`, (13,), largest first."""
        known_changes = [
            CalibrationChange(name, float(old), float(new), float(std), unit)
            for name, old, new, std, unit in zip(
                CALIBRATION_PARAMETERS,
                before,
                self.values,
                self.std,
                CALIBRATION_UNITS,
                strict=True,
            )
            if np.isfinite(std)
        ]
        return tuple(sorted(known_changes, key=lambda change: -change.sigma))
