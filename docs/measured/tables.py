"""What every set of the page shows alike: its commands, what was found, what is refused."""

from collections.abc import Iterable, Mapping

import numpy as np
from docs.markdown import number, table
from docs.measured.sessions import EXPLAINED, Done, Measured

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.calibration.document import Calibration
from gyrorig_solver.calibration.wording import GROUPS, collapsed, entries, quantity

MILLI = 1e3
AXES = "xyz"


def commands(done: Iterable[Done]) -> str:
    """The lines a reader types."""
    return "\n".join(("```sh", *(one.line for one in done), "```"))


def codes(measured: Measured) -> str:
    """How each command of each set ended."""
    rows = []
    for name, done in measured.done.items():
        if name == EXPLAINED:
            continue
        ended: dict[str, list[str]] = {"import": [], "check": [], "solve": []}
        for one in done:
            ended[one.line.split()[1]].append(str(one.exit_code))
        rows.append([f"`{name}`", *(", ".join(all_of) for all_of in ended.values())])
    return table(["set", "import", "check", "solve"], rows)


def refusals(done: Iterable[Done]) -> str:
    """The commands that refused their input, and the line that says why."""
    rows = [
        [f"`{_short(one.line)}`", str(one.exit_code), one.complained.strip()]
        for one in done
        if one.exit_code == 3
    ]
    return table(["command", "exit code", "said"], rows)


def _short(line: str) -> str:
    """A command with its input's folders left out, and without --out."""
    words = line.split(" --out", maxsplit=1)[0].split()
    return " ".join(word.rpartition("/")[2] if word.startswith("$") else word for word in words)


def findings(columns: Mapping[str, Calibration]) -> str:
    """Every parameter with its standard deviation, one calibration a column; then the verdict."""
    rows = []
    for group in GROUPS:
        values = {
            title: entries(calibration.parameters[group.name])
            for title, calibration in columns.items()
        }
        for at, label in enumerate(group.labels):
            cells = [_cell(*found[at], group.factor) for found in values.values()]
            name = f"{group.name.replace('_', ' ')} {label}".strip()
            rows.append([name if group.unit == "1" else f"{name}, {group.unit}", *cells])
    rows.append(
        [
            "observable",
            *(f"{c.observability.rank} of {c.observability.of}" for c in columns.values()),
        ]
    )
    rows.append(["verdict", *(c.trust.verdict for c in columns.values())])
    return table(["parameter", *columns], rows)


def _cell(value: float | None, std: float | None, factor: float) -> str:
    if value is None:
        return "-"
    text, spread = quantity(value * factor, None if std is None else std * factor)
    return f"{text} ± {spread}"


def reasons(calibrations: Mapping[str, Calibration]) -> str:
    """Why each result is limited, and what to do, in the document's own words."""
    lines = []
    for title, calibration in calibrations.items():
        lines += [f"- {title}: {reason}" for reason in calibration.trust.reasons]
        lines += [f"- {title}, remark: {text}" for text in calibration.quality.warnings]
    return "\n".join(lines)


def untold(calibration: Calibration) -> str:
    """The parameters without a value."""
    return ", ".join(collapsed(calibration.observability.unobservable)) or "none"


def gains_beside(
    ours: tuple[FloatArray, FloatArray], theirs: FloatArray, titles: tuple[str, str], digits: int
) -> str:
    """Each entry of two gain matrices, and their difference in our standard deviations."""
    gain, std = ours
    rows = []
    for i, j in np.ndindex(3, 3):
        mine, spread, other = (float(matrix[i, j]) for matrix in (gain, std, theirs))
        rows.append(
            [
                f"G {AXES[i]}{AXES[j]}",
                f"{number(mine, digits)} ± {number(spread, digits)}",
                number(other, digits),
                number((mine - other) / spread, 2),
            ]
        )
    return table(["entry", *titles, "difference / std"], rows)
