"""Limits of memory and time for the work on an input file, from the size of the file.

A file of some megabytes can unpack to gigabytes, or describe arrays of terabytes. Readers refuse
what they recognise. These limits hold for everything else: the command ends with the reason, and
the computer and other jobs do not suffer.

The memory of a fit follows from the number of messages and not from the size of the file: its
derivatives are uncompressed, and the search for causes holds several fits at a time.

What to use when: `limit_input` around reading and examining files, `limit_fit_memory` around the
fit of what was read, whose time does not follow from the size of the file.
"""

import contextlib
import os
import resource
import signal
import threading
from collections.abc import Iterable, Iterator
from pathlib import Path

from gyrorig_protocol.errors import InputError

MB = 1_000_000
BASE_MEMORY_BYTES = 400 * MB
MEMORY_PER_INPUT_BYTE = 20
# Of a fit, in addition. A search that ends with eight causes takes 17 kB for each message of a
# recording of 130 s at 100 Hz; a fit without causes takes 6 to 10 kB.
FIT_MEMORY_PER_MESSAGE_BYTES = 30_000
MAX_FIT_MEMORY_BYTES = 8000 * MB  # long recordings are fitted as means
BASE_TIME_S = 30.0  # of the processor
TIME_PER_BYTE_S = 30.0 / (10 * MB)
REPEATED_LIMIT_S = 2.0  # after which a limit that was caught is raised again
MEMORY_VARIABLE = "GYRORIG_MEMORY_MB"  # a larger limit, for a file that a person trusts
# What a process with the libraries has loaded before it reads a file.
_MAX_PROGRAM_BYTES = 150 * MB
_LATER_LIBRARIES_BYTES = 40 * MB  # code and data of libraries that are loaded later
_CGROUP_FOLDER = Path("/sys/fs/cgroup")


def memory_bound_bytes(input_bytes: int) -> int:
    """Return the largest memory of a command for inputs of this size."""
    stated = os.environ.get(MEMORY_VARIABLE, "")
    if stated.isascii() and stated.isdigit():
        return int(stated) * MB
    return BASE_MEMORY_BYTES + MEMORY_PER_INPUT_BYTE * input_bytes


def fit_memory_bound_bytes(input_bytes: int, message_count: int) -> int:
    """Return the largest memory of a fit to inputs of this size with so many messages."""
    bound_bytes = memory_bound_bytes(input_bytes)
    if MEMORY_VARIABLE in os.environ:
        return bound_bytes
    return bound_bytes + min(FIT_MEMORY_PER_MESSAGE_BYTES * message_count, MAX_FIT_MEMORY_BYTES)


def time_bound_s(input_bytes: int) -> float:
    """Return the largest processor time for reading inputs of this size."""
    return BASE_TIME_S + TIME_PER_BYTE_S * input_bytes


def size_of_inputs(paths: Iterable[Path]) -> int:
    """Return the number of bytes in files and folders; what cannot be read counts as empty."""
    total_bytes = 0
    for path in paths:
        with contextlib.suppress(OSError):
            files = path.rglob("*") if path.is_dir() else [path]
            total_bytes += sum(file.stat().st_size for file in files if file.is_file())
    return total_bytes


@contextlib.contextmanager
def limit_input(name: str, input_bytes: int) -> Iterator[None]:
    """Limit memory and processor time while the block runs.

    In other threads than the main thread, nothing is limited: a signal reaches the main thread
    only, and the limit of memory belongs to the whole process.

    Args:
        name: of the input, for the message.
        input_bytes: its size.

    Raises:
        InputError: the block needs more.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    limit_s = time_bound_s(input_bytes)
    has_expired = False

    def limit_error() -> InputError:
        return InputError(
            f"the file {name} needs more than {limit_s:.0f} s of processor time, the limit for a "
            "file of its size, so it is probably damaged or hostile",
            "record or export the data again",
        )

    def end(_signal: int, _frame: object) -> None:
        nonlocal has_expired
        has_expired = True
        raise limit_error()

    with limit_memory_by_size(name, input_bytes):
        previous = signal.signal(signal.SIGPROF, end)
        # Code in the block can catch the error, and try something else: the limit stays.
        signal.setitimer(signal.ITIMER_PROF, limit_s, REPEATED_LIMIT_S)
        try:
            yield
            if has_expired:
                raise limit_error()
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            signal.signal(signal.SIGPROF, previous)


@contextlib.contextmanager
def limit_memory_by_size(name: str, input_bytes: int) -> Iterator[None]:
    """Limit the memory of this process while the block runs, in the main thread.

    Args:
        name: of the input, for the message.
        input_bytes: its size.

    Raises:
        InputError: the block needs more.
    """
    bound_bytes = memory_bound_bytes(input_bytes)
    refusal = InputError(
        f"the file {name} needs more than {bound_bytes // MB} MB of memory, the limit for a "
        "file of its size, so it is probably damaged or hostile",
        f"record or export the data again; if you trust the file, set {MEMORY_VARIABLE} to a "
        "larger number of megabytes",
    )
    with _data_limit(bound_bytes, refusal):
        yield


@contextlib.contextmanager
def limit_fit_memory(name: str, input_bytes: int, message_count: int) -> Iterator[None]:
    """Limit the memory of this process while the block fits a model, in the main thread.

    Args:
        name: of the input, for the message.
        input_bytes: its size.
        message_count: in all its topics.

    Raises:
        InputError: the block needs more.
    """
    bound_bytes = fit_memory_bound_bytes(input_bytes, message_count)
    refusal = InputError(
        f"the fit to {name} needs more than {bound_bytes // MB} MB of memory, the limit for "
        f"{message_count} messages",
        "examine the recording with `gyrorig check`; if you trust the recording, set "
        f"{MEMORY_VARIABLE} to a larger number of megabytes",
    )
    with _data_limit(bound_bytes, refusal):
        yield


def cgroup_memory_bytes() -> int | None:
    """Return the memory that systemd grants this process; None without a limit."""
    limits = []
    with contextlib.suppress(OSError, ValueError):
        for line in Path("/proc/self/cgroup").read_text(encoding="ascii").splitlines():
            if not line.startswith("0::/"):
                continue
            folder = _CGROUP_FOLDER / line.removeprefix("0::/")
            while folder != _CGROUP_FOLDER:
                with contextlib.suppress(OSError, ValueError):  # "max" is no number
                    limits.append(int((folder / "memory.max").read_text(encoding="ascii")))
                folder = folder.parent
    return min(limits, default=None)


@contextlib.contextmanager
def _data_limit(bound_bytes: int, refusal: InputError) -> Iterator[None]:
    """Limit what this process can allocate, so that it stays below a bound, in the main thread.

    RLIMIT_DATA counts private memory that can be written: neither a mapped file nor the code of
    libraries. The memory that the process has at the start, such as the stacks of threads, does
    not count.

    Raises:
        InputError: the refusal, if the block needs more.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    data_bytes, resident_bytes = _memory_in_use()
    program_bytes = min(resident_bytes, _MAX_PROGRAM_BYTES)
    limit_bytes = data_bytes + bound_bytes - program_bytes - _LATER_LIBRARIES_BYTES
    previous = resource.getrlimit(resource.RLIMIT_DATA)
    for limit in previous:
        if limit != resource.RLIM_INFINITY:
            limit_bytes = min(limit_bytes, limit)
    resource.setrlimit(resource.RLIMIT_DATA, (limit_bytes, previous[1]))
    try:
        yield
    except MemoryError as fault:
        raise refusal from fault
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, previous)


def _memory_in_use() -> tuple[int, int]:
    """Return this process's data and resident memory, bytes."""
    fields: dict[str, int] = {}
    status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
    for line in status.splitlines():
        key, _, value = line.partition(":")
        if key in ("VmData", "VmRSS"):
            fields[key] = int(value.split()[0]) * 1024
    return fields["VmData"], fields["VmRSS"]
