"""`gyrorigd recover`: finish the recordings that a crash has left unfinished."""

import json
from pathlib import Path

import click

from gyrorig_daemon.commands.terminal import ProgressLine, Terminal, is_interactive, print_line
from gyrorig_daemon.recorder.recovery import RecoveryOutcome, recover_folder
from gyrorig_protocol.errors import MachineError


@click.command("recover", short_help="Finish recordings after a crash.")
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False, exists=True))
@click.option(
    "--reserve",
    "reserve_bytes",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    metavar="BYTES",
    help="How many bytes must stay free on the disk.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
@click.pass_obj
def recover_command(terminal: Terminal, folder: Path, reserve_bytes: int, as_json: bool) -> None:
    r"""Finish the unfinished recordings in FOLDER.

    Everything undamaged is copied to a new file, which is verified. The originals are kept in
    FOLDER/unclean. Files that are being written are left alone. The daemon does the same at
    every start.

    \b
    Example:
      gyrorigd recover /var/lib/gyrorig/recordings
    """
    with ProgressLine(is_interactive() and not terminal.quiet):
        recoveries = recover_folder(folder, reserve_bytes)
    if as_json:
        reports = [
            {
                "original": str(recovery.original),
                "outcome": recovery.outcome.value,
                "recording": None if recovery.recording is None else str(recovery.recording),
                "messages": recovery.messages,
                "lost_bytes": recovery.lost_bytes,
                "text": recovery.text,
            }
            for recovery in recoveries
        ]
        click.echo(json.dumps({"recovered": reports}))
        return
    for recovery in recoveries:
        print_line(recovery.text)
    failed = [recovery for recovery in recoveries if recovery.outcome is RecoveryOutcome.FAILED]
    if failed:
        raise MachineError(
            f"the command could not recover {len(failed)} of {len(recoveries)} files",
            "follow the advice in the lines above, and run the command again. The files "
            "that failed were not changed",
        )
