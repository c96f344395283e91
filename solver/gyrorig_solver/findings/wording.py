"""How findings are named and written for a person.

Files keep SI units; degrees, milliseconds and percent stand only where people read.
"""

import math
from types import MappingProxyType

from gyrorig_solver.calibration.wording import quantity, short
from gyrorig_solver.findings.document import Cause, FindingsDocument, Size

VERDICTS = MappingProxyType(
    {
        "adequate": ("Nothing found", "The model of the rig leaves nothing but noise."),
        "explained": (
            "Explained",
            "The plain model is not the whole truth, and the causes below account for all that "
            "it leaves.",
        ),
        "unexplained": (
            "Not all explained",
            "Something is left that no known cause explains; it is shown below, and no name was "
            "given to fill the gap.",
        ),
    }
)
TITLES = MappingProxyType(
    {
        "clock_offset": "Samples tell of an earlier moment",
        "clock_skew": "The clocks run apart",
        "clock_step": "A clock jumped",
        "lost_samples": "Samples are missing",
        "repeated_samples": "Samples come twice",
        "sample_jitter": "Samples are taken at uneven times",
        "corrupt_samples": "Words are damaged",
        "axis_swap": "Axes have changed places",
        "sign_flip": "An axis counts the other way round",
        "wrong_full_scale": "The range is another than configured",
        "stuck_axis": "An axis is stuck",
        "board_restart": "The board started anew",
        "low_pass_lag": "The low-pass is another than configured",
        "scale_quadratic": "The scale grows with the rate",
        "scale_cubic": "The scale bends at high rates",
        "scale_asymmetry": "The two directions have different scales",
        "saturation": "The tops of the motion are cut off",
        "dead_zone": "Slow rotation is not felt",
        "g_sensitivity": "Gravity moves the bias",
        "vibration_rectification": "Vibration moves the bias",
        "thermal_bias": "Temperature moves the bias",
        "thermal_scale": "Temperature moves the scale",
        "warm_up": "The board was still warming up",
        "bias_ramp": "The bias drifts steadily",
        "bias_step": "The bias jumped",
        "bias_random_walk": "The bias wanders",
        "supply_hum": "The mains hum in the rates",
        "motor_coupling": "A running motor moves the bias",
        "backlash": "The gears have play",
        "lost_steps": "The motor lost steps",
        "eccentricity": "The gear wheel sits off its centre",
        "worm_error": "The worm turns unevenly",
        "axis_nonorthogonality": "Pan and tilt are not square",
        "tilt_zero": "The zero of tilt is off",
        "step_resolution": "A step is not as large as told",
        "acceleration_error": "The unit accelerates otherwise than told",
        "s_curve": "The controller rounds its ramps",
        "base_speed_jump": "The unit starts at another speed than told",
        "ringing": "The load swings",
        "tilt_sag": "The payload bends the tilt",
        "base_compliance": "The foot of the unit gives way",
        "board_slip": "The board slipped on its mount",
        "earth_rotation": "The Earth turns",
        "reference_smoothing": "The reference is smoothed",
    }
)
MANY = 8  # names in one line
_DEG = 180.0 / math.pi
_MDEG = 1e3 * _DEG


_BLIND = (
    "Nothing found, little could be looked at",
    "The reference is neither a unit's motion nor attitudes: only the samples themselves, and "
    "whether what is left depends on rates and time, were looked at.",
)


def verdict_words(document: FindingsDocument) -> tuple[str, str]:
    """Return the verdict's title and sentence."""
    if document.verdict == "adequate" and not document.minimal_detectable:
        return _BLIND
    return VERDICTS[document.verdict]


def title(cause: str) -> str:
    """Return a cause as a person says it."""
    return TITLES.get(cause, cause.replace("_", " ").capitalize())


def shown(value: float, unit: str) -> tuple[float, str]:
    """Return the factor from a document's unit to one that a person thinks in, and that."""
    if unit.startswith("rad"):
        rest = unit.removeprefix("rad").replace("^2", "²")
        factor = _DEG if abs(value) * _DEG >= 0.1 else _MDEG
        return factor, ("deg" if factor == _DEG else "mdeg") + rest
    if unit == "s":
        return (1.0, "s") if abs(value) >= 1.0 else (1e3, "ms")
    if unit == "1" and 0.0 < abs(value) < 0.5:
        return (100.0, "%") if abs(value) >= 1e-3 else (1e6, "ppm")
    return 1.0, "" if unit == "1" else unit.replace("^2", "²")


def size_text(size: Size) -> str:
    """Return a value with its deviation and unit."""
    if size.value is None:
        return "not known"
    factor, unit = shown(size.value, size.unit)
    if not size.std:
        return f"{short(size.value * factor)} {unit}".strip()
    value, std = quantity(size.value * factor, size.std * factor)
    return f"{value} ± {std} {unit}".strip()


def amount(value: float | None, unit: str) -> str:
    """Return a size without a deviation."""
    if value is None:
        return "any"
    factor, word = shown(value, unit)
    return f"{short(value * factor)} {word}".strip()


def place(where: str | None) -> str:
    """Return ", on tilt" for a place, "" for all of it."""
    return f", on {where}" if where and where != "all" else ""


def headline(cause: Cause) -> str:
    """Return one cause with its place."""
    return title(cause.cause) + place(cause.where)


def summary(document: FindingsDocument) -> str:
    """Return the verdict, the causes and what is left, one thing a line."""
    heading = verdict_words(document)[0].lower()
    lines = [f"{document.board.id} ({document.board.sensor or 'unknown sensor'}): {heading}"]
    for cause in document.causes:
        lines += _cause_lines(cause)
    if document.unexplained is not None:
        p_value = document.unexplained.p_value
        chance = "" if p_value is None else f", by chance once in {_once(p_value)}"
        lines.append(
            f"  ? unexplained: what is left depends {document.unexplained.best_covariate}{chance}"
        )
        if document.unexplained.harm:
            lines.append(f"    {document.unexplained.harm}")
    gain = document.gain
    if gain is not None and gain.held_out_log_likelihood is not None:
        lines.append(
            f"  on held-out data      {gain.held_out_log_likelihood:+.1f} nats; residual "
            f"{_dps(gain.residual_rms_before)} to {_dps(gain.residual_rms_after)} deg/s"
        )
    elsewhere = document.elsewhere
    if elsewhere is not None and elsewhere.held_out_log_likelihood is not None:
        lines.append(
            f"  on the recording held out {elsewhere.held_out_log_likelihood:+.1f} nats; residual "
            f"{_dps(elsewhere.residual_rms_before)} to {_dps(elsewhere.residual_rms_after)} deg/s"
        )
    worst = [d for d in document.minimal_detectable if d.by_sigma is not None][:3]
    for limit in worst:
        lines.append(
            f"  could be there unseen {limit.cause}{place(limit.where)} up to "
            f"{amount(limit.size, limit.unit)}: {limit.would_move} off by {limit.by_sigma:.1f} sd"
        )
    if document.not_testable:
        names = list(dict.fromkeys(n.cause for n in document.not_testable))
        more = f" and {len(names) - MANY} more" if len(names) > MANY + 1 else ""
        shown_names = names[:MANY] if more else names
        lines.append(f"  cannot be seen here   {', '.join(shown_names)}{more}")
    lines += [f"  remark: {text}" for text in document.remarks]
    return "\n".join(lines)


def _cause_lines(cause: Cause) -> list[str]:
    name = " or ".join([cause.cause, *cause.one_of])
    lines = [f"  ! {name}{place(cause.where)}: {cause.evidence.seen_as}"]
    sizes = ", ".join(f"{k} {size_text(v)}" for k, v in cause.parameters.items())
    harm = ""
    if cause.harm_sigma is not None:
        harm = f"; moves the calibration by up to {short(cause.harm_sigma)} sd"
    lines.append(f"    {sizes}{harm}")
    if cause.remedy:
        lines.append(f"    at the rig: {cause.remedy}")
    return lines


def _once(p_value: float) -> str:
    return "more than 1e300" if p_value <= 1e-300 else f"{1.0 / p_value:.3g}"


def _dps(value: float | None) -> str:
    return "?" if value is None else short(value * _DEG)
