"""`gyrorig compare`: a calibration compared with true values, or with another calibration."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from gyrorig_protocol.documents import parse_yaml
from gyrorig_protocol.errors import InputError
from gyrorig_protocol.file_kinds import describe_schema
from gyrorig_solver.apply import read_calibration
from gyrorig_solver.apply.calibration_file import read_document
from gyrorig_solver.calibration import CalibrationDocument
from gyrorig_solver.calibration.calibration_document import SCHEMA
from gyrorig_solver.check import ParameterComparison, compare_calibrations, compare_with_truth
from gyrorig_solver.commands.terminal import NOT_IDENTIFIABLE, Terminal, json_option
from gyrorig_solver.data.text_table import format_table
from gyrorig_solver.model import format_quantity

USUAL_SIGMA = 2.0  # standard uncertainties; 95 % of differences are smaller
WRONG_BEYOND_SIGMA = 3.5  # 13 right values exceed it in 6 of 1000 comparisons


@click.command("compare")
@click.argument("calibration", type=click.Path(path_type=Path, dir_okay=False))
@click.argument("reference", type=click.Path(path_type=Path, dir_okay=False))
@json_option
@click.pass_obj
def compare_command(terminal: Terminal, calibration: Path, reference: Path) -> int:
    r"""Compare a calibration with true values, or with another calibration.

    REFERENCE is the file that `gyrorigd record --truth` writes for an emulated rig, or a second
    calibration. The last column is the difference in standard uncertainties u. A difference of
    more than 3.5 u is marked with `!`. The column before it has the difference in total
    uncertainties, where they are known. The exit status is 4 if a parameter has no value in one of
    the files.

    \b
    Example:
      gyrorig compare calibrations/GY80-1/v0001.yaml truth.yaml
    """
    document, _ = read_calibration(calibration)
    rows, column, remarks = _compare(document, reference)
    terminal.print_result(f"{document.board.id}, {' '.join(document.board.sensor.split())}")
    for remark in remarks:
        terminal.print_result(f"  remark: {remark}")
    terminal.print_result(comparison_table(rows, column))
    terminal.print_result(comparison_summary(rows))
    is_incomplete = any(row.estimate is None or row.truth is None for row in rows)
    code = NOT_IDENTIFIABLE if is_incomplete else 0
    terminal.print_json(
        {
            "board": document.board.id,
            "compared_with": column,
            "remarks": remarks,
            "parameters": [comparison_json(row) for row in rows],
            "exit_code": code,
        }
    )
    return code


def _compare(
    document: CalibrationDocument, reference: Path
) -> tuple[list[ParameterComparison], str, list[str]]:
    """Return the rows, the heading of the values compared with, and remarks.

    Raises:
        InputError: the reference is neither a calibration nor a file of true values.
    """
    content = parse_yaml(read_document(reference), str(reference), InputError, SCHEMA)
    if not isinstance(content, dict):
        raise InputError(
            f"the reference file {reference} contains neither true values nor a calibration",
            "give the truth file that `gyrorigd record --truth` wrote, or a second calibration",
        )
    if content.get("schema") == SCHEMA:
        other, _ = read_calibration(reference)
        remarks = [*_board_remarks(document, other), *_refusal_remarks(document, other)]
        return compare_calibrations(document, other), "other", remarks
    if (kind := describe_schema(content.get("schema"))) is not None:
        raise InputError(
            f"the file {reference} is {kind}, but true values or a calibration are expected here",
            "give the truth file that `gyrorigd record --truth` wrote, or a second calibration",
        )
    return compare_with_truth(document, content), "truth", _refusal_remarks(document)


def _board_remarks(document: CalibrationDocument, other: CalibrationDocument) -> list[str]:
    """Return a remark if the calibrations are of different boards."""
    boards = [f"{c.board.id} with the uid {c.board.uid[:40]!r}" for c in (document, other)]
    if document.board.id == other.board.id and not document.board.has_other_uid(other.board.uid):
        return []
    return [f"the calibrations are of different boards, {boards[0]} and {boards[1]}"]


def _refusal_remarks(*documents: CalibrationDocument) -> list[str]:
    """Return a remark for each calibration whose values have no meaning."""
    return [
        f"the {name} calibration, version {document.version}, is refused: "
        f"{'. '.join(document.trust.reasons[:1]) or 'see its report'}"
        for name, document in zip(("first", "second"), documents, strict=False)
        if document.trust.verdict == "refused"
    ]


def _difference_text(sigmas: float | None) -> str:
    if sigmas is None:
        return "u not known"
    mark = "" if abs(sigmas) <= WRONG_BEYOND_SIGMA else " !"
    return f"{sigmas:+.2f} u{mark}"


def comparison_table(rows: Sequence[ParameterComparison], column: str = "truth") -> str:
    """Return estimate, compared value, standard uncertainty and difference of each parameter."""
    has_totals = any(row.total_sigmas is not None for row in rows)
    heading = ("", "found", column, "u (k = 1)", "unit", "of total u", "difference")
    cells: list[tuple[str, ...]] = [heading]
    for row in rows:
        unit = "" if row.unit == "1" else row.unit
        if row.estimate is None:
            cells.append((row.name, "not determined", "", "", "", "", ""))
            continue
        if row.truth is None:
            value_text, _ = format_quantity(row.estimate, row.std)
            cells.append((row.name, value_text, "not determined", "", unit, "", ""))
            continue
        value_text, std_text = format_quantity(row.estimate, row.std)
        decimals = len(value_text.partition(".")[2])
        cells.append(
            (
                row.name,
                value_text,
                f"{row.truth:+.{decimals}f}",
                std_text,
                unit,
                "" if row.total_sigmas is None else f"{row.total_sigmas:+.2f}",
                _difference_text(row.sigmas),
            )
        )
    if not has_totals:
        cells = [(*row_cells[:5], row_cells[6]) for row_cells in cells]
    right = (1, 2, 3, 5, 6)
    return "\n".join(f"  {line}" for line in format_table(cells, right=right))


def comparison_summary(rows: Sequence[ParameterComparison]) -> str:
    """Return how many differences are within 2 and within 3.5 standard uncertainties."""
    sizes = [abs(row.sigmas) for row in rows if row.sigmas is not None]
    within = {
        limit: sum(size <= limit for size in sizes) for limit in (USUAL_SIGMA, WRONG_BEYOND_SIGMA)
    }
    differences = (
        f"  {within[USUAL_SIGMA]} of {len(sizes)} parameters differ by at most {USUAL_SIGMA:g} u, "
        f"{within[WRONG_BEYOND_SIGMA]} of {len(sizes)} by at most {WRONG_BEYOND_SIGMA:g} u."
    )
    totals = [abs(row.total_sigmas) for row in rows if row.total_sigmas is not None]
    if not totals:
        return differences
    count = sum(size <= USUAL_SIGMA for size in totals)
    return (
        f"  {count} of {len(totals)} parameters differ by at most {USUAL_SIGMA:g} total u.\n"
        f"{differences}"
    )


def comparison_json(row: ParameterComparison) -> dict[str, Any]:
    """Return one row as an object of `--json`."""
    return {
        "name": row.name,
        "found": row.estimate,
        "truth": row.truth,
        "std": row.std,
        "unit": row.unit,
        "sigmas": row.sigmas,
        **({} if row.total is None else {"total": row.total, "total_sigmas": row.total_sigmas}),
    }
