"""Worker pool on other machines: a dask.distributed scheduler, on this machine or behind TLS.

What to use when: `dask_pools` for `--scheduler`. Scheduler and workers unpickle whatever a client
sends, so whoever reaches them can run code on them. Therefore an address that others can reach
without a certificate is refused: it must be loopback, or TLS with a private authority.

The workers read the recordings and write the store by the same paths as the calling machine:
they need the same file system. Start them with one thread and a nanny each, so that a worker
that dies is replaced:

    dask worker tls://head:8786 --nworkers 16 --nthreads 1 --no-dashboard

When a worker dies, the scheduler gives its jobs to another worker, four times by default
(`distributed.scheduler.allowed-failures`, 3), and counts the death against all jobs that waited
there. Therefore a job that the scheduler gives up is repeated once, alone, before it is
quarantined. With that setting at 0, a job is quarantined after it has killed two workers.
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
from gyrorig_solver.fleet.jobs.session_job import run_job_memory_limited
from gyrorig_solver.fleet.jobs.workers import WorkerPool

# A scheduler needs 5 to 6 kB of memory per pending job.
MAX_PENDING_JOBS = 10_000
PENDING_JOBS_PER_THREAD = 4  # so that no worker waits for the network
CONNECT_TIMEOUT_S = 10.0


@dataclass(frozen=True, slots=True)
class TlsCertificates:
    """Files for TLS: the authority's certificate, and our own with its key."""

    authority: Path
    certificate: Path
    key: Path


@contextmanager
def dask_pools(
    address: str, certificates: TlsCertificates | None = None
) -> Iterator[list[WorkerPool]]:
    """Provide one pool for all workers of a scheduler.

    Raises:
        UsageError: the address is open to others, or certificates for TLS are missing.
        BusyError: no scheduler answers, or it has no workers.
    """
    security = _connection_security(address, certificates)
    # A lost scheduler is reported here in one line.
    for name in ("client", "core", "comm"):
        logging.getLogger(f"distributed.{name}").setLevel(logging.CRITICAL)
    try:
        client = Client(  # type: ignore[no-untyped-call] # dask has no types
            address, security=security, timeout=CONNECT_TIMEOUT_S, set_as_default=False
        )
    except (OSError, TimeoutError) as fault:
        raise BusyError(
            f"no scheduler answers at the address {address} ({type(fault).__name__})",
            "start a scheduler with `dask scheduler --host 127.0.0.1 --no-dashboard`",
        ) from fault
    try:
        threads = sum(client.nthreads().values())  # type: ignore[no-untyped-call]
        if not threads:
            raise BusyError(
                f"the scheduler at {address} has no workers",
                f"start a worker with `dask worker {address} --nthreads 1 --no-dashboard`",
            )

        def make() -> Executor:
            executor: Executor = client.get_executor(pure=False)  # type: ignore[no-untyped-call]
            return executor

        capacity = min(MAX_PENDING_JOBS, PENDING_JOBS_PER_THREAD * threads)

        def is_gone() -> bool:
            return client.status not in (
                "running",
                "connecting",
            )  # it has tried for CONNECT_TIMEOUT_S

        yield [
            WorkerPool(
                make,
                capacity=capacity,
                death_exceptions=(KilledWorker,),
                job_function=run_job_memory_limited,
                abandon_executor=_abandon_executor,
                is_lost=is_gone,
            )
        ]
    finally:
        client.close()  # type: ignore[no-untyped-call]


def _abandon_executor(executor: Executor) -> None:
    with contextlib.suppress(Exception):  # the scheduler may be gone
        executor.shutdown(wait=False)  # dask cancels the jobs that are not done


def _connection_security(address: str, certificates: TlsCertificates | None) -> Security | None:
    """Return the security of the connection; None on this machine.

    Raises:
        UsageError: see `dask_pools`.
    """
    parts = urlsplit(address)
    try:
        host, port = parts.hostname or "", parts.port
    except ValueError:
        host, port = "", None
    if parts.scheme not in ("tcp", "tls") or not host or port is None:
        raise UsageError(
            f"the value {address} of --scheduler is not an address of a scheduler",
            "write the address as tls://HOST:8786",
        )
    if parts.scheme == "tls":
        if certificates is None:
            raise UsageError(
                f"the scheduler {address} needs TLS certificates",
                "add the options --tls-ca, --tls-cert and --tls-key",
            )
        return Security(  # type: ignore[no-untyped-call]
            tls_ca_file=str(certificates.authority),
            tls_client_cert=str(certificates.certificate),
            tls_client_key=str(certificates.key),
            require_encryption=True,
        )
    if not _is_loopback(host):
        raise UsageError(
            f"the scheduler {address} is not protected, so everyone who can reach it can run "
            "code on it",
            "use an address that begins with tls://, or a scheduler on 127.0.0.1",
        )
    return None


def _is_loopback(host: str) -> bool:
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
