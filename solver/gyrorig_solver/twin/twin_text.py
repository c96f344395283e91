"""A twin as lines for a terminal: determined values, and values that keep their defaults.

What to use when: `twin_summary` after a twin was built; `undetermined_values` for the values that
the recordings do not show.
"""

from collections.abc import Iterator

import msgspec

from gyrorig_protocol.twin import Scalar, Twin, TwinBoard, TwinCause, Vector
from gyrorig_solver.findings import cause_title
from gyrorig_solver.model import (
    DEG_PER_RAD,
    cause_display_unit,
    format_quantity,
    format_short,
    plural,
)
from gyrorig_solver.twin.twin_builder import BuiltTwin

NO_UNIT = (
    "the recordings have no motion unit, so this twin has the emulator's default unit, and only "
    "its boards are measured"
)
UNEXPLAINED = "a part of the residual has no known cause; the twin does not contain it"
UNIT_VALUES = ("answer_time", "start_delay")
LINK_VALUES = ("floor", "jitter", "stall_interval")
NOT_SHOWN_OF_BOARD = ("temperature", "later_temperatures", "clock", "noise_floor", "unexplained")
# Key of a value of the twin, and its name for people.
VALUE_NAMES = {
    "gain": "sensor matrix",
    "time_offset": "time offset",
    "noise_density": "white noise",
    "bias_instability": "bias instability",
    "rate_random_walk": "rate random walk",
    "odr": "sample rate",
    "full_scale": "full scale",
    "count": "size of a count",
    "stamp_jitter": "timestamp jitter",
    "answer_time": "answer time",
    "start_delay": "start delay",
    "floor": "latency floor",
    "stall_interval": "stalls",
}


def twin_summary(built: BuiltTwin) -> str:
    """Return the contents of a twin, line by line."""
    twin = built.twin
    counts = f"{plural(len(twin.boards), 'board')} of {plural(len(twin.recordings), 'recording')}"
    lines = [f"twin of {built.rig['rig']}: {counts}, {_causes_text(twin)}"]
    lines += _unit_lines(twin)
    lines += _link_lines(twin)
    for name, board in twin.boards.items():
        lines += _board_lines(name, board)
    for number, cause in enumerate(twin.causes):
        lines.append(_cause_line(cause, built.alternatives[number]))
    left = undetermined_values(twin)
    if left:
        lines.append(f"  at the defaults       {', '.join(left)}")
    lines += [f"  ! {warning}" for warning in twin_warnings(built)]
    return "\n".join(lines)


def undetermined_values(twin: Twin) -> list[str]:
    """Return the values that keep a default, with their boards if there are several."""
    left = []
    if twin.unit is not None:
        left += _left_out(twin.unit, UNIT_VALUES, "")
    left += _left_out(twin.link, LINK_VALUES, "")
    several = len(twin.boards) > 1
    for name, board in twin.boards.items():
        keys = [field.name for field in msgspec.structs.fields(board)]
        shown = [key for key in keys if key not in NOT_SHOWN_OF_BOARD]
        left += _left_out(board, shown, f" of {name}" if several else "")
    return left


def twin_warnings(built: BuiltTwin) -> list[str]:
    """Return the causes and data that the twin of these recordings lacks."""
    warnings = [] if built.twin.unit is not None else [NO_UNIT]
    boards = [name for name, verdict in built.verdicts.items() if verdict == "unexplained"]
    if boards:
        where = f" ({', '.join(boards)})" if len(built.verdicts) > 1 else ""
        warnings.append(UNEXPLAINED + where)
    if built.not_emulated:
        titles = ", ".join(cause_title(cause).lower() for cause in built.not_emulated)
        warnings.append(f"the emulated rig does not have this cause: {titles}")
    if built.twin.posterior is None:
        warnings.append("the twin has no joint covariance, so every draw has the same values")
    warnings += [
        f"{loss}. The twin is that of the data that can be read." for loss in built.missing
    ]
    return warnings


def _left_out(part: msgspec.Struct, keys: tuple[str, ...] | list[str], suffix: str) -> list[str]:
    left = []
    for key in keys:
        value = getattr(part, key)
        if value is None or getattr(value, "source", "recording") == "default":
            left.append(VALUE_NAMES.get(key, key.replace("_", " ")) + suffix)
    return left


def _causes_text(twin: Twin) -> str:
    return plural(len(twin.causes), "cause") if twin.causes else "no cause"


def _unit_lines(twin: Twin) -> Iterator[str]:
    unit = twin.unit
    if unit is None:
        return
    texts = [
        f"{VALUE_NAMES[key]} {_value_text(getattr(unit, key), 1e3, 'ms')}"
        for key in UNIT_VALUES
        if getattr(unit, key) is not None
    ]
    if unit.counter.skew is not None:
        texts.append(f"clock {_value_text(unit.counter.skew, 1e6, 'ppm')}")
    model = f"{unit.facts.model}: " if unit.facts.model else ""
    yield f"  unit                  {model}{', '.join(texts)}"


def _link_lines(twin: Twin) -> Iterator[str]:
    link, texts = twin.link, []
    if link.jitter is not None:
        texts.append(f"jitter {_value_text(link.jitter, 1e3, 'ms')}")
    if link.floor is not None:
        texts.append(f"latency floor {_value_text(link.floor, 1e3, 'ms')}")
    if link.stall_interval is not None:
        longest = link.stall_longest
        if link.stall_interval.value == 0.0 or longest is None:
            texts.append("no stalls")
        else:
            interval_s = format_short(link.stall_interval.value)
            longest_ms = format_short(1e3 * longest.value)
            texts.append(f"a stall every {interval_s} s, up to {longest_ms} ms")
    if texts:
        yield f"  link                  {', '.join(texts)}"


def _board_lines(name: str, board: TwinBoard) -> Iterator[str]:
    texts = []
    if board.gain.source != "default":
        texts.append("sensor matrix")
    texts.append(_axes_text("bias", board.bias, DEG_PER_RAD, "deg/s"))
    if board.noise_density is not None:
        texts.append(_axes_text("white noise", board.noise_density, DEG_PER_RAD, "deg/s/√Hz"))
    if board.noise_floor is not None:
        texts.append(_axes_text("noise floor", board.noise_floor, DEG_PER_RAD, "deg/s/√Hz"))
    yield f"  board {name:<15} {'; '.join(texts)}"
    texts = []
    if board.time_offset.source != "default":
        texts.append(f"time offset {_value_text(board.time_offset, 1e3, 'ms')}")
    if board.odr is not None:
        texts.append(f"sample rate {format_short(board.odr.value)} Hz")
    if board.clock.skew is not None:
        texts.append(f"clock {_value_text(board.clock.skew, 1e6, 'ppm')}")
    if texts:
        yield f"                        {'; '.join(texts)}"


def _cause_line(cause: TwinCause, alternatives: tuple[str, ...]) -> str:
    sizes = []
    for name, size in cause.parameters.items():
        factor, unit = cause_display_unit(cause.cause, name.partition(".")[0], size.unit)
        sizes.append(f"{name} {_value_text(size, factor, unit)}")
    where = "" if cause.where == "all" else f" ({cause.where})"
    board = "" if cause.board is None else f" of {cause.board}"
    rivals = f"; or {' or '.join(alternatives)}" if alternatives else ""
    return f"  cause                 {cause.cause}{where}{board}: {', '.join(sizes)}{rivals}"


def _value_text(value: Scalar, factor: float, unit: str) -> str:
    if not value.std:
        return f"{format_short(value.value * factor)} {unit}".strip()
    text, std = format_quantity(value.value * factor, value.std * factor)
    return f"{text.removeprefix('+')} ± {std} {unit}".strip()


def _axes_text(name: str, values: Vector, factor: float, unit: str) -> str:
    numbers = ", ".join(format_short(value * factor) for value in values.value)
    return f"{name} {numbers} {unit}"
