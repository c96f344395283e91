"""Words for the contributions to a total uncertainty."""

from gyrorig_solver.calibration.calibration_document import BudgetRow, UncertaintyRecord


def main_contribution(name: str, record: UncertaintyRecord) -> BudgetRow | None:
    """Return the largest contribution to a parameter; None where noise is the largest."""
    uncertainty = record.parameters[name]
    row = next((row for row in record.budget if row.parameter == name), None)
    return row if row is not None and row.contribution >= uncertainty.type_a else None


def contribution_name(row: BudgetRow) -> str:
    """Return a contribution's cause with its place, for people: `backlash (pan)`."""
    name = row.cause.replace("_", " ")
    return name if row.place is None else f"{name} ({row.place})"
