"""`gyrorigd recover`: finish by hand, or for a daemon that starts, what a crash has left."""

import json
from pathlib import Path

import click

from gyrorig_daemon.recorder.recovery import Outcome, recover_folder
from gyrorig_protocol.errors import MachineError


@click.command("recover")
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
def recover_command(folder: Path, reserve_bytes: int, as_json: bool) -> None:
    """Make finished recordings of the unfinished ones in FOLDER.

    Everything sound goes into a new file, which is verified; originals are kept in
    FOLDER/unclean. Files that are being written are left alone. The daemon does this at
    every start by itself.

    Example: gyrorigd recover /var/lib/gyrorig/recordings
    """
    found = recover_folder(folder, reserve_bytes)
    if as_json:
        reports = [
            {
                "original": str(one.original),
                "outcome": one.outcome.value,
                "recording": None if one.recording is None else str(one.recording),
                "messages": one.messages,
                "lost_bytes": one.lost_bytes,
                "text": one.text,
            }
            for one in found
        ]
        click.echo(json.dumps({"recovered": reports}))
        return
    for one in found:
        click.echo(one.text)
    failed = [one for one in found if one.outcome is Outcome.FAILED]
    if failed:
        raise MachineError(
            f"{len(failed)} of {len(found)} files could not be recovered",
            "do what the lines above say of each, and run this again: nothing of them was changed",
        )
