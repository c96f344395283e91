"""Reading the recordings of a command, and the inputs that fail while the others go on."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from gyrorig_protocol.errors import GyrorigError
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.commands.board_selection import read_within_limits, select_boards
from gyrorig_solver.commands.terminal import Terminal


@dataclass(slots=True)
class InputFailures:
    """The errors of recordings and boards."""

    faults: list[GyrorigError] = field(default_factory=list)
    rows: list[dict[str, str]] = field(default_factory=list)  # for `--json`

    def add(self, fault: GyrorigError, recording: Path, board: str = "") -> None:
        """Add the error of a board, or of a whole recording."""
        self.faults.append(fault)
        self.rows.append({"recording": str(recording), "board": board, "error": str(fault)})

    def report(self, terminal: Terminal, has_results: bool) -> None:
        """Print each error; raise the only error of a command without results."""
        if len(self.faults) == 1 and not has_results:
            raise self.faults[0]
        for row in self.rows:
            terminal.print_error(f"{row['board'] or row['recording']}: {row['error']}")


def read_with_board(
    terminal: Terminal,
    paths: Sequence[Path],
    board: str | None,
    failures: InputFailures,
) -> list[Recording]:
    """Return the recordings that can be read and contain the wanted board."""
    recordings: list[Recording] = []
    for path in paths:
        terminal.print_progress(f"reading {path.name}")
        try:
            recording = read_within_limits(path)
            select_boards(recording, board)
            recordings.append(recording)
        except GyrorigError as fault:
            failures.add(fault, path)
    return recordings
