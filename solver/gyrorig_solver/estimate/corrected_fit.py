"""A fit's result with corrected parameters.

What to use when: `correct_fit` if there is a posterior of the unit from earlier recordings.
Residuals, noise and diagnostics stay those of the fit.
"""

from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate.converged_fit import ConvergedFit
from gyrorig_solver.estimate.derived_parameters import DerivedParameters, derive_parameters
from gyrorig_solver.estimate.fit_summary import fitted_parameters
from gyrorig_solver.estimate.gyro_fit import GyroFit, RecordingFit


@dataclass(frozen=True, slots=True, eq=False)
class FitCorrection:
    """The change of a fit's parameters for one recording: G, b, time offset, causes."""

    shift: FloatArray  # (q,)
    covariance: FloatArray  # (q, q), of the corrected parameters, from noise


def correct_fit(
    fit: GyroFit, solution: ConvergedFit, corrections: tuple[FitCorrection, ...]
) -> GyroFit:
    """Return a fit with corrected parameters; parameters that were null stay null.

    Args:
        fit: the summary of the solution.
        solution: the converged fit.
        corrections: of each recording; the last one belongs to the stated values.
    """
    last = corrections[-1]
    derived = derive_parameters(
        solution.estimate + last.shift,
        solution.names,
        replace(solution.observability, covariance=last.covariance),
        {},
        solution.prior_std,
    )
    known = [derived.order.index(name) for name in fit.order if name in derived.order]
    gain = np.where(np.isfinite(fit.gain), derived.gain, np.nan)
    return replace(
        fit,
        gain=gain,
        gain_std=np.where(np.isfinite(gain), derived.gain_std, np.nan),
        bias_rad_s=_keep_null(fit.bias_rad_s, derived, "bias"),
        scale=_keep_null(fit.scale, derived, "scale"),
        nonorthogonality=_keep_null(fit.nonorthogonality, derived, "nonorthogonality"),
        misalignment_rad=_keep_null(fit.misalignment_rad, derived, "misalignment"),
        time_offset_s=derived.values["time_offset"]
        if np.isfinite(fit.time_offset_s)
        else fit.time_offset_s,
        std={name: derived.std[name] if name in fit.order else np.nan for name in fit.std},
        order=tuple(derived.order[k] for k in known),
        covariance=derived.covariance[np.ix_(known, known)],
        causes=(
            *(
                parameter
                for fitted_term in solution.fitted_terms
                for parameter in fitted_parameters(fitted_term, derived)
            ),
            *(parameter for parameter in fit.causes if parameter.name.endswith(".reference")),
        ),
        recordings=tuple(
            _correct_recording(recording, correction)
            for recording, correction in zip(fit.recordings, corrections, strict=False)
        ),
    )


def _keep_null(before: FloatArray, derived: DerivedParameters, group: str) -> FloatArray:
    return np.where(np.isfinite(before), derived.values_of_group(group), np.nan)


def _correct_recording(recording: RecordingFit, correction: FitCorrection) -> RecordingFit:
    std = np.sqrt(np.diag(correction.covariance)[9:13])
    is_offset_known = np.isfinite(recording.time_offset_s)
    return RecordingFit(
        bias_rad_s=recording.bias_rad_s + correction.shift[9:12],
        bias_std_rad_s=std[:3],
        time_offset_s=recording.time_offset_s + float(correction.shift[12]),
        time_offset_std_s=float(std[3]) if is_offset_known else float("nan"),
    )
