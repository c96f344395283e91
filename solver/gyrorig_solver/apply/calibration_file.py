"""Reading a calibration file for use: parsed, and with every parameter known.

What to use when: `read_calibration` before a calibration is applied, exported or shown.
It needs numpy and nothing of the extra `solver`.
"""

import hashlib
from importlib.resources import files
from pathlib import Path

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.suggestions import did_you_mean
from gyrorig_solver.calibration import CalibrationDocument, cause_of_parameter, parse_calibration
from gyrorig_solver.calibration.document_checks import check_values

BASE_PARAMETERS = ("bias", "scale", "nonorthogonality", "misalignment", "time_offset")
# Terms of a fit to attitudes without a file among the causes: `discover.attitude.attitude_terms`.
# A correction does not apply them, for these reasons.
ATTITUDE_TERMS = {
    "reference_smoothing": "it describes the reference attitudes",
    "moving_bias": "the solver knows no cause for this change of the bias in motion",
}
# The causes that a correction applies, with their parameters.
APPLIED_PARAMETERS = {
    "scale_quadratic": ("scale_quadratic",),
    "scale_cubic": ("scale_cubic",),
    "scale_asymmetry": ("scale_asymmetry",),
    "g_sensitivity": ("g_sensitivity",),
    "thermal_scale": ("thermal_scale", "thermal_scale.reference"),
    "thermal_bias": (
        "thermal_bias",
        "thermal_bias.slope",
        "thermal_bias.square",
        "thermal_bias.cube",
        "thermal_bias.lag",
        "thermal_bias.reference",
    ),
}


def read_calibration(path: Path) -> tuple[CalibrationDocument, str]:
    """Return the calibration in a file, and `sha256:` with the digest of the file.

    Raises:
        InputError: the file cannot be read, is not a calibration, or has a parameter that
            this version does not know.
    """
    text = read_document(path)
    document = parse_calibration(text, str(path))
    check_parameters(document, str(path))
    return document, "sha256:" + hashlib.sha256(text).hexdigest()


def read_document(path: Path) -> bytes:
    """Return the bytes of a document.

    Raises:
        InputError: the file cannot be read.
    """
    try:
        return path.read_bytes()
    except OSError as fault:
        raise InputError(
            f"the calibration {path} cannot be read ({fault.strerror})",
            "give the path of a calibration, for example GY80-1/v0001.yaml",
        ) from fault


def check_parameters(document: CalibrationDocument, name: str) -> None:
    """Check a calibration's values, and its names against the catalogue of causes.

    Raises:
        InputError: a name is not known, a base parameter is missing, or a value is not that of a
            gyroscope.
    """
    # One file per cause. The files are not imported: they need scipy.
    folder = files("gyrorig_solver") / "model" / "causes"
    cause_ids = {file.name.removesuffix(".py") for file in folder.iterdir()}
    cause_ids |= set(ATTITUDE_TERMS)
    for parameter in document.parameters:
        cause = cause_of_parameter(parameter)
        known = (*BASE_PARAMETERS, *sorted(cause_ids))
        if cause in cause_ids:  # the parameters of other causes are not applied
            known = APPLIED_PARAMETERS.get(cause, (parameter,))
        if parameter not in known:
            suggestion = did_you_mean(parameter, known, 1)
            raise InputError(
                f"the calibration {name} contains the unknown parameter {parameter[:60]!r}",
                suggestion
                or (
                    "correct the name of the parameter, or use the version of gyrorig that "
                    "wrote the file"
                ),
            )
    missing = [entry for entry in BASE_PARAMETERS if entry not in document.parameters]
    if missing:
        raise InputError(
            f"the calibration {name} lacks the parameter {missing[0]!r}",
            "solve the recording again",
        )
    check_values(document, name)
