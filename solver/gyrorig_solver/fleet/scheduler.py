"""Lanes on other machines: a dask.distributed scheduler, on this machine or behind TLS.

What to use when: `dask_lanes` for `--scheduler`. Scheduler and workers unpickle whatever a
client sends them (reference: reliability.md section 6), so an address that others can
reach without a certificate is refused: loopback, or TLS with an authority of one's own.

The workers read the recordings and write the store by the same paths as the machine that
calls: they need the same file system. Start them with one thread and a nanny each, so that
a worker that dies is replaced:

    dask worker tls://head:8786 --nworkers 16 --nthreads 1 --no-dashboard

A scheduler gives work whose worker died to another one by itself, four times as it is set
(`distributed.scheduler.allowed-failures`, 3), and counts a death against all that waited on
that worker. So what it gives up is tried once more alone before it is quarantined. With that
setting at 0 it is quarantined after it has killed two.
"""

import contextlib
import ipaddress
import logging
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from distributed import Client, KilledWorker
from distributed.security import Security

from gyrorig_protocol.errors import BusyError, UsageError
from gyrorig_solver.fleet.lanes import Lane
from gyrorig_solver.fleet.task import carry_out_within

# 1 000 000 pending pieces would take 5 to 6 GB in the scheduler (reliability.md section 5).
MOST_PENDING = 10_000
PENDING_A_THREAD = 4  # so that no worker waits for the way here and back
CONNECT_S = 10.0


@dataclass(frozen=True, slots=True)
class Certificates:
    """What TLS needs: the authority's certificate, and one's own with its key."""

    authority: Path
    certificate: Path
    key: Path


@contextmanager
def dask_lanes(address: str, certificates: Certificates | None = None) -> Iterator[list[Lane]]:
    """Give one lane that holds work for all of a scheduler's workers.

    Args:
        address: `tls://HOST:PORT`, or `tcp://127.0.0.1:PORT`.
        certificates: for TLS.

    Raises:
        UsageError: the address is open to others, or TLS lacks its certificates.
        BusyError: no scheduler answers, or it has no workers.
    """
    security = _security(address, certificates)
    # What it says of a lost scheduler is said here in one line.
    for name in ("client", "core", "comm"):
        logging.getLogger(f"distributed.{name}").setLevel(logging.CRITICAL)
    try:
        client = Client(  # type: ignore[no-untyped-call] # dask has no types
            address, security=security, timeout=CONNECT_S, set_as_default=False
        )
    except (OSError, TimeoutError) as fault:
        raise BusyError(
            f"no scheduler answers at {address} ({type(fault).__name__})",
            "start one with: dask scheduler --host 127.0.0.1 --no-dashboard",
        ) from fault
    try:
        threads = sum(client.nthreads().values())  # type: ignore[no-untyped-call]
        if not threads:
            raise BusyError(
                f"the scheduler at {address} has no workers",
                f"start one with: dask worker {address} --nthreads 1 --no-dashboard",
            )

        def make() -> Executor:
            executor: Executor = client.get_executor(pure=False)  # type: ignore[no-untyped-call]
            return executor

        holds = min(MOST_PENDING, PENDING_A_THREAD * threads)

        def is_gone() -> bool:
            return client.status not in ("running", "connecting")  # it has tried CONNECT_S

        yield [
            Lane(
                make,
                holds=holds,
                deaths=(KilledWorker,),
                work=carry_out_within,
                forsake=_cancel,
                is_gone=is_gone,
            )
        ]
    finally:
        client.close()  # type: ignore[no-untyped-call]


def _cancel(executor: Executor) -> None:
    with contextlib.suppress(Exception):  # of a scheduler that is gone
        executor.shutdown(wait=False)  # dask's cancels what it has not done


def _security(address: str, certificates: Certificates | None) -> Security | None:
    """Return what the connection is secured by; None on this machine.

    Raises:
        UsageError: see `dask_lanes`.
    """
    parts = urlsplit(address)
    try:
        host, port = parts.hostname or "", parts.port
    except ValueError:
        host, port = "", None
    if parts.scheme not in ("tcp", "tls") or not host or port is None:
        raise UsageError(f"{address} is no scheduler's address", "write it as tls://HOST:8786")
    if parts.scheme == "tls":
        if certificates is None:
            raise UsageError(
                f"{address} needs certificates", "name them with --tls-ca, --tls-cert, --tls-key"
            )
        return Security(  # type: ignore[no-untyped-call]
            tls_ca_file=str(certificates.authority),
            tls_client_cert=str(certificates.certificate),
            tls_client_key=str(certificates.key),
            require_encryption=True,
        )
    if not _is_loopback(host):
        raise UsageError(
            f"{address} is open: whoever reaches a scheduler runs programs on it",
            "use tls://, or a scheduler on 127.0.0.1",
        )
    return None


def _is_loopback(host: str) -> bool:
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
