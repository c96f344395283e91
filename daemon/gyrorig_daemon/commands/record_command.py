"""`gyrorigd record`: one session, in real or in simulated time."""

import json
import secrets
import signal
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import click

from gyrorig_daemon.commands.emulation_flags import (
    YAML_FILE,
    emulation_flags,
    emulation_options,
    print_commitment,
)
from gyrorig_daemon.commands.terminal import ProgressLine, Terminal, is_interactive
from gyrorig_daemon.config import parse_rig, read_document
from gyrorig_daemon.links.pump import StopFlag
from gyrorig_daemon.session import record_modes
from gyrorig_daemon.session.emulation_options import estimate_session_s
from gyrorig_daemon.session.session_description import SessionRequest
from gyrorig_daemon.session.session_environment import SessionSummary, ignore_event
from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.program import parse_program

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@click.command("record", short_help="Record one session.")
@click.option("--config", "config_path", type=YAML_FILE, required=True, help="The rig file (YAML).")
@click.option(
    "--program", "program_path", type=YAML_FILE, required=True, help="The motion program (YAML)."
)
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("recordings"),
    show_default=True,
    help="The folder for the recording.",
)
@click.option(
    "--home", is_flag=True, help="Home the unit first. Both axes sweep their whole range."
)
@click.option(
    "--simulated-time",
    is_flag=True,
    help="Only with an emulated rig: run faster than real time.",
)
@click.option(
    "--session",
    help="The session's name: letters, digits and dashes, at most 32.  [default: random]",
)
@click.option(
    "--rates",
    type=YAML_FILE,
    help="With --simulated-time: write the noise-free rates of the gyroscopes to this file, with "
    "and without the hidden causes (npz).",
)
@emulation_flags
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
@click.pass_context
def record_command(context: click.Context, /, **options: Any) -> None:
    r"""Record one session: identify the rig, run the program, write a recording.

    Nothing moves before every device has identified itself and the whole program is inside
    the limits of the unit. However the session ends, the unit is halted and the recording is
    closed. The path of the recording is printed on standard output. With `driver: manual` in the
    rig file, the program guides a person who turns the boards.

    \b
    Example:
      gyrorigd record --config config/rig.yaml \
        --program config/programs/survey-130.yaml --out recordings
    """
    terminal = context.find_object(Terminal) or Terminal()
    config_path, program_path = options["config_path"], options["program_path"]
    config_text, program_text = read_document(config_path), read_document(program_path)
    config = parse_rig(config_text, config_path.name, config_path.parent)
    request = SessionRequest(
        config=config,
        config_text=config_text,
        program=parse_program(program_text, program_path.name),
        program_text=program_text,
        out_dir=options["out"],
        session=_session_name(options["session"]),
        home=options["home"],
    )
    span_s = estimate_session_s(request.program, config.ptu.is_person)
    commitments: list[str] = []
    is_quiet = terminal.quiet or terminal.verbose or config.ptu.is_person
    shows_progress = is_interactive() and not is_quiet

    def publish_commitment(sha256: str) -> None:
        commitments.append(sha256)
        print_commitment(sha256)

    with _stop_by_signal() as stop, ProgressLine(shows_progress) as progress:
        task = record_modes.RecordTask(
            request=request,
            config_path=config_path,
            emulation=emulation_options(options, span_s),
            host=socket.gethostname(),
            stop=stop,
            progress=progress,
            on_commitment=publish_commitment,
            on_event=_print_event if terminal.verbose else ignore_event,
            on_summary=lambda summary: _print_summary(summary, terminal),
            say=_print_line,
        )
        if options["simulated_time"]:
            path = record_modes.record_in_simulated_time(task)
        else:
            path = record_modes.record_in_real_time(task)
    if options["as_json"]:
        commitment = {"seal": commitments[0]} if commitments else {}
        click.echo(json.dumps({"recording": str(path)} | commitment))
    else:
        click.echo(str(path))


def _session_name(name: str | None) -> str:
    try:
        return secrets.token_hex(4) if name is None else BoardId(name)
    except InputError as error:
        raise UsageError(f"the session name {name!r:.50} is not valid", error.remedy) from error


@contextmanager
def _stop_by_signal() -> Iterator[StopFlag]:
    """Turn the first signal into a request to stop; the unit is halted before the end."""
    stop = StopFlag()

    def request(number: int, frame: FrameType | None) -> None:
        stop.request(signal.Signals(number).name)

    previous_handlers = {number: signal.signal(number, request) for number in SIGNALS}
    try:
        yield stop
    finally:
        for number, handler in previous_handlers.items():
            signal.signal(number, handler)


def _print_line(line: str) -> None:
    click.echo(line, err=True)


def _print_event(kind: str, text: str) -> None:
    click.echo(f"{kind}: {text}", err=True)


def _print_summary(summary: SessionSummary, terminal: Terminal) -> None:
    if not (is_interactive() or terminal.verbose):
        return
    boards = ", ".join(f"{board} {count} samples" for board, count in summary.samples.items())
    seconds = summary.duration_s
    terminal.note(f"Recorded {seconds:.1f} s, {len(summary.samples)} board(s): {boards}.")
