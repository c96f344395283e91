"""Names and units of the index's parameter columns, as all commands show them.

What to use when: `column_label` for `scale.x` from `scale_x`, `column_unit` for the factor from
the index's SI unit to the unit shown, `format_shift` for a deviation with its unit.
"""

from gyrorig_solver.model import group_of, parameter_label


def column_label(column: str) -> str:
    """Return a parameter's name: `scale.x` for the column `scale_x`."""
    name, _, component = column.rpartition("_")
    return parameter_label(name, component) if group_of(name) else column


def column_unit(column: str) -> tuple[float, str]:
    """Return the factor from a column's SI unit to the unit shown, and that unit ("" for 1)."""
    group = group_of(column_label(column))
    if group is None:
        return 1.0, ""
    return group.factor, "" if group.unit == "1" else group.unit


def format_shift(column: str, size: float) -> str:
    """Return a deviation of a parameter with its sign and unit."""
    factor, unit = column_unit(column)
    return f"{factor * size:+.4g} {unit}".rstrip()
