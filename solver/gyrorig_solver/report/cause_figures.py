"""The explain report's figures: each cause against data, and what is left, before and after.

What to use when: `cause_figure` for a named cause, `rest_figure` for what none explains,
`left_over_time`, `spectrum` and `dependences` for the residual as a whole.
"""

from collections.abc import Sequence

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.report.course import Course
from gyrorig_solver.report.dependence import (
    LEAST_BLOCKS,
    OF_CAUSE,
    OF_SIGNATURE,
    UNITS,
    Dependence,
    in_bins,
    label,
)
from gyrorig_solver.report.drawing import (
    AXIS_COLOURS,
    BEFORE,
    INK,
    SOFT,
    envelope,
    stacked,
)

WITHOUT, WITH = "without it", "with it"
BY_EFFECT = 14  # groups of equal size in a picture by effect
CLOSE_S, EVENT_S = 1.4, 0.3  # of a picture close by, and of what is in its middle


def cause_figure(course: Course, cause: str, key: str, where: Sequence[str]) -> str:
    """Draw one cause: data, and the models without and with it, by what it acts on."""
    dependence = OF_CAUSE.get(cause)
    effect = course.effects[key]
    axis = strongest(effect)
    motor = 1 if "tilt" in where and "pan" not in where else 0
    if dependence == OF_CAUSE["eccentricity"] and motor == 1:
        dependence = Dependence("gain", "tilt")
    if dependence is None:
        return _elsewise(course, effect, key, axis)
    data = in_bins(course, course.without(key), dependence, axis, motor)
    model = in_bins(course, effect, dependence, axis, motor)
    if data.centre.size < 3:
        return _elsewise(course, effect, key, axis)
    figure, (panel,) = stacked(1, 3.4)
    panel.dots(
        data.centre,
        data.value,
        data.bar,
        colour=INK,
        bar_colour=BEFORE,
        linewidth=0.0,
        markersize=4,
        label="data",
    )
    panel.level(0.0, colour=SOFT, linewidth=1.1, linestyle="--", label=WITHOUT)
    panel.plot(model.centre, model.value, colour=AXIS_COLOURS[axis], linewidth=1.8, label=WITH)
    panel.xlabel = label(dependence.covariate, motor)
    panel.ylabel = f"left on {'xyz'[axis]}, {UNITS[dependence.quantity]}"
    panel.key = True
    return figure.svg()


def _elsewise(course: Course, effect: FloatArray, key: str, axis: int) -> str:
    """Draw a cause that has no picture of its own here."""
    if np.isfinite(course.angle_rad).any():
        return close_by(course, effect, axis)
    return by_effect(course, effect, key, axis)


def by_effect(course: Course, effect: FloatArray, key: str, axis: int) -> str:
    """Draw what is left without a cause by what the cause says: on the diagonal it is right.

    For hand motion, where no moment shows an effect but all together do.
    """
    says, left = np.degrees(effect[:, axis]), np.degrees(course.without(key)[:, axis])
    known = np.isfinite(says) & np.isfinite(left)
    order = np.argsort(says[known])
    groups = np.array_split(order, min(BY_EFFECT, max(1, order.size // LEAST_BLOCKS)))
    at = np.array([says[known][g].mean() for g in groups])
    value = np.array([left[known][g].mean() for g in groups])
    bar = np.array([1.96 * left[known][g].std() / np.sqrt(g.size) for g in groups])
    figure, (panel,) = stacked(1, 3.4)
    panel.dots(
        at, value, bar, colour=INK, bar_colour=BEFORE, linewidth=0.0, markersize=4, label="data"
    )
    panel.level(0.0, colour=SOFT, linewidth=1.1, linestyle="--", label=WITHOUT)
    panel.plot(at, at, colour=AXIS_COLOURS[axis], linewidth=1.8, label=WITH)
    panel.xlabel = f"what the cause adds on {'xyz'[axis]}, deg/s"
    panel.ylabel = f"left on {'xyz'[axis]} without it, deg/s"
    panel.key = True
    return figure.svg()


def close_by(course: Course, effect: FloatArray, axis: int) -> str:
    """Draw the moment at which a cause's effect is largest: rates, then what is left.

    All other causes are in both models.
    """
    rows = _busiest(course, effect[:, axis])
    time_s = course.time_s[rows]
    figure, (above, below) = stacked(2, 4.6)
    above.plot(
        time_s,
        np.degrees(course.measured_rad_s[rows, axis]),
        colour=INK,
        linewidth=0.0,
        markersize=2.4,
        label="data",
    )
    for values, colour, style, words in (
        (course.extended_rad_s - effect, SOFT, "--", WITHOUT),
        (course.extended_rad_s, AXIS_COLOURS[axis], "-", WITH),
    ):
        above.plot(
            time_s,
            np.degrees(values[rows, axis]),
            colour=colour,
            linewidth=1.3,
            linestyle=style,
            label=words,
        )
    above.ylabel = f"{'xyz'[axis]}  deg/s"
    above.key = True
    below.plot(
        time_s,
        np.degrees((course.left_extended_rad_s + effect)[rows, axis]),
        colour=BEFORE,
        linewidth=1.2,
        markersize=2.2,
        label=f"left {WITHOUT}",
    )
    below.plot(
        time_s,
        np.degrees(course.left_extended_rad_s[rows, axis]),
        colour=AXIS_COLOURS[axis],
        linewidth=1.2,
        markersize=2.2,
        label=f"left {WITH}",
    )
    below.level(0.0, colour=SOFT, linewidth=0.5)
    below.ylabel = "left, deg/s"
    below.xlabel = "seconds"
    below.key = True
    return figure.svg()


def rest_figure(course: Course, signature: str, axis: int | None) -> str:
    """Draw what no cause explains against what it depends on most."""
    left = course.unexplained_rad_s
    if signature == "line":
        return spectrum(course)
    dependence = OF_SIGNATURE.get(signature)
    if dependence is None:
        return left_over_time(course)
    motor = 1 if signature.startswith("tilt") else 0
    figure, (panel,) = stacked(1, 3.4)
    axes = range(3) if axis is None else (axis,)
    for one in axes:
        found = in_bins(course, left, dependence, one, motor)
        panel.dots(
            found.centre,
            found.value,
            found.bar,
            colour=AXIS_COLOURS[one],
            linewidth=1.0,
            markersize=3.5,
            label="xyz"[one],
        )
    panel.level(0.0, colour=SOFT, linewidth=0.8)
    panel.xlabel = label(dependence.covariate, motor)
    panel.ylabel = f"left, {UNITS[dependence.quantity]}"
    panel.key = True
    return figure.svg()


def left_over_time(course: Course) -> str:
    """Draw what both models leave, in deg/s, one panel an axis."""
    figure, panels = stacked(3, 5.0)
    base, extended = course.left_base_rad_s, course.left_extended_rad_s
    for axis, panel in enumerate(panels):
        if course.effects:
            envelope(panel, course.time_s, np.degrees(base[:, axis]), BEFORE)
        envelope(panel, course.time_s, np.degrees(extended[:, axis]), AXIS_COLOURS[axis])
        panel.level(0.0, colour=SOFT, linewidth=0.5)
        panel.ylabel = f"{'xyz'[axis]}  deg/s"
    panels[-1].xlabel = "seconds"
    return figure.svg()


def spectrum(course: Course) -> str:
    """Draw the density of what both models leave, and of the noise assumed."""
    figure, (panel,) = stacked(1, 3.6)
    for axis in range(3):
        before = [(course.spectrum_base, BEFORE, 1.4)] if course.effects else []
        for density, colour, width in (
            *before,
            (course.spectrum_extended, AXIS_COLOURS[axis], 1.0),
        ):
            panel.plot(
                course.frequency_hz,
                np.degrees(np.sqrt(density[:, axis])),
                colour=colour,
                linewidth=width,
                label="xyz"[axis] if colour != BEFORE else "base model" * (axis == 0),
            )
    for axis in range(3):
        panel.plot(
            course.frequency_hz,
            np.degrees(np.sqrt(course.spectrum_model[:, axis])),
            colour=SOFT,
            linewidth=0.9,
            linestyle="--",
            label="noise assumed" if axis == 0 else "",
        )
    panel.decades = True
    panel.xlabel = "Hz"
    panel.ylabel = "deg/s/sqrt(Hz)"
    panel.key = True
    return figure.svg()


def dependences(course: Course) -> dict[str, str]:
    """Draw what both models leave against everything that is known, by name."""
    drawn = {}
    for name, dependence, motor in (
        ("own_rate", Dependence("mean", "own_rate"), 0),
        ("pan", Dependence("gain", "pan"), 0),
        ("tilt", Dependence("gain", "tilt", 10), 0),
        ("time", Dependence("lag", "time", 16), 0),
        ("temperature", Dependence("mean", "temperature", 12), 0),
    ):
        axis = _most_moved(course) if dependence.quantity != "mean" else _worst(course)
        before = in_bins(course, course.left_base_rad_s, dependence, axis, motor)
        after = in_bins(course, course.left_extended_rad_s, dependence, axis, motor)
        if before.centre.size < 3:
            continue
        figure, (panel,) = stacked(1, 2.7)
        # Where no cause was found there is but one model.
        pairs = [(before, BEFORE, "base model")] if course.effects else []
        last = "extended model" if course.effects else "base model"
        for found, colour, words in (*pairs, (after, AXIS_COLOURS[axis], last)):
            panel.dots(
                found.centre,
                found.value,
                found.bar,
                colour=colour,
                linewidth=1.0,
                markersize=3,
                label=words,
            )
        panel.level(0.0, colour=SOFT, linewidth=0.6)
        panel.xlabel = label(dependence.covariate, motor)
        panel.ylabel = f"left on {'xyz'[axis]}, {UNITS[dependence.quantity]}"
        panel.key = True
        drawn[name] = figure.svg()
    return drawn


def strongest(effect: FloatArray) -> int:
    """Return the sensor axis on which an effect (n, 3) has most energy about its mean."""
    known = effect[np.isfinite(effect).all(axis=1)]
    return int(np.argmax(np.var(known, axis=0))) if known.size else 2


def _busiest(course: Course, change: FloatArray) -> slice:
    """Return the rows around the moment where a change (n,) has most energy."""
    step_s = float(np.median(np.diff(course.time_s)))
    many = max(4, min(change.size, round(EVENT_S / step_s)))
    power = np.nan_to_num(change - np.nanmedian(change)) ** 2
    total = np.concatenate([[0.0], np.cumsum(power)])
    event = int(np.argmax(total[many:] - total[:-many]))
    around = round((CLOSE_S - EVENT_S) / 2.0 / step_s)
    return slice(max(0, event - around), min(change.size, event + many + around))


def _most_moved(course: Course) -> int:
    return int(np.argmax(np.nanvar(course.base_rad_s, axis=0)))


def _worst(course: Course) -> int:
    return int(np.argmax(np.nanvar(course.left_base_rad_s, axis=0)))
