"""The commands of the service: `run`, `enqueue`, `status`, `clear`, `stop-motion`, `reload`."""

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
from gyrorig_daemon.live import DEFAULT as LIVE_DEFAULT
from gyrorig_daemon.service import wire
from gyrorig_daemon.service.client import ask, listen
from gyrorig_daemon.service.jobs import put
from gyrorig_daemon.service.state import DEFAULT as DEFAULT_STATE
from gyrorig_daemon.service.watch import picture

_FILE = click.Path(path_type=Path, dir_okay=False)
_FOLDER = click.Path(path_type=Path, file_okay=False)


def _default_state() -> Path:
    return Path(os.environ.get("STATE_DIRECTORY", "").split(":")[0] or DEFAULT_STATE)


def _default_socket() -> Path:
    folder = os.environ.get("RUNTIME_DIRECTORY", "").split(":")[0]
    return Path(folder) / wire.SOCKET_NAME if folder else Path(wire.DEFAULT_SOCKET)


def _default_metrics() -> Path | None:
    folder = os.environ.get("RUNTIME_DIRECTORY", "").split(":")[0]
    return Path(folder) / "metrics" if folder else None


_state = click.option(
    "--state",
    type=_FOLDER,
    default=_default_state,
    show_default=f"$STATE_DIRECTORY or {DEFAULT_STATE}",
    help="The daemon's folder: recordings, queue, calibrations.",
)
_socket = click.option(
    "--socket",
    "socket_path",
    type=_FILE,
    default=_default_socket,
    show_default=f"$RUNTIME_DIRECTORY/{wire.SOCKET_NAME} or {wire.DEFAULT_SOCKET}",
    help="The socket at which the daemon is asked.",
)
_json = click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")


@click.command("run")
@click.option("--config", "config_path", type=_FILE, required=True, help="The rig (YAML).")
@_state
@_socket
@click.option(
    "--live",
    is_flag=False,
    flag_value=LIVE_DEFAULT,
    metavar="[HOST:PORT]",
    help=f"Show it in Foxglove while it happens, at {LIVE_DEFAULT} if nothing else is said.  "
    "[default: not shown]",
)
@click.option(
    "--metrics",
    type=_FOLDER,
    default=_default_metrics,
    show_default="$RUNTIME_DIRECTORY/metrics, else metrics in --state",
    help="Where gyrorig.prom goes, for Prometheus; best not on the disk of the recordings.",
)
@click.option("--check", is_flag=True, help="Only say whether the configuration can be used.")
def run_command(
    config_path: Path,
    state: Path,
    socket_path: Path,
    live: str | None,
    metrics: Path | None,
    check: bool,
) -> None:
    """Serve a rig until stopped: sessions from the queue and the schedule, for months.

    Halts the unit before anything else; waits for ports that are not there. Told to stop
    (SIGTERM, SIGINT) it halts the unit, closes the recording and ends. SIGHUP reads the
    configuration again.

    Example: gyrorigd run --config config/rig.yaml --state rig --socket rig/sock
    """
    from gyrorig_daemon.service.notify import Notifier  # noqa: PLC0415 - of `run` alone
    from gyrorig_daemon.service.orders import Orders  # noqa: PLC0415
    from gyrorig_daemon.service.start import Call, Service, read_config  # noqa: PLC0415

    if check:
        rig = read_config(config_path).config
        click.echo(f"{config_path}: rig {rig.rig}, {len(rig.boards)} boards: can be used")
        return
    orders = Orders()
    with _signals(orders):
        call = Call(config_path, state, socket_path, live, metrics)
        Service(call, orders, Notifier.from_environment()).run()


@click.command("enqueue")
@click.option("--program", "program_path", type=_FILE, required=True, help="The motion (YAML).")
@click.option(
    "--session",
    help="The session's name: letters, digits and dashes, at most 32.  [default: drawn]",
)
@click.option("--home", is_flag=True, help="Home the unit first: both axes sweep their range.")
@_state
@_json
def enqueue_command(
    program_path: Path, session: str | None, home: bool, state: Path, as_json: bool
) -> None:
    """Hand a session in: the daemon carries it out when nothing stands against it.

    The program is copied: later changes of its file do not matter.

    Example: gyrorigd enqueue --program config/programs/survey-130.yaml
    """
    path = put(state / "queue", read_document(program_path), program_path.name, session, home)
    click.echo(json.dumps({"job": path.stem, "file": str(path)}) if as_json else path.stem)


@click.command("status")
@_socket
@click.option("--once", is_flag=True, help="Print once, also in a terminal.")
@_json
def status_command(socket_path: Path, once: bool, as_json: bool) -> None:
    """Show what a running daemon does: live in a terminal, else once.

    Example: gyrorigd status
    """
    if as_json:
        click.echo(json.dumps(ask(socket_path, "status")["status"]))
    elif once or not sys.stdout.isatty():
        click.echo(picture(ask(socket_path, "status")["status"]))
    else:
        for answer in listen(socket_path, "watch"):
            click.echo("\x1b[H\x1b[2J" + picture(answer["status"]))


@click.command("clear")
@_socket
@_json
def clear_command(socket_path: Path, as_json: bool) -> None:
    """Let a rig move again after a fault or a halt: you have looked at it.

    For root and the daemon's own user.

    Example: sudo -u gyrorig gyrorigd clear
    """
    _order(socket_path, "clear", as_json)


@click.command("stop-motion")
@_socket
@_json
def stop_motion_command(socket_path: Path, as_json: bool) -> None:
    """Have the running daemon halt the unit and hold it until `clear`.

    `gyrorigd halt` does it without a daemon.

    Example: gyrorigd stop-motion
    """
    _order(socket_path, "halt", as_json)


@click.command("reload")
@_socket
@_json
def reload_command(socket_path: Path, as_json: bool) -> None:
    """Have the running daemon read its configuration again; a broken one is not used.

    For root and the daemon's own user. It says what came of it in its log.

    Example: sudo -u gyrorig gyrorigd reload
    """
    _order(socket_path, "reload", as_json)


COMMANDS: tuple[click.Command, ...] = (
    run_command,
    enqueue_command,
    status_command,
    clear_command,
    stop_motion_command,
    reload_command,
)


def _order(socket_path: Path, command: str, as_json: bool) -> None:
    answer: dict[str, Any] = ask(socket_path, command)
    said = str(answer.get("said", "done"))
    click.echo(json.dumps({"said": said}) if as_json else said)


@contextmanager
def _signals(orders: Any) -> Iterator[None]:
    """Turn signals into orders; the pump's thread acts on them."""

    def end(number: int, frame: FrameType | None) -> None:
        orders.ask_to_end(signal.Signals(number).name)

    def reload(number: int, frame: FrameType | None) -> None:
        orders.reload.set()

    wanted = {signal.SIGTERM: end, signal.SIGINT: end, signal.SIGHUP: reload}
    before = {number: signal.signal(number, handler) for number, handler in wanted.items()}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
