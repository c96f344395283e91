"""Commands of the service: `run`, `enqueue`, `status`, `clear`, `stop-motion`, `reload`."""

import json
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import click

from gyrorig_daemon.config import read_document
from gyrorig_daemon.links.ports.halt_pipe import HaltPipe
from gyrorig_daemon.links.pump import StopFlag
from gyrorig_daemon.live.foxglove_view import DEFAULT_ADDRESS as LIVE_DEFAULT
from gyrorig_daemon.service.jobs import (
    DEFAULT_MINUTES,
    MAX_MINUTES,
    MAX_ROUNDS,
    UntilNamed,
    enqueue_job,
)
from gyrorig_daemon.service.service_client import send_command, stream_responses
from gyrorig_daemon.service.service_protocol import DEFAULT_SOCKET, SOCKET_NAME
from gyrorig_daemon.service.state_folder import DEFAULT_STATE_FOLDER as DEFAULT_STATE
from gyrorig_daemon.service.state_folder import is_in_use
from gyrorig_daemon.service.status_screen import render_status
from gyrorig_daemon.session.line_writer import escape_controls
from gyrorig_protocol.errors import MachineError, sentence

HALTING_SIGNALS = frozenset({signal.SIGTERM, signal.SIGINT})
_FILE_PATH = click.Path(path_type=Path, dir_okay=False)
_FOLDER_PATH = click.Path(path_type=Path, file_okay=False)


def _default_state() -> Path:
    return Path(os.environ.get("STATE_DIRECTORY", "").split(":")[0] or DEFAULT_STATE)


def _default_socket() -> Path:
    folder = os.environ.get("RUNTIME_DIRECTORY", "").split(":")[0]
    return Path(folder) / SOCKET_NAME if folder else Path(DEFAULT_SOCKET)


def _default_metrics() -> Path | None:
    folder = os.environ.get("RUNTIME_DIRECTORY", "").split(":")[0]
    return Path(folder) / "metrics" if folder else None


_state_option = click.option(
    "--state",
    type=_FOLDER_PATH,
    default=_default_state,
    show_default=f"$STATE_DIRECTORY or {DEFAULT_STATE}",
    help="The state folder of the daemon, with recordings, queue and calibrations.",
)
_socket_option = click.option(
    "--socket",
    "socket_path",
    type=_FILE_PATH,
    default=_default_socket,
    show_default=f"$RUNTIME_DIRECTORY/{SOCKET_NAME} or {DEFAULT_SOCKET}",
    help="The socket of the daemon.",
)
_json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")


@click.command("run", short_help="Serve a rig until stopped.")
@click.option(
    "--config", "config_path", type=_FILE_PATH, required=True, help="The rig file (YAML)."
)
@_state_option
@_socket_option
@click.option(
    "--live",
    is_flag=False,
    flag_value=LIVE_DEFAULT,
    metavar="[HOST:PORT]",
    help=f"Serve a live view for Foxglove, by default at {LIVE_DEFAULT}.  [default: no live view]",
)
@click.option(
    "--metrics",
    type=_FOLDER_PATH,
    default=_default_metrics,
    show_default="$RUNTIME_DIRECTORY/metrics, else metrics in --state",
    help="Folder for the Prometheus file gyrorig.prom, best not on the disk of the recordings.",
)
@click.option("--check", is_flag=True, help="Only validate the rig file.")
def run_command(
    config_path: Path,
    state: Path,
    socket_path: Path,
    live: str | None,
    metrics: Path | None,
    check: bool,
) -> None:
    """Run a rig as a service: sessions from the queue and the schedule.

    The service halts the unit first, and waits for ports that are missing. On SIGTERM or SIGINT
    it halts the unit, closes the recording and exits. On SIGHUP it reads the configuration again.

    Example: gyrorigd run --config config/rig.yaml --state rig --socket rig/sock
    """
    from gyrorig_daemon.service.service_context import OperatorRequests  # noqa: PLC0415
    from gyrorig_daemon.service.service_process import ServiceOptions, ServiceProcess, load_config  # noqa: PLC0415
    from gyrorig_daemon.service.systemd_notifier import SystemdNotifier  # noqa: PLC0415 - for `run` only

    if check:
        rig = load_config(config_path).config
        text = (
            f"{config_path}: the configuration is valid (rig {rig.rig}, {len(rig.boards)} boards)"
        )
        click.echo(escape_controls(text))
        return
    with HaltPipe(HALTING_SIGNALS) as halt_pipe:
        requests = OperatorRequests(StopFlag(halt_pipe))
        with _route_signals(requests):
            options = ServiceOptions(config_path, state, socket_path, live, metrics)
            ServiceProcess(options, requests, SystemdNotifier.from_environment()).run()


@click.command("enqueue", short_help="Add a session to the queue.")
@click.option(
    "--program", "program_path", type=_FILE_PATH, required=True, help=("The motion program (YAML).")
)
@click.option(
    "--session",
    help="Name of the session: at most 32 letters, digits and dashes.  [default: random]",
)
@click.option(
    "--home", is_flag=True, help="Home the unit first: both axes sweep their whole range."
)
@click.option(
    "--until-named",
    is_flag=True,
    help="Explain the recording, and record what `gyrorig explain` proposes, until every cause "
    "has one name. On a real unit, the rig file must permit it.",
)
@click.option(
    "--minutes",
    type=click.FloatRange(1.0, MAX_MINUTES),
    default=DEFAULT_MINUTES,
    show_default=True,
    help="With --until-named: no session begins that would end later.",
)
@click.option(
    "--rounds",
    type=click.IntRange(1, MAX_ROUNDS),
    default=UntilNamed().rounds,
    show_default=True,
    help="With --until-named: the largest number of sessions.",
)
@click.option(
    "--next-seconds",
    type=click.FloatRange(1.0, 3_600.0),
    default=UntilNamed().next_seconds,
    show_default=True,
    help="With --until-named: the longest motion program that may be proposed.",
)
@_state_option
@_json_option
def enqueue_command(
    program_path: Path,
    session: str | None,
    home: bool,
    until_named: bool,
    minutes: float,
    rounds: int,
    next_seconds: float,
    state: Path,
    as_json: bool,
) -> None:
    """Add a session to the queue. The daemon runs it as soon as the rig is ready.

    The program is copied; later changes of its file have no effect.

    Example: gyrorigd enqueue --program config/programs/survey-130.yaml
    """
    limits = UntilNamed(minutes, rounds, next_seconds) if until_named else None
    program = read_document(program_path)
    no_daemon = "" if is_in_use(state) else f"no daemon is running with the state folder {state}"
    try:
        path = enqueue_job(state / "queue", program, program_path.name, session, home, limits)
    except MachineError as error:
        if not no_daemon:
            raise
        raise MachineError(f"{error.problem}, and {no_daemon}", error.remedy) from error
    click.echo(json.dumps({"job": path.stem, "file": str(path)}) if as_json else path.stem)
    if no_daemon:
        click.echo(
            f"{escape_controls(sentence(no_daemon))} The job starts when you start the daemon "
            "with `gyrorigd run` or `systemctl start gyrorigd`.",
            err=True,
        )


@click.command("status", short_help="Show what a running daemon does.")
@_socket_option
@click.option("--once", is_flag=True, help="Print once, also in a terminal.")
@_json_option
def status_command(socket_path: Path, once: bool, as_json: bool) -> None:
    """Show the state of a running daemon: live in a terminal, otherwise once.

    Example: gyrorigd status
    """
    if as_json:
        click.echo(json.dumps(send_command(socket_path, "status")["status"]))
    elif once or not sys.stdout.isatty():
        click.echo(render_status(send_command(socket_path, "status")["status"]))
    else:
        for response in stream_responses(socket_path, "watch"):
            click.echo("\x1b[H\x1b[2J" + render_status(response["status"]))


@click.command("clear", short_help="Allow motion again after a fault or a halt.")
@_socket_option
@_json_option
def clear_command(socket_path: Path, as_json: bool) -> None:
    """Release the motion lock after a fault or a halt. Check the rig before.

    For root and the daemon's own user.

    Example: sudo -u gyrorig gyrorigd clear
    """
    _send_and_print(socket_path, "clear", as_json)


@click.command("stop-motion", short_help="Halt the unit, and lock it until `clear`.")
@_socket_option
@_json_option
def stop_motion_command(socket_path: Path, as_json: bool) -> None:
    """Stop the unit through the running daemon, and lock motion until `clear`.

    `gyrorigd halt` stops it without a daemon.

    Example: gyrorigd stop-motion
    """
    _send_and_print(socket_path, "halt", as_json)


@click.command("reload", short_help="Read the configuration again.")
@_socket_option
@_json_option
def reload_command(socket_path: Path, as_json: bool) -> None:
    """Let the running daemon read its configuration again; an invalid one is rejected.

    For root and the daemon's own user. The result is in the daemon's log.

    Example: sudo -u gyrorig gyrorigd reload
    """
    _send_and_print(socket_path, "reload", as_json)


COMMANDS: tuple[click.Command, ...] = (
    run_command,
    enqueue_command,
    status_command,
    clear_command,
    stop_motion_command,
    reload_command,
)


def _send_and_print(socket_path: Path, command: str, as_json: bool) -> None:
    response: dict[str, Any] = send_command(socket_path, command)
    message = str(response.get("said", "done"))
    click.echo(json.dumps({"said": message}) if as_json else escape_controls(message))


@contextmanager
def _route_signals(requests: Any) -> Iterator[None]:
    """Turn signals into requests, which the pump's thread carries out."""

    def request_termination(number: int, frame: FrameType | None) -> None:
        requests.request_termination(signal.Signals(number).name)

    def reload(number: int, frame: FrameType | None) -> None:
        requests.reload.set()

    handlers = {
        signal.SIGTERM: request_termination,
        signal.SIGINT: request_termination,
        signal.SIGHUP: reload,
    }
    previous_handlers = {
        number: signal.signal(number, handler) for number, handler in handlers.items()
    }
    requests.stop.halt_pipe.catch_signals()
    try:
        yield
    finally:
        for number, handler in previous_handlers.items():
            signal.signal(number, handler)
