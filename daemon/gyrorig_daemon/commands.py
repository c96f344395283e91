"""What `gyrorigd` can be told to do: its commands and their options."""

import json
import os
import secrets
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import Any

import click

from gyrorig_daemon import record
from gyrorig_daemon.config import load_rig, parse_rig, read_document
from gyrorig_daemon.description import SessionOrder
from gyrorig_daemon.doctor.command import doctor_command
from gyrorig_daemon.emulation import Emulation, rough_session_s
from gyrorig_daemon.halt_command import halt_command
from gyrorig_daemon.links.pump import StopFlag
from gyrorig_daemon.recorder.recover_command import recover_command
from gyrorig_daemon.service.commands import COMMANDS as SERVICE_COMMANDS
from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.program import parse_program
from gyrorig_protocol.recording.writer import software

_FILE = click.Path(path_type=Path, dir_okay=False)
_HIDE = (
    "An imperfection of the emulated rig to hide: a cause, after @ its place, after : its size, in "
    "the unit that `gyrorigd causes` lists; or random. Can be given several times."
)

Command = Callable[..., None]


def _emulation_options(command: Command) -> Command:
    """Add what can be wanted of an emulated rig."""
    for option in reversed(
        (
            click.option(
                "--seed",
                type=click.IntRange(min=0),
                help="Of an emulated rig: another number is another rig and noise.  "
                "[default: the configuration's, emulator: seed]",
            ),
            click.option(
                "--truth",
                type=_FILE,
                help="Of an emulated rig: write what it hides to this file, as YAML, or as JSON "
                "where it is named .json.",
            ),
            click.option("--hide", multiple=True, metavar="CAUSE[@PLACE][:SIZE]", help=_HIDE),
            click.option("--noise-free", is_flag=True, help="Emulated sensors without noise."),
            click.option(
                "--soak",
                type=click.FloatRange(-60.0, 60.0),
                default=0.0,
                show_default=True,
                metavar="KELVIN",
                help="Warm the emulated room by so many kelvin and cool it again in the session.",
            ),
        )
    ):
        command = option(command)
    return command


_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(software(), message="%(version)s")
def cli() -> None:
    """What a rig does: record sessions, emulate a rig.

    Example: gyrorigd record --config config/rig.yaml --program config/programs/survey-40.yaml
    """


cli.add_command(halt_command)
cli.add_command(doctor_command)
cli.add_command(recover_command)
for _command in SERVICE_COMMANDS:
    cli.add_command(_command)


@cli.command("record")
@click.option("--config", "config_path", type=_FILE, required=True, help="The rig (YAML).")
@click.option("--program", "program_path", type=_FILE, required=True, help="The motion (YAML).")
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("recordings"),
    show_default=True,
    help="The folder that recordings go to.",
)
@click.option(
    "--home", is_flag=True, help="Home the unit first: both axes sweep their whole range."
)
@click.option(
    "--simulated-time",
    is_flag=True,
    help="Emulated rigs only: faster than time, straight into the recording.",
)
@click.option(
    "--session",
    help="The session's name: letters, digits and dashes, at most 32.  [default: drawn]",
)
@click.option(
    "--rates",
    type=_FILE,
    help="With simulated time: write the gyros' rates without noise here, with what is hidden "
    "and without it (npz).",
)
@_emulation_options
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def record_command(**options: Any) -> None:
    """Record one session: identify the rig, carry out the program, write a recording.

    Nothing moves before every device has said who it is and the whole program fits the
    unit's limits. On any end the unit is halted and the recording closed.

    Example: gyrorigd record --config config/rig.yaml --program config/programs/survey-130.yaml
    --out recordings
    """
    _print(_record(options), options["as_json"])


@cli.command("emulate")
@click.option("--config", "config_path", type=_FILE, required=True, help="The rig (YAML).")
@_emulation_options
@click.option(
    "--from",
    "begin_s",
    type=click.FloatRange(0.0, 1e6),
    default=0.0,
    show_default=True,
    metavar="SECONDS",
    help="When it begins to be used, in s after it was switched on.",
)
@click.option(
    "--until",
    "end_s",
    type=click.FloatRange(1.0, 1e6),
    default=60.0,
    show_default=True,
    metavar="SECONDS",
    help="Until when it will be used, in s: what happens once happens in between.",
)
@click.option(
    "--links",
    type=click.Path(path_type=Path, file_okay=False),
    help="A folder to make links in that bear the ports' names.  [default: none]",
)
@click.option("--json", "as_json", is_flag=True, help="Print the ports as one JSON object.")
@click.option("--until-eof", is_flag=True, help="End when standard input ends.")
def emulate_command(**options: Any) -> None:
    """Open the emulated unit and boards on ptys, print their paths, run until stopped.

    Any program can talk to them. Only ports that read `emulated` in the configuration
    are opened.

    Example: gyrorigd emulate --config config/rig.yaml
    """
    _emulate(options)


@cli.command("causes")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def causes_command(as_json: bool) -> None:
    """List what an emulated rig can hide: causes, places, units, sizes that are drawn.

    Example: gyrorigd causes
    """
    from gyrorig_daemon.emulator.causes import CAUSES  # noqa: PLC0415

    if as_json:
        click.echo(json.dumps({"causes": [cause.to_document() for cause in CAUSES.values()]}))
        return
    for cause in CAUSES.values():
        places = f"@{','.join(cause.places)}" if cause.places else ""
        sizes = ", ".join(f"{size:g}" for size in cause.sizes)
        sizes = sizes or f"{cause.lowest:g} to {cause.highest:g}"
        unit = "" if cause.unit == "1" else f" {cause.unit}"
        click.echo(f"{cause.name}{places}: {cause.size_is}; drawn: {sizes}{unit}")


def _record(options: dict[str, Any]) -> dict[str, Any]:
    config_path, program_path = options["config_path"], options["program_path"]
    config_text, program_text = read_document(config_path), read_document(program_path)
    order = SessionOrder(
        config=parse_rig(config_text, config_path.name, config_path.parent),
        config_text=config_text,
        program=parse_program(program_text, program_path.name),
        program_text=program_text,
        out_dir=options["out"],
        session=_session_name(options["session"]),
        home=options["home"],
    )
    seals: list[str] = []
    with _stop_by_signal() as stop:
        call = record.Call(
            order=order,
            config_path=config_path,
            emulation=_emulation(options, rough_session_s(order.program)),
            host=socket.gethostname(),
            stop=stop,
            progress=_progress if sys.stderr.isatty() else record.no_progress,
            sealed=lambda sha256: _tell_seal(sha256, seals),
        )
        run = record.in_simulated_time if options["simulated_time"] else record.in_real_time
        path = run(call)
    if not options["as_json"]:
        click.echo(str(path))
    return {"recording": str(path)} | ({"seal": seals[0]} if seals else {})


def _emulation(options: dict[str, Any], session_s: tuple[float, float]) -> Emulation:
    return Emulation(
        seed=options["seed"],
        truth=options["truth"],
        rates=options.get("rates"),
        hide=options["hide"],
        noise_free=options["noise_free"],
        soak_k=options["soak"],
        session_s=session_s,
    )


def _tell_seal(sha256: str, told: list[str] | None = None) -> None:
    if told is not None:
        told.append(sha256)
    click.echo(f"sealed until the end, sha256 {sha256}", err=True)


def _session_name(told: str | None) -> str:
    """Return a name that can be part of a file's."""
    try:
        return secrets.token_hex(4) if told is None else BoardId(told)
    except InputError as fault:
        raise UsageError(f"{told!r:.50} is no name for a session", fault.remedy) from fault


def _emulate(options: dict[str, Any]) -> None:
    config = load_rig(options["config_path"])
    ended = threading.Event()
    for number in _SIGNALS:
        signal.signal(number, lambda *_: ended.set())
    if options["until_eof"]:
        threading.Thread(target=_wait_for_eof, args=(ended,), daemon=True).start()

    def announce(ports: Mapping[str, str], seal: str | None) -> None:
        if options["as_json"]:
            more = {} if seal is None else {"seal": seal}
            click.echo(json.dumps({"ports": dict(ports)} | more))
        else:
            for name, path in ports.items():
                click.echo(f"{name}\t{path}")
            if seal is not None:
                _tell_seal(seal)
        sys.stdout.flush()

    begin_s, end_s = options["begin_s"], options["end_s"]
    if end_s <= begin_s:
        raise UsageError(
            f"--until {end_s:g} s is not after --from {begin_s:g} s", "give --until a later time"
        )
    told = _emulation(options, (begin_s, end_s))
    record.emulate(config, told, announce, ended, options["links"])


def _wait_for_eof(ended: threading.Event) -> None:
    # not through sys.stdin: a thread that holds its lock breaks the interpreter's end
    with suppress(OSError):
        while os.read(0, 4096):
            pass
    ended.set()


def _print(result: dict[str, Any], as_json: bool) -> None:
    if as_json:
        click.echo(json.dumps(result))


@contextmanager
def _stop_by_signal() -> Iterator[StopFlag]:
    """Turn the first signal into a request to stop; the unit is halted before the end."""
    stop = StopFlag()

    def request(number: int, frame: FrameType | None) -> None:
        stop.request(signal.Signals(number).name)

    before = {number: signal.signal(number, request) for number in _SIGNALS}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _progress(done: int, total: int) -> None:
    click.echo(f"\rstep {done} of {total} ", nl=done == total, err=True)
