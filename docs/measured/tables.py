"""Tables that all sets of the page share: commands, results and rejected input."""

from collections.abc import Iterable, Mapping

import numpy as np
from docs.markdown import number, table
from docs.measured.sessions import EXPLAINED, CommandRun, MeasuredSets

from gyrorig_solver.calibration import CalibrationDocument
from gyrorig_solver.calibration.calibration_wording import collapse_groups, value_std_pairs
from gyrorig_solver.data import FloatArray
from gyrorig_solver.model import PARAMETER_GROUPS, format_quantity

MILLI = 1e3
AXES = "xyz"


def commands(runs: Iterable[CommandRun]) -> str:
    """Return the command lines."""
    return "\n".join(("```sh", *(command.line for command in runs), "```"))


def exit_codes(measured: MeasuredSets) -> str:
    """Return the exit codes of all commands of each set."""
    rows = []
    for name, runs in measured.runs.items():
        if name == EXPLAINED:
            continue
        codes_by_command: dict[str, list[str]] = {"import": [], "check": [], "solve": []}
        for command in runs:
            codes_by_command[command.line.split()[1]].append(str(command.exit_code))
        rows.append([f"`{name}`", *(", ".join(codes) for codes in codes_by_command.values())])
    return table(["data set", "exit codes of import", "of check", "of solve"], rows)


def refusals(runs: Iterable[CommandRun]) -> str:
    """Return the commands that rejected their input, and their error messages."""
    rows = [
        [f"`{_shorten_command(command.line)}`", str(command.exit_code), command.errors.strip()]
        for command in runs
        if command.exit_code == 3
    ]
    return table(["command", "exit code", "message"], rows)


def _shorten_command(line: str) -> str:
    """Return a command without the folders of its input, and without --out."""
    words = line.split(" --out", maxsplit=1)[0].split()
    return " ".join(word.rpartition("/")[2] if word.startswith("$") else word for word in words)


def results(columns: Mapping[str, CalibrationDocument]) -> str:
    """Return all parameters with standard deviations, and the verdict, one column per document."""
    rows = []
    for group in PARAMETER_GROUPS:
        values = {
            title: value_std_pairs(calibration.parameters[group.name])
            for title, calibration in columns.items()
        }
        for at, label in enumerate(group.labels):
            cells = [_format_cell(*pairs[at], group.factor) for pairs in values.values()]
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


def _format_cell(value: float | None, std: float | None, factor: float) -> str:
    if value is None:
        return "-"
    text, spread = format_quantity(value * factor, None if std is None else std * factor)
    return f"{text} ± {spread}"


def reasons(calibrations: Mapping[str, CalibrationDocument]) -> str:
    """Return the reasons for each verdict and the remarks, with their remedies."""
    rows = []
    for title, calibration in calibrations.items():
        rows += [[title, "reason", text] for text in calibration.trust.reasons]
        rows += [[title, "remark", text] for text in calibration.quality.warnings]
    return table(["recording", "kind", "message"], rows)


def list_unobservable(calibration: CalibrationDocument) -> str:
    """Return the parameters without a value."""
    return ", ".join(collapse_groups(calibration.observability.unobservable)) or "none"


def compare_gains(
    ours: tuple[FloatArray, FloatArray], theirs: FloatArray, titles: tuple[str, str], digits: int
) -> str:
    """Return the entries of two gain matrices, and their differences over our std."""
    gain, std = ours
    rows = []
    for i, j in np.ndindex(3, 3):
        our_value, spread, their_value = (float(matrix[i, j]) for matrix in (gain, std, theirs))
        rows.append(
            [
                f"G {AXES[i]}{AXES[j]}",
                f"{number(our_value, digits)} ± {number(spread, digits)}",
                number(their_value, digits),
                number((our_value - their_value) / spread, 2),
            ]
        )
    return table(["entry", *titles, "difference / std"], rows)
