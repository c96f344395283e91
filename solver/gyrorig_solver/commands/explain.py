"""`gyrorig explain`: what the model of the rig gets wrong, with its causes and a report."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from gyrorig_protocol.errors import GyrorigError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.commands.boards import chosen_boards
from gyrorig_solver.commands.terminal import (
    IN_PART,
    NOT_IDENTIFIABLE,
    Terminal,
    json_option,
)
from gyrorig_solver.findings.document import FindingsDocument, to_plain
from gyrorig_solver.findings.explaining import Written, explain_together, write_explanation
from gyrorig_solver.findings.wording import summary


@click.command("explain")
@click.argument("recordings", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--board", help="Only this board.  [default: every board in the recordings]")
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("findings"),
    show_default=True,
    help="The folder: OUT/<board>/findings.yaml, report.html and figures.",
)
@click.option(
    "--held-out",
    type=click.Path(path_type=Path),
    help="A recording on which to measure what the causes are worth; they are not fitted to it.  "
    "[default: none]",
)
@json_option
@click.pass_obj
def explain_command(
    terminal: Terminal,
    recordings: tuple[Path, ...],
    board: str | None,
    out: Path,
    held_out: Path | None,
) -> int:
    r"""Say what the model of the rig gets wrong, and name the causes, as far as data bear it.

    All recordings of one board are looked at together, and all boards of one unit: what all
    of them show is the unit's. The samples themselves are looked at first, then what the
    model leaves; each cause is measured on data that it was not fitted
    to. Leaves with 4 when the recordings cannot show a single cause: the findings say what
    would.

    With --held-out the model is taken to another recording as it is: bias, time offset and
    the motion's own unknowns alone are fitted to that, and causes of a single moment or
    recording are left out there.

    \b
    Example:
      gyrorig explain demo/session.mcap --out findings
      gyrorig explain monday.mcap --held-out tuesday.mcap
    """
    other = None if held_out is None else read_recording(held_out)
    read: list[Recording] = []
    failed: list[dict[str, str]] = []
    faults: list[GyrorigError] = []
    for path in recordings:
        terminal.progress(f"reading {path.name}")
        try:
            recording = read_recording(path)
            chosen_boards(recording, board)
            read.append(recording)
        except GyrorigError as fault:
            faults.append(fault)
            failed.append({"recording": str(path), "board": "", "error": str(fault)})
    written: list[Written] = []
    together = grouped(read, board)
    terminal.progress(f"explaining {', '.join(together)}")
    for name, found in explain_together(together, other):
        try:
            if isinstance(found, GyrorigError):
                raise found
            written.append(write_explanation(out, found))
            terminal.say(said(written[-1]))
        except GyrorigError as fault:
            faults.append(fault)
            at = str(together[name][0].path)
            failed.append({"recording": at, "board": str(name), "error": str(fault)})
    if len(faults) == 1 and not written:
        raise faults[0]
    for failure in failed:
        terminal.complain(f"{failure['board'] or failure['recording']}: {failure['error']}")
    code = exit_code([one.document for one in written], faults)
    terminal.emit({"boards": [plain(w) for w in written], "failed": failed, "exit_code": code})
    return code


def grouped(recordings: Sequence[Recording], wanted: str | None) -> dict[BoardId, list[Recording]]:
    """Return each wanted board with the recordings that hold it."""
    found: dict[BoardId, list[Recording]] = {}
    for recording in recordings:
        for board in recording.board_ids:
            if wanted is None or board == wanted:
                found.setdefault(board, []).append(recording)
    return found


def exit_code(documents: Sequence[FindingsDocument], faults: Sequence[GyrorigError]) -> int:
    """Return 5 where some failed, 4 where a board's recordings can show no cause at all."""
    if faults:
        return IN_PART if documents else faults[0].exit_code
    return NOT_IDENTIFIABLE if any(_blind(one) for one in documents) else 0


def _blind(document: FindingsDocument) -> bool:
    """Return whether nothing but the samples themselves could be looked at."""
    return document.gain is None and not document.minimal_detectable


def said(written: Written) -> str:
    """Return one board's findings as lines for a terminal."""
    return (
        f"{summary(written.document)}\n  findings              {written.path}"
        f"\n  report                {written.page}"
    )


def plain(written: Written) -> dict[str, Any]:
    """Return one board's findings as plain values."""
    return {
        "board": written.document.board.id,
        "verdict": written.document.verdict,
        "file": str(written.path),
        "report": str(written.page),
        "findings": to_plain(written.document),
    }
