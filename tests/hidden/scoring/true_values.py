"""Convert the parameters of the truth to those of the solver, for the test of the intervals.

Both sides defined names, units and signs independently; only this module knows both. Phases
and events are not compared, only sizes.
"""

import math
from collections.abc import Callable, Iterator, Mapping

# Name in the truth, name in the solver, and the conversion.
Rule = tuple[str, str, Callable[[float], float]]


def _same(value: float) -> float:
    return value


def _minus(value: float) -> float:
    return -value


def _log_of_change(value: float) -> float:
    return math.log1p(value)


RULES: Mapping[str, tuple[Rule, ...]] = {
    "acceleration_error": (("relative_error", "share", _same),),
    "axis_nonorthogonality": (("angle", "angle", _minus),),
    "backlash": (("gap", "gap", _same),),
    "base_compliance": (("compliance", "coefficient", _same),),
    "bias_ramp": (("slope", "slope", _same),),
    "bias_step": (("step", "step", _same),),
    "board_slip": (("turn", "turn", _minus),),
    "clock_skew": (("lag_growth", "rate", _same),),
    "dead_zone": (("width", "threshold", _same),),
    "low_pass_lag": (("cutoff_change", "log_cutoff", _log_of_change),),
    "motor_coupling": (("bias", "pan", _same), ("bias", "tilt", _same)),
    "ringing": (("share", "share", _same),),
    "scale_asymmetry": (("share", "share", _same),),
    "scale_cubic": (("coefficient", "coefficient", _same),),
    "scale_quadratic": (("coefficient", "coefficient", _same),),
    "step_resolution": (("relative_error", "share", _same),),
    "thermal_bias": (("slope", "slope", _same),),
    "thermal_scale": (("share_per_k", "slope", _same),),
    "s_curve": (("window", "length", _same),),
    "vibration_rectification": (("coefficient", "coefficient", _same),),
}
# A sin(angle + phase), split into the amplitudes of sine and cosine of the angle.
HARMONICS: Mapping[str, tuple[str, str]] = {
    "worm_error": ("amplitude", "phase"),
    "tilt_sag": ("amplitude", "phase"),
    "eccentricity": ("first", "first_phase"),
}


def convert_true_values(
    cause: str, place: str | None, parameters: Mapping[str, float]
) -> Iterator[tuple[str, float]]:
    """Yield the solver's name and the true value of each size that can be compared.

    Args:
        cause: from the catalogue.
        place: in the notation of the truth: pan, tilt, axes of the sensor, or all.
        parameters: of the truth, values per axis as name.x and so on.
    """
    if cause == "g_sensitivity":
        yield from ((f"sensitivity.{name}", value) for name, value in parameters.items())
        return
    at = [part.strip() for part in (place or "").split(",")]
    if cause in HARMONICS and HARMONICS[cause][0] in parameters:
        amplitude, phase = (parameters[name] for name in HARMONICS[cause])
        for part in at:
            yield f"cosine.{part}", amplitude * math.sin(phase)
            yield f"sine.{part}", amplitude * math.cos(phase)
        return
    for given_name, name, convert in RULES.get(cause, ()):
        for parameter, value in parameters.items():
            stem, _, axis = parameter.partition(".")
            if stem != given_name:
                continue
            if axis:
                yield f"{name}.{axis}", convert(value)
            else:
                yield name, convert(value)
                yield from ((f"{name}.{part}", convert(value)) for part in at if part)
