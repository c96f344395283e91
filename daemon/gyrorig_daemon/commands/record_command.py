"""`gyrorigd record`: one session, in real or in simulated time."""

import json
import secrets
import signal
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
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
from gyrorig_daemon.config import EMULATED, RigConfig, parse_rig, read_document
from gyrorig_daemon.links.ports.halt_pipe import HaltPipe
from gyrorig_daemon.links.pump import StopFlag
from gyrorig_daemon.motion import RecordedMotion
from gyrorig_daemon.session import record_modes
from gyrorig_daemon.session.emulation_options import estimate_session_s, replay_begin_s
from gyrorig_daemon.session.line_writer import escape_controls
from gyrorig_daemon.session.session_description import SessionRequest
from gyrorig_daemon.session.session_environment import SessionSummary, ignore_event
from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.program import MotionProgram, parse_program

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@click.command("record", short_help="Record one session.")
@click.option("--config", "config_path", type=YAML_FILE, required=True, help="The rig file (YAML).")
@click.option(
    "--program",
    "program_path",
    type=YAML_FILE,
    help="Only without --replay: the motion program (YAML).",
)
@click.option(
    "--replay",
    "replay_path",
    type=click.Path(path_type=Path, dir_okay=False),
    help="With an emulated unit: send the orders of this recording at their times, instead of a "
    "program.",
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
    "--sessions",
    "session_count",
    type=click.IntRange(1, 10_000),
    default=1,
    show_default=True,
    metavar="NUMBER",
    help="With --simulated-time: record this many sessions one after the other. The seed of the "
    "session increases by 1 each time, and so does the number of --draw unless it is 0.",
)
@click.option(
    "--rates",
    type=YAML_FILE,
    help="With --simulated-time: write the noise-free rates of the gyroscopes to this file, with "
    "and without the hidden causes (npz). With --sessions: one file per session, with the number "
    "of the session after its name (rates-1.npz).",
)
@click.option(
    "--rates-of-session",
    is_flag=True,
    help="With --rates: write only the rates of the session, with its hidden causes. This takes "
    "less time.",
)
@emulation_flags
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object per session.")
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
    config_path = options["config_path"]
    config_text = read_document(config_path)
    config = parse_rig(config_text, config_path.name, config_path.parent)
    motion = _read_motion(options["program_path"], options["replay_path"], config)
    count = options["session_count"]
    if count > 1 and (not options["simulated_time"] or options["truth"]):
        raise UsageError(
            "the option --sessions needs --simulated-time, and no --truth",
            "remove the options that do not fit, or record one session per command",
        )
    is_quiet = terminal.quiet or terminal.verbose or config.ptu.is_person
    shows_progress = is_interactive() and not is_quiet
    commitments: list[str] = []

    def publish_commitment(sha256: str) -> None:
        commitments.append(sha256)
        print_commitment(sha256)

    def new_task(stop: StopFlag, progress: ProgressLine, number: int) -> record_modes.RecordTask:
        request = SessionRequest(
            config=config,
            config_text=config_text,
            program=motion.program,
            program_text=motion.program_text,
            out_dir=options["out"],
            session=_session_name(options["session"], number if count > 1 else None),
            home=options["home"],
            replay=motion.replay,
            replay_sha256=motion.replay_sha256,
        )

        def print_event(kind: str, text: str) -> None:
            progress.writer.write_line(f"{kind}: {text}")

        changed = _options_of_session(options, number) if count > 1 else {}
        return record_modes.RecordTask(
            request=request,
            config_path=config_path,
            emulation=emulation_options(
                options | changed | {"twin_recording": motion.twin_recording}, motion.session_s
            ),
            program_begin_s=motion.program_begin_s,
            host=socket.gethostname(),
            stop=stop,
            progress=progress,
            on_commitment=publish_commitment,
            on_event=print_event if terminal.verbose else ignore_event,
            on_summary=lambda summary: _print_summary(summary, terminal),
            say=lambda line: progress.writer.write(f"{escape_controls(line)}\n"),
        )

    with _stop_by_signal() as stop, ProgressLine(shows_progress) as progress:
        for number in range(count):
            task = new_task(stop, progress, number)
            if options["simulated_time"]:
                path = record_modes.record_in_simulated_time(task)
            else:
                path = record_modes.record_in_real_time(task)
            if options["as_json"]:
                commitment = {"seal": commitments.pop()} if commitments else {}
                click.echo(json.dumps({"recording": str(path)} | commitment))
            else:
                click.echo(str(path))


def _options_of_session(options: dict[str, Any], number: int) -> dict[str, Any]:
    """Return the options of one of several sessions; `number` counts from 0."""
    first_seed = 1 if options["session_seed"] is None else options["session_seed"]
    draw = options["draw"] + number if options["draw"] else 0
    rates: Path | None = options["rates"]
    if rates is not None:
        rates = rates.with_name(f"{rates.stem}-{number + 1}{rates.suffix}")
    return {"session_seed": first_seed + number, "draw": draw, "rates": rates}


@dataclass(frozen=True, slots=True)
class _Motion:
    """What the unit does in a session: a program, or a replay."""

    program: MotionProgram
    program_text: bytes
    session_s: tuple[float, float]  # of an emulated rig, since power-up
    replay: RecordedMotion | None = None
    replay_sha256: str = ""
    program_begin_s: float | None = None  # of a replay, since power-up
    twin_recording: str | None = None  # see `make_twin_rig`


def _read_motion(program_path: Path | None, replay_path: Path | None, config: RigConfig) -> _Motion:
    """Return the motion of the command line.

    Raises:
        UsageError: there is no motion, or there are two, or a real unit would replay one.
        InputError: the recording cannot be replayed.
    """
    if (program_path is None) == (replay_path is None):
        raise UsageError(
            "the session needs either a motion program or a recording to replay",
            "give one of the options --program and --replay",
        )
    if replay_path is None and program_path is not None:
        text = read_document(program_path)
        program = parse_program(text, program_path.name)
        return _Motion(program, text, estimate_session_s(program, config.ptu.is_person))
    if replay_path is None or config.ptu.port != EMULATED or config.ptu.is_person:
        raise UsageError(
            "the option --replay needs an emulated unit, because nobody checks the orders of a "
            "recording for a real one",
            "give a motion program with --program, or write `emulated` as the port of the unit",
        )
    from gyrorig_daemon.emulator.twin import OTHER_RECORDING  # noqa: PLC0415 - NumPy
    from gyrorig_daemon.session.recorded_motion import read_replay  # noqa: PLC0415 - NumPy

    source = read_replay(replay_path)
    begin_s = max(replay_begin_s(source.program.settings), source.motion.lead_ns * 1e-9)
    first_s = begin_s - source.motion.lead_ns * 1e-9
    recordings = () if config.twin is None else config.twin.recordings
    return _Motion(
        program=source.program,
        program_text=source.program_text,
        session_s=(first_s, begin_s + max(source.motion.duration_ns * 1e-9, 1.0)),
        replay=source.motion,
        replay_sha256=source.sha256,
        program_begin_s=begin_s,
        twin_recording=next(
            (r.name for r in recordings if r.sha256 == source.sha256), OTHER_RECORDING
        ),
    )


def _session_name(name: str | None, number: int | None) -> str:
    """Return the name of a session; `number` if there are several, from 0."""
    if name is not None and number is not None:
        name = f"{name}-{number + 1}"
    try:
        return secrets.token_hex(4) if name is None else BoardId(name)
    except InputError as error:
        raise UsageError(f"the session name {name!r:.50} is not valid", error.remedy) from error


@contextmanager
def _stop_by_signal() -> Iterator[StopFlag]:
    """Turn the first signal into a request to stop; the unit is halted before the end."""
    with HaltPipe(frozenset(SIGNALS)) as halt_pipe:  # closed after the handlers, which use it
        stop = StopFlag(halt_pipe)

        def request(number: int, frame: FrameType | None) -> None:
            stop.request(signal.Signals(number).name)

        previous_handlers = {number: signal.signal(number, request) for number in SIGNALS}
        halt_pipe.catch_signals()
        try:
            yield stop
        finally:
            for number, handler in previous_handlers.items():
                signal.signal(number, handler)


def _print_summary(summary: SessionSummary, terminal: Terminal) -> None:
    if not (is_interactive() or terminal.verbose):
        return
    boards = ", ".join(f"{board} {count} samples" for board, count in summary.samples.items())
    seconds = summary.duration_s
    terminal.note(f"Recorded {seconds:.1f} s, {len(summary.samples)} board(s): {boards}.")
