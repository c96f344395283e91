"""`gyrorig batch`: solve the new recordings of a spool folder into a calibration store."""

import os
import shutil
from collections import Counter
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import Any

import click

from gyrorig_protocol.errors import UsageError
from gyrorig_solver.commands.terminal import (
    PARTIAL,
    SuggestingChoice,
    Terminal,
    choice_option,
    json_option,
    version_text,
)
from gyrorig_solver.commands.unit_prior_option import read_unit_knowledge, unit_prior_option
from gyrorig_solver.fleet.jobs import BatchSummary, SolveSettings, local_pools, run_batch
from gyrorig_solver.fleet.jobs.batch_run import Shard
from gyrorig_solver.fleet.jobs.workers import WorkerPool
from gyrorig_solver.fleet.store import read_signer
from gyrorig_solver.model import plural
from gyrorig_solver.pipeline import AUTO
from gyrorig_solver.storage import Folder, Storage, StorageOption, cgroup_memory_bytes

_REASONS_SHOWN = 10
_EXISTING_FILE = click.Path(path_type=Path, dir_okay=False, exists=True)
_RETRY_STATUSES = ("rejected", "failed", "quarantined")


_UNPROTECTED_SCHEDULER = (
    "Every user of this computer can run programs as the owner of a scheduler without TLS. On a "
    "computer with several users, use an address that begins with tls://."
)


@click.command("batch")
@click.option(
    "--spool",
    required=True,
    type=StorageOption(),
    help="The folder, or s3://BUCKET/FOLDER, of recordings; subfolders are included.",
)
@click.option(
    "--store",
    required=True,
    type=StorageOption(),
    help="The calibration store, a folder or s3://BUCKET/FOLDER; created if it does not exist.",
)
@click.option(
    "--workers",
    type=click.IntRange(1, 512),
    help="Worker processes on this machine.  [default: one per core]",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Use the workers of this dask.distributed scheduler instead of local processes: "
    "tls://HOST:PORT, or tcp://127.0.0.1:PORT. They need the same file system.  [default: none]",
)
@click.option(
    "--tls-ca",
    type=_EXISTING_FILE,
    help=(
        "With tls://: the certificate (PEM) of the authority that signed the other certificates."
    ),
)
@click.option(
    "--tls-cert", type=_EXISTING_FILE, help="With tls://: the certificate (PEM) of this batch."
)
@click.option(
    "--tls-key", type=_EXISTING_FILE, help="With tls://: the private key (PEM) of --tls-cert."
)
@click.option(
    "--shard",
    metavar="K/N",
    help="Do only part K of N of the work, K from 1 to N.  [default: all work]",
)
@choice_option(
    "--extend",
    ["none", "auto"],
    AUTO,
    "auto: search each recording for causes, and fit the causes that are found; "
    "none: only test for causes.",
)
@click.option(
    "--retry",
    multiple=True,
    type=SuggestingChoice(_RETRY_STATUSES),
    help="Repeat work that ended with this status; can be given several times.  [default: none]",
)
@click.option(
    "--sign",
    type=_EXISTING_FILE,
    help="A private Ed25519 key (PEM) that signs the manifests.  [default: not signed]",
)
@click.option(
    "--deadline",
    type=click.FloatRange(1.0, 31_536_000.0),
    default=300.0,
    show_default=True,
    metavar="SECONDS",
    help="Time limit for one session, in seconds.",
)
@click.option(
    "--memory",
    type=click.IntRange(min=256),
    default=4096,
    show_default=True,
    metavar="MB",
    help="Memory limit for one worker, in MB.",
)
@unit_prior_option
@json_option
@click.pass_obj
def batch_command(
    terminal: Terminal,
    spool: Storage,
    store: Storage,
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
    unit_prior: str,
) -> int:
    r"""Solve every new recording in a spool folder and add the calibrations to a store.

    Each session ends with one status. ok: every board has a new version. rejected: the
    recording cannot be solved; the reason is kept. failed: the program failed; the traceback
    is kept. quarantined: it killed its worker twice. Finished work is not repeated. A batch can
    be killed and restarted at any time, and several batches can share one store. Exits with
    status 5 when a session did not end with ok.

    \b
    Example:
      gyrorig batch --spool recordings --store calibrations
      gyrorig batch --spool recordings --store calibrations --shard 3/16 --workers 1
    """
    knowledge = read_unit_knowledge(unit_prior, store)
    settings = SolveSettings(
        solver_version=version_text(),
        extend=() if extend == "none" else (extend,),
        deadline_s=deadline,
        memory_bytes=min(memory << 20, cgroup_memory_bytes() or memory << 20),
        uses_unit_store=knowledge.store is not None,
        unit_document=knowledge.document,
    )
    if scheduler is None and (tls_ca or tls_cert or tls_key):
        raise UsageError(
            "the options --tls-ca, --tls-cert and --tls-key work only with the option --scheduler",
            "add --scheduler tls://HOST:8786, or remove the three options",
        )
    bar, own_shard = _ProgressBar(terminal), _parse_shard(shard)
    signer = None if sign is None else read_signer(sign)
    with ExitStack() as stack:
        if scheduler is None:
            pools = local_pools(workers or os.cpu_count() or 1, settings.memory_bytes)
        else:
            if not scheduler.startswith("tls://"):
                terminal.print_progress(_UNPROTECTED_SCHEDULER)
            pools = stack.enter_context(_dask_pools(scheduler, workers, tls_ca, tls_cert, tls_key))
            # The workers run in other working directories.
            spool, store = _absolute_storage(spool), _absolute_storage(store)
        stack.callback(bar.end)
        summary = run_batch(
            spool,
            store,
            settings,
            pools,
            shard=own_shard,
            retry=retry,
            signer=signer,
            progress=bar.show,
        )
    terminal.print_result(_summary_text(summary, store.location))
    code = PARTIAL if summary.is_partial else 0
    terminal.print_json(_summary_json(summary, code))
    return code


def _dask_pools(
    address: str,
    workers: int | None,
    authority: Path | None,
    certificate: Path | None,
    key: Path | None,
) -> AbstractContextManager[list[WorkerPool]]:
    """Return the worker pool of a dask scheduler; dask is imported only here.

    Raises:
        UsageError: the options contradict each other.
    """
    from gyrorig_solver.fleet.jobs.dask_workers import TlsCertificates, dask_pools  # noqa: PLC0415

    if workers is not None:
        raise UsageError(
            "the options --workers and --scheduler cannot be used together",
            "remove --workers, because the scheduler has its own workers",
        )
    if authority and certificate and key:
        return dask_pools(address, TlsCertificates(authority, certificate, key))
    if authority or certificate or key:
        raise UsageError(
            "the options --tls-ca, --tls-cert and --tls-key must be given together",
            "give all three options",
        )
    return dask_pools(address)


class _ProgressBar:
    """Progress line on a terminal: count, rate, time left, elapsed time."""

    def __init__(self, terminal: Terminal) -> None:
        self._terminal = terminal

    def show(self, summary: BatchSummary) -> None:
        finished, total = summary.finished + summary.deferred, summary.to_do
        width = max(10, min(40, shutil.get_terminal_size().columns - 85))
        full = width * finished // max(total, 1)
        remaining = (
            "" if summary.remaining_s is None else f", {_duration_text(summary.remaining_s)} left"
        )
        not_ok_count = finished - summary.sessions_by_status["ok"]
        self._terminal.show_status(
            f"[{'#' * full}{'.' * (width - full)}] {finished} of {total} sessions, "
            f"{summary.sessions_per_second:.1f} per second{remaining}"
            f"{f', {not_ok_count} not ok' if not_ok_count else ''}"
        )

    def end(self) -> None:
        self._terminal.show_status("")
        self._terminal.erase_elapsed_time()


def _parse_shard(text: str | None) -> Shard:
    """Return the shard that `--shard K/N` names.

    Raises:
        UsageError: the text is not K/N.
    """
    if text is None:
        return Shard()
    number, _, count = text.partition("/")
    if not (number.isascii() and number.isdigit() and count.isascii() and count.isdigit()):
        raise UsageError(
            f"the value {text!r:.40} of --shard does not have the form K/N",
            "write the shard as K/N, for example 3/16",
        )
    if not 1 <= int(number) <= int(count) <= 1_000_000:
        raise UsageError(
            f"the value {text[:40]} of --shard is out of range, because {count[:20]} shards "
            f"have no shard {number[:20]}",
            "write the shard as K/N with K from 1 to N, for example 3/16",
        )
    return Shard(int(number), int(count))


def _summary_text(summary: BatchSummary, store: str) -> str:
    recordings = plural(len(summary.spool.recordings), "recording")
    lines = [
        f"{plural(summary.sessions, 'session')} in {recordings}: "
        f"{summary.done_before} done before, {summary.finished} now"
        + (f", {summary.taken_by_others} of other batches" if summary.taken_by_others else ""),
    ]
    if not summary.spool.recordings and not summary.spool.unfinished:
        lines = [
            f"{summary.spool.storage.location} contains no recordings (*.mcap); "
            "there is nothing to do"
        ]
    if summary.spool.unfinished:
        unfinished = plural(summary.spool.unfinished, "recording is", "recordings are")
        lines.append(
            f"  {unfinished} still being written{_waiting_text(summary)}{_abandoned_text(summary)}"
        )
    for status in ("ok", *_RETRY_STATUSES):
        if summary.sessions_by_status[status]:
            boards = summary.boards_by_status[status]
            sessions = summary.sessions_by_status[status]
            detail = plural(boards, "board") if boards else ""
            lines.append(_status_line(status, sessions, detail))
    if summary.deferred:
        lines.append(_status_line("deferred", summary.deferred, summary.deferral_reason))
    if summary.not_started:
        advice = "the batch stopped early; run it again"
        lines.append(_status_line("not started", summary.not_started, advice))
    if summary.unmerged_reason:
        lines.append(f"  the next batch will update the index: {summary.unmerged_reason}")
    lines += [f"  ! {text}" for text in summary.joint_fit_failures]
    reasons = Counter(f"{row.status}: {row.reason}" for row in summary.unsuccessful_rows)
    for reason, count in reasons.most_common(_REASONS_SHOWN):
        lines.append(f"  {count:>5} x {reason}")
    if len(reasons) > _REASONS_SHOWN:
        more = plural(len(reasons) - _REASONS_SHOWN, "more reason")
        lines.append(f"  and {more}: gyrorig store ls {store} --wrong")
    lines.append(
        f"  {_duration_text(summary.elapsed_s)}, {summary.sessions_per_second:.1f} sessions per "
        f"second; store: {store}"
    )
    return "\n".join(lines)


def _status_line(status: str, sessions: int, detail: str) -> str:
    noun = "session " if sessions == 1 else "sessions"
    return f"  {status:<12} {sessions:>7} {noun}   {detail}".rstrip()


def _waiting_text(summary: BatchSummary) -> str:
    waiting = summary.spool.waiting_parts
    noun = "finished part of a session waits" if waiting == 1 else "finished parts of sessions wait"
    return f", {waiting} {noun} for them" if waiting else ""


def _abandoned_text(summary: BatchSummary) -> str:
    if not summary.spool.abandoned:
        return ""
    return (
        f", {summary.spool.abandoned} of them not changed for a day; run `gyrorigd recover` to "
        "finish them"
    )


def _absolute_storage(storage: Storage) -> Storage:
    return Folder(storage.path.resolve()) if isinstance(storage, Folder) else storage


def _duration_text(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.1f} s"
    if seconds < 5400:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"


def _summary_json(summary: BatchSummary, code: int) -> dict[str, Any]:
    return {
        "sessions": summary.sessions,
        "recordings": len(summary.spool.recordings),
        "unfinished": summary.spool.unfinished,
        "waiting": summary.spool.waiting_parts,
        "left": summary.spool.abandoned,
        "done_before": summary.done_before,
        "others": summary.taken_by_others,
        "ended": dict(summary.sessions_by_status),
        "boards": dict(summary.boards_by_status),
        "put_off": summary.deferred,
        "put_off_why": summary.deferral_reason,
        "not_begun": summary.not_started,
        "wrong": [
            {"names": row.names, "board": row.board, "status": row.status, "reason": row.reason}
            for row in summary.unsuccessful_rows
        ],
        **({"joint_fit_failures": failures} if (failures := summary.joint_fit_failures) else {}),
        "elapsed_s": summary.elapsed_s,
        "exit_code": code,
    }
