"""`gyrorig batch`: a spool of recordings in, calibrations and an index out, every night."""

import os
import shutil
import sys
from collections import Counter
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import Any

import click

from gyrorig_protocol.errors import UsageError
from gyrorig_solver.commands.terminal import IN_PART, Terminal, json_option, version_text
from gyrorig_solver.fleet.batch import Shard, Summary, run_batch
from gyrorig_solver.fleet.lanes import Lane, local_lanes
from gyrorig_solver.fleet.manifest import signer_of
from gyrorig_solver.fleet.task import Settings
from gyrorig_solver.places.choose import PlaceOption
from gyrorig_solver.places.folder import Folder
from gyrorig_solver.places.place import Place

_REASONS_SHOWN = 10
_FILE = click.Path(path_type=Path, dir_okay=False, exists=True)
_RETRIED = ("rejected", "failed", "quarantined")


@click.command("batch")
@click.option(
    "--spool",
    required=True,
    type=PlaceOption(),
    help="The folder, or s3://BUCKET/FOLDER, of recordings, looked at with all below it.",
)
@click.option(
    "--store",
    required=True,
    type=PlaceOption(),
    help="The fleet's store, a folder or s3://BUCKET/FOLDER; made if it is not there.",
)
@click.option(
    "--workers",
    type=click.IntRange(1, 512),
    help="Processes on this machine.  [default: one a core]",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Use the workers of a dask.distributed scheduler in place of this machine's: "
    "tls://HOST:PORT, or tcp://127.0.0.1:PORT. They need the same file system.  [default: none]",
)
@click.option(
    "--tls-ca",
    type=_FILE,
    help="With tls://: the certificate (PEM) of the authority that signed all.",
)
@click.option("--tls-cert", type=_FILE, help="With tls://: this batch's own certificate (PEM).")
@click.option("--tls-key", type=_FILE, help="With tls://: the private key (PEM) of --tls-cert.")
@click.option(
    "--shard",
    metavar="K/N",
    help="Do only the K-th of N parts of the work, K from 1.  [default: all of it]",
)
@click.option(
    "--extend",
    type=click.Choice(["none", "auto"]),
    default="none",
    show_default=True,
    help="auto: search each recording for causes, and fit those that it shows.",
)
@click.option(
    "--retry",
    multiple=True,
    type=click.Choice(_RETRIED),
    help="Do work again that ended so before; can be given several times.  [default: none]",
)
@click.option(
    "--sign",
    type=_FILE,
    help="A private Ed25519 key (PEM) to sign with what is written.  [default: not signed]",
)
@click.option(
    "--deadline",
    type=click.FloatRange(min=1.0),
    default=300.0,
    show_default=True,
    metavar="SECONDS",
    help="How long the work of one session may take, in seconds.",
)
@click.option(
    "--memory",
    type=click.IntRange(min=256),
    default=4096,
    show_default=True,
    metavar="MB",
    help="How much memory one worker may take, in MB.",
)
@json_option
@click.pass_obj
def batch_command(
    terminal: Terminal,
    spool: Place,
    store: Place,
    workers: int | None,
    scheduler: str | None,
    tls_ca: Path | None,
    tls_cert: Path | None,
    tls_key: Path | None,
    shard: str | None,
    extend: str,
    retry: tuple[str, ...],
    sign: Path | None,
    deadline: float,
    memory: int,
) -> int:
    r"""Solve every new recording of a spool; each board gets its next version in the store.

    Every recording ends in exactly one of: ok; rejected, with the reason; failed, with its
    trace kept in the index; quarantined, after it has killed its worker twice. What is done
    is not done again, so a batch may be killed and started again at any moment, and
    several may run on one store at once. Leaves with 5 when something did not end well.

    \b
    Example:
      gyrorig batch --spool recordings --store calibrations
      gyrorig batch --spool recordings --store calibrations --shard 3/16 --workers 1
    """
    settings = Settings(
        solver_version=version_text(),
        extend=() if extend == "none" else (extend,),
        deadline_s=deadline,
        memory_bytes=memory << 20,
    )
    if scheduler is None and (tls_ca or tls_cert or tls_key):
        raise UsageError(
            "--tls-ca, --tls-cert and --tls-key are of a scheduler, and none is named",
            "give --scheduler tls://HOST:8786 too, or leave them out",
        )
    bar, part = _Bar(), _shard(shard)
    signer = None if sign is None else signer_of(sign)
    with ExitStack() as stack:
        if scheduler is None:
            lanes = local_lanes(workers or os.cpu_count() or 1, settings.memory_bytes)
        else:
            lanes = stack.enter_context(_remote(scheduler, workers, tls_ca, tls_cert, tls_key))
            # The workers' own folders are not this one's.
            spool, store = _absolute(spool), _absolute(store)
        stack.callback(bar.end)
        summary = run_batch(
            spool,
            store,
            settings,
            lanes,
            shard=part,
            retry=retry,
            signer=signer,
            progress=bar.show,
        )
    terminal.say(_told(summary, store.text))
    code = IN_PART if summary.in_part else 0
    terminal.emit(_plain(summary, code))
    return code


def _remote(
    address: str,
    workers: int | None,
    authority: Path | None,
    certificate: Path | None,
    key: Path | None,
) -> AbstractContextManager[list[Lane]]:
    """Return the lanes of a scheduler; dask is imported only here.

    Raises:
        UsageError: the words do not go together.
    """
    from gyrorig_solver.fleet.scheduler import Certificates, dask_lanes  # noqa: PLC0415

    if workers is not None:
        raise UsageError(
            "--workers counts processes of this machine, and --scheduler brings its own",
            "leave out --workers",
        )
    if authority and certificate and key:
        return dask_lanes(address, Certificates(authority, certificate, key))
    if authority or certificate or key:
        raise UsageError("--tls-ca, --tls-cert and --tls-key go together", "give all three")
    return dask_lanes(address)


class _Bar:
    """One line on standard error, if that is a terminal: how far, how fast, how long yet."""

    def __init__(self) -> None:
        self._shown = sys.stderr.isatty()

    def show(self, summary: Summary) -> None:
        if not self._shown:
            return
        finished, total = summary.finished + summary.put_off, summary.to_do
        width = max(10, min(40, shutil.get_terminal_size().columns - 60))
        full = width * finished // max(total, 1)
        left = "" if summary.left_s is None else f", {_duration(summary.left_s)} left"
        wrong = finished - summary.ended["ok"]
        click.echo(
            f"\r[{'#' * full}{'.' * (width - full)}] {finished} of {total} sessions, "
            f"{summary.sessions_a_second:.1f} a second{left}"
            f"{f', {wrong} not ok' if wrong else ''}\x1b[K",
            nl=False,
            err=True,
        )

    def end(self) -> None:
        if self._shown:
            click.echo(err=True)


def _shard(text: str | None) -> Shard:
    """Return what `--shard` says.

    Raises:
        UsageError: it is not K/N.
    """
    if text is None:
        return Shard()
    number, _, of = text.partition("/")
    if not (number.isascii() and number.isdigit() and of.isascii() and of.isdigit()):
        raise UsageError(
            f"--shard {text!r:.40} is no part of the work", "write it as K/N, such as 3/16"
        )
    if not 1 <= int(number) <= int(of) <= 1_000_000:
        raise UsageError(
            f"--shard {text[:40]}: there is no part {number[:20]} of {of[:20]}",
            "write it as K/N, K from 1 to N, such as 3/16",
        )
    return Shard(int(number), int(of))


def _told(summary: Summary, store: str) -> str:
    lines = [
        f"{summary.sessions} sessions in {len(summary.spool.recordings)} recordings: "
        f"{summary.done_before} done before, {summary.finished} now"
        + (f", {summary.others} of other batches" if summary.others else ""),
    ]
    if summary.spool.unfinished:
        lines.append(
            f"  {summary.spool.unfinished} recordings are still being written"
            f"{_waiting(summary)}{_left(summary)}"
        )
    for status in ("ok", *_RETRIED):
        if summary.ended[status]:
            boards = f"{summary.boards[status]} boards" if summary.boards[status] else ""
            lines.append(f"  {status:<12} {summary.ended[status]:>7} sessions   {boards}")
    if summary.put_off:
        lines.append(f"  {'put off':<12} {summary.put_off:>7} sessions   {summary.put_off_why}")
    if summary.not_begun:
        lines.append(f"  {'not begun':<12} {summary.not_begun:>7} sessions   given up; start again")
    if summary.unfolded_why:
        lines.append(f"  the index is carried on by the next batch: {summary.unfolded_why}")
    reasons = Counter(f"{row.status}: {row.reason}" for row in summary.wrong)
    for reason, count in reasons.most_common(_REASONS_SHOWN):
        lines.append(f"  {count:>5} x {reason}")
    if len(reasons) > _REASONS_SHOWN:
        lines.append(
            f"  and {len(reasons) - _REASONS_SHOWN} reasons more: gyrorig store ls {store} --wrong"
        )
    lines.append(
        f"  {_duration(summary.elapsed_s)}, {summary.sessions_a_second:.1f} sessions a second; "
        f"the store: {store}"
    )
    return "\n".join(lines)


def _waiting(summary: Summary) -> str:
    """Return how many whole parts are left for the batch that finds their session whole."""
    waiting = summary.spool.waiting
    return f", {waiting} parts of the same sessions wait for them" if waiting else ""


def _left(summary: Summary) -> str:
    """Return what to do about recordings that nobody writes any more."""
    if not summary.spool.left:
        return ""
    return (
        f", {summary.spool.left} of them not touched for a day: gyrorigd recover makes "
        "recordings of them"
    )


def _absolute(place: Place) -> Place:
    return Folder(place.path.resolve()) if isinstance(place, Folder) else place


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.1f} s"
    if seconds < 5400:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"


def _plain(summary: Summary, code: int) -> dict[str, Any]:
    return {
        "sessions": summary.sessions,
        "recordings": len(summary.spool.recordings),
        "unfinished": summary.spool.unfinished,
        "waiting": summary.spool.waiting,
        "left": summary.spool.left,
        "done_before": summary.done_before,
        "others": summary.others,
        "ended": dict(summary.ended),
        "boards": dict(summary.boards),
        "put_off": summary.put_off,
        "put_off_why": summary.put_off_why,
        "not_begun": summary.not_begun,
        "wrong": [
            {"names": row.names, "board": row.board, "status": row.status, "reason": row.reason}
            for row in summary.wrong
        ],
        "elapsed_s": summary.elapsed_s,
        "exit_code": code,
    }
