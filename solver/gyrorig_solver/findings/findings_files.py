"""The folder of one board's findings: document, report and figures.

    OUT/<board>/findings.yaml  report.html  next-program.yaml  figures/backlash-tilt.svg ...

Findings that are there already are kept under the next free number: findings-0001.yaml,
report-0001.html, figures-0001. Each file is written atomically, the document last.
"""

from collections.abc import Mapping
from itertools import count
from pathlib import Path

from gyrorig_protocol.errors import MachineError
from gyrorig_protocol.identity import BoardId
from gyrorig_solver.calibration import CalibrationStore
from gyrorig_solver.findings.findings_builder import NEXT_PROGRAM_NAME
from gyrorig_solver.storage import write_file

DOCUMENT_NAME, PAGE_NAME, FIGURES_FOLDER = "findings.yaml", "report.html", "figures"

FOLDER_NAMES = (PAGE_NAME, FIGURES_FOLDER, NEXT_PROGRAM_NAME, DOCUMENT_NAME)


def figure_path(key: str) -> str:
    """Return the file of a figure as the document names it."""
    return f"{FIGURES_FOLDER}/{key}.svg"


def write_findings(
    out: Path,
    board: BoardId,
    document: str,
    page: str,
    figures: Mapping[str, str],
    program: str | None = None,
) -> Path:
    """Write one board's findings; earlier ones are kept under a number.

    `program`: the proposed motion program, if it belongs beside the findings.

    Returns:
        The document's path.

    Raises:
        MachineError: the folder cannot be made or written.
    """
    folder = CalibrationStore(out).prepare_folder(board)
    try:
        _keep_earlier(folder)
        if figures:
            (folder / FIGURES_FOLDER).mkdir(exist_ok=True)
    except OSError as fault:
        raise MachineError(
            f"the folder {folder} cannot be written ({fault.strerror})",
            "choose another folder with --out",
        ) from fault
    for key, text in figures.items():
        write_file(folder / figure_path(key), text.encode(), replace=True)
    if program is not None:
        write_file(folder / NEXT_PROGRAM_NAME, program.encode(), replace=True)
    write_file(folder / PAGE_NAME, page.encode(), replace=True)
    write_file(folder / DOCUMENT_NAME, document.encode(), replace=True)
    return folder / DOCUMENT_NAME


def _keep_earlier(folder: Path) -> None:
    """Rename the files of earlier findings to the next free number."""
    if not (folder / DOCUMENT_NAME).exists():
        return
    names = [Path(name) for name in FOLDER_NAMES]
    for number in count(1):
        new_paths = {name: folder / f"{name.stem}-{number:04d}{name.suffix}" for name in names}
        if not any(path.exists() for path in new_paths.values()):
            break
    for name, path in new_paths.items():
        if (folder / name).exists():
            (folder / name).rename(path)
