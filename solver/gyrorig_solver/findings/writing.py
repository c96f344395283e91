"""The folder of one board's findings: document, figures, page.

    OUT/<board>/findings.yaml  report.html  figures/backlash-tilt.svg ...

Each file is written whole; the document comes last, so that what it names is there.
"""

from collections.abc import Mapping
from pathlib import Path

from gyrorig_protocol.errors import MachineError
from gyrorig_protocol.identity import BoardId
from gyrorig_solver.calibration.store import CalibrationStore, write_whole

DOCUMENT, PAGE, FIGURES = "findings.yaml", "report.html", "figures"


def figure_name(key: str) -> str:
    """Return the file of a figure as the document names it."""
    return f"{FIGURES}/{key}.svg"


def write_findings(
    out: Path, board: BoardId, document: str, page: str, figures: Mapping[str, str]
) -> Path:
    """Write one board's findings; what an earlier run left of the same names is replaced.

    Args:
        out: the folder of all boards.
        board: which one.
        document: the text of findings.yaml.
        page: the text of report.html.
        figures: SVG texts by key.

    Returns:
        The document's path.

    Raises:
        MachineError: the folder cannot be made or written.
    """
    folder = CalibrationStore(out).prepare(board)
    if figures:
        try:
            (folder / FIGURES).mkdir(exist_ok=True)
        except OSError as fault:
            raise MachineError(
                f"cannot make the folder {folder / FIGURES}, {fault.strerror}",
                "choose another with --out",
            ) from fault
    for key, text in figures.items():
        write_whole(folder / figure_name(key), text.encode(), replace=True)
    write_whole(folder / PAGE, page.encode(), replace=True)
    write_whole(folder / DOCUMENT, document.encode(), replace=True)
    return folder / DOCUMENT
