"""Names and sentences that describe a calibration to people.

What to use when: `verdict_sentence` and `next_step` for the verdict; `determined_text` for how
many parameters have a value; `value_std_pairs` for a parameter's values with their standard
uncertainties; `cause_groups` for parameters beyond the base model.
"""

import math
from collections.abc import Sequence

from gyrorig_solver.calibration.calibration_document import (
    CalibrationDocument,
    LevelRecord,
    Parameter,
)
from gyrorig_solver.calibration.document_checks import cause_of_parameter
from gyrorig_solver.calibration.temperature_record import CurveRecord, TemperatureRecord
from gyrorig_solver.model import (
    PARAMETER_GROUPS,
    ParameterGroup,
    cause_display_unit,
    format_quantity,
    format_short,
    plural,
)
from gyrorig_solver.model.catalogue import catalogue

VERDICT_TITLES = {"good": "Good", "limited": "Limited", "refused": "Refused"}
REDUCED_CHI2_LIMIT = 1.25  # above it a fit to a motion is limited, see `estimate.motion_fit`

# The next step, for a terminal; the report has a section for it. It is the same for a file, whose
# reader may have no board: the lines marked ! name a new recording where there can be one.
_NEXT_STEPS = {
    "good": "use it with `gyrorig apply` or `gyrorig export`, and read the report.",
    "limited": "follow the lines marked !, and solve this recording together with another one.",
    "refused": "follow the lines marked !, and solve again.",
}


def verdict_sentence(calibration: CalibrationDocument) -> str:
    """Return what the verdict means, with the numbers that were tested."""
    verdict, observability = calibration.trust.verdict, calibration.observability
    if verdict == "refused" and calibration.solver.method == "paper":
        return "Do not use this calibration. It is the result of the paper's method as printed."
    if verdict == "refused":
        return "Do not use this calibration. Fix the problems below and solve again."
    if verdict == "limited" and observability.unobservable:
        return (
            "Some parameters could not be determined. The other values are valid; read the "
            "notes below."
        )
    determined = f"All {observability.of} parameters were determined."
    if verdict == "limited":
        return f"{determined} Read the notes below before you use the values."
    sentences = [determined]
    chi2 = calibration.quality.reduced_chi2
    if chi2 is not None:
        sentences.append(f"Reduced chi-square {format_short(chi2)}{_limit_text(calibration)}.")
    sentences.append(_exclusion_sentence(calibration))
    if calibration.uncertainty is not None:
        sentences.append("The total uncertainties are within their limits.")
    return " ".join(sentences)


def _limit_text(calibration: CalibrationDocument) -> str:
    # A fit to known turns has another limit, and no noise model.
    return f" (limit {REDUCED_CHI2_LIMIT:g})" if calibration.noise else " (expected 1)"


def _exclusion_sentence(calibration: CalibrationDocument) -> str:
    """Return what the fit alone does not exclude, or what a search for causes found."""
    findings = calibration.findings
    if findings is None:
        if calibration.quality.remaining_effects is not None:
            return "Tests of the residual found no further effect."
        subject = "Rig errors below this limit are" if calibration.noise else "Rig errors are"
        return f"{subject} not excluded; run `gyrorig explain`."
    fitted, in_gain, others = group_causes(calibration)
    sentences = []
    if fitted:
        sentences.append(f"The fit includes the causes that a search found: {_names(fitted)}.")
    if in_gain:
        sentences.append(f"The gain includes a cause that the findings name: {_names(in_gain)}.")
    if others:
        also = "also " if sentences else ""
        sentences.append(
            f"The findings {also}name {_names(others)}, which the fit does not include."
        )
    return " ".join(sentences) or "A search for further causes found none in the rates."


def group_causes(calibration: CalibrationDocument) -> tuple[list[str], list[str], list[str]]:
    """Return the causes that a search found, by what the calibration does about them.

    Returns:
        The terms of the fit; the causes that the gain includes, for example as a negative or a
        doubled scale factor; and the causes that no parameter includes.
    """
    causes = [] if calibration.findings is None else calibration.findings.distinct_causes
    fitted = [cause for cause in causes if cause in calibration.solver.terms]
    in_gain = [
        cause
        for cause in causes
        if cause in catalogue() and catalogue()[cause].is_configuration_error
    ]
    return fitted, in_gain, [cause for cause in causes if cause not in (*fitted, *in_gain)]


def _names(causes: Sequence[str]) -> str:
    return ", ".join(cause.replace("_", " ") for cause in causes)


def next_step(calibration: CalibrationDocument) -> str:
    """Return what to do with a calibration of this verdict."""
    if calibration.solver.method == "paper":
        return "solve again with `--method likelihood`."
    return _NEXT_STEPS[calibration.trust.verdict]


def determined_text(calibration: CalibrationDocument) -> str:
    """Return how many parameters the motion determined: "12 of 12, and the time offset"."""
    observability = calibration.observability
    offset = calibration.parameters.get("time_offset")
    has_offset = offset is not None and offset.value is not None
    return f"{observability.rank} of {observability.of}" + (
        ", and the time offset" if has_offset else ""
    )


def missing_value_text(calibration: CalibrationDocument) -> str:
    """Return the text shown instead of a value that is null."""
    if calibration.solver.method == "paper":
        return "not given by the paper's method"
    return "not observable from this motion"


def collapse_groups(names: Sequence[str]) -> list[str]:
    """Return parameter names, with the name of the group where all of its values are present."""
    collapsed_names = []
    for group in PARAMETER_GROUPS:
        group_names = [f"{group.name}.{label}" for label in group.labels if label] or [group.name]
        present = [name for name in group_names if name in names]
        collapsed_names += [group.name] if len(present) == len(group_names) else present
    return collapsed_names + [
        name for name in names if name.split(".")[0] not in {g.name for g in PARAMETER_GROUPS}
    ]


def cause_groups(calibration: CalibrationDocument) -> tuple[ParameterGroup, ...]:
    """Return the parameters of a document that are not in the base model."""
    base = {group.name for group in PARAMETER_GROUPS}
    return tuple(
        ParameterGroup(
            name,
            _entry_labels(name, len(value_std_pairs(p))),
            "beyond the base model",
            *_cause_unit(name, p.unit),
        )
        for name, p in calibration.parameters.items()
        if name not in base
    )


def _cause_unit(name: str, unit: str) -> tuple[float, str]:
    """Return factor and unit to show for `cause` or `cause.parameter`."""
    return cause_display_unit(cause_of_parameter(name), name.partition(".")[2], unit)


def _entry_labels(name: str, count: int) -> tuple[str, ...]:
    """Return the component labels of a cause's parameter: `cause` or `cause.parameter`."""
    cause, parameter_name = cause_of_parameter(name), name.partition(".")[2]
    parameters = catalogue()[cause].parameters if cause in catalogue() else ()
    for parameter in parameters:
        if parameter_name in ("", parameter.name) and len(parameter.components) == count:
            return parameter.components
    return {1: ("",), 3: ("x", "y", "z")}.get(count, tuple(str(i) for i in range(count)))


def shown_entries(
    parameter: Parameter, group: ParameterGroup
) -> list[tuple[str, float | None, float | None]]:
    """Return label, value and standard uncertainty of the entries to show, in the document's unit.

    A cause that was fitted on some of its axes has no standard uncertainty on the others. These are
    left out.
    """
    pairs = value_std_pairs(parameter)
    entries = [(label, *pair) for label, pair in zip(group.labels, pairs, strict=True)]
    fitted = [entry for entry in entries if entry[2] is not None]
    return entries if group in PARAMETER_GROUPS or not fitted else fitted


def value_std_pairs(parameter: Parameter) -> list[tuple[float | None, float | None]]:
    """Return (value, standard uncertainty) of each entry, in the document's unit."""
    value, std = parameter.value, parameter.std
    values = value if isinstance(value, list) else [value]
    std_values = std if isinstance(std, list) else [std] * len(values)  # None: none is known
    return list(zip(values, std_values, strict=True))


def white_noise_units(values: Sequence[float | None]) -> list[tuple[str, str, str]]:
    """Return the white noise of three axes as rows of name, values and unit.

    Args:
        values: one-sided densities, rad/s/sqrt(Hz); None where not estimated.

    A one-sided density n is an angle random walk N = n / sqrt(2), IEEE Std 952 annex C.
    """
    density_dps = [None if v is None else math.degrees(v) for v in values]
    walk = [None if v is None else 60.0 * v / math.sqrt(2.0) for v in density_dps]
    return [
        ("noise density", axes_text(density_dps), "deg/s/√Hz, one-sided"),
        ("angle random walk", axes_text(walk), "deg/√h"),
    ]


def axes_text(values: Sequence[float | None]) -> str:
    """Return the values of three axes, in one text."""
    return ", ".join("not estimated" if v is None else format_short(v) for v in values)


def level_sentence(level: LevelRecord) -> str:
    """Return the unit's leveling, as estimated from the board's accelerometer."""
    lean = zip(level.lean, level.lean_std, strict=True)
    tilt, right, forward = (
        " ± ".join(format_quantity(math.degrees(value), math.degrees(std)))
        for value, std in ((level.tilt_zero, level.tilt_zero_std), *lean)
    )
    return (
        f"The board's accelerometer in {level.rests} static intervals gives a tilt zero of {tilt} "
        "deg (minus the board's mounting angle about x, which it cannot separate) and a pan axis "
        f"that leans {right} deg to the right and {forward} deg forward."
    )


def temperature_sentences(record: TemperatureRecord) -> list[str]:
    """Return what a calibration says of bias and scale against the temperature."""
    low, high = record.range_degc
    sentences = []
    for quantity, curve in (("bias", record.bias), ("scale factor", record.scale)):
        if curve is not None:
            sentences.append(
                f"The {quantity} follows the temperature by a {_curve_kind(curve)}, valid from "
                f"{low:.1f} to {high:.1f} degC."
            )
    if record.lag_std_s is not None:
        place = "The die lags" if record.lag_s < 0.0 else "The thermometer lags"
        sentences.append(
            f"{place} by {abs(record.lag_s):.0f} ± {record.lag_std_s:.0f} s (standard uncertainty)."
        )
    hysteresis = record.hysteresis
    if hysteresis is not None and hysteresis.fitted:
        widths = [
            " ± ".join(format_quantity(math.degrees(width), math.degrees(std)))
            for width, std in zip(hysteresis.width, hysteresis.std, strict=True)
        ]
        sentences.append(
            f"Hysteresis: the bias while heating minus that while cooling is {', '.join(widths)} "
            "deg/s (x, y, z). The correction uses the middle."
        )
    elif hysteresis is not None:
        widest = math.degrees(max(abs(w) + 2.0 * s for w, s in
                                  zip(hysteresis.width, hysteresis.std, strict=True)))  # fmt: skip
        sentences.append(
            f"No hysteresis is significant; it is smaller than {format_short(widest)} deg/s."
        )
    elif record.bias is not None and record.lag_std_s is not None:
        sentences.append(
            "The data do not show a hysteresis, because no recording heats and cools the board."
        )
    if record.repeatability is not None:
        values = [math.degrees(value) for value in record.repeatability]
        sentences.append(
            f"From one measurement to the next, the bias changes by {axes_text(values)} deg/s "
            "(standard deviation)."
        )
    return sentences


def _curve_kind(curve: CurveRecord) -> str:
    if curve.kind == "spline":
        return f"cubic spline with {plural(len(curve.knots_degc), 'knot')}"
    return f"polynomial of order {len(curve.coefficients)}"
