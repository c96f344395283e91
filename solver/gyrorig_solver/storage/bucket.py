"""A bucket of an object store, `s3://BUCKET/PREFIX`, as a storage, through fsspec and s3fs.

What to use when: through `location.storage_at`. Address and credentials are configured as for
every S3 client: `AWS_ACCESS_KEY_ID`, `AWS_PROFILE`, `AWS_ENDPOINT_URL` and the files in `~/.aws`.
This program neither passes nor stores them.

Theory of operation: a put with `If-None-Match: *` succeeds for exactly one of several programs.
Its answer can be lost on the way; the retry then finds the program's own object. Therefore the
object is read after every failed put: if it has our bytes, our put succeeded.
"""

import asyncio
import contextlib
import hashlib
import os
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path, PurePosixPath
from typing import Any

from gyrorig_protocol.atomic_files import write_atomically
from gyrorig_protocol.errors import InputError, MachineError, UsageError
from gyrorig_solver.storage.storage_protocol import StorageEntry

CONNECT_TIMEOUT_S, READ_TIMEOUT_S = 5, 60
PROTOCOLS = ("s3", "memory")  # memory: of one process; for tests
_MAX_ATTEMPTS = 3
_MAX_REMOVED_PER_CALL = 1_000  # the most that S3 takes
_file_systems: dict[str, Any] = {}  # one connection per process and protocol
# What a request can raise; botocore's exceptions are added when it is loaded.
_STORAGE_EXCEPTIONS: tuple[type[BaseException], ...] = (OSError, asyncio.TimeoutError)


@dataclass(frozen=True, slots=True)
class Bucket:
    """All objects below one prefix."""

    protocol: str
    prefix: str  # bucket and folder, without a slash at the end

    @property
    def location(self) -> str:
        """See `Storage`."""
        return f"{self.protocol}://{self.prefix}"

    def read(self, name: str) -> bytes | None:
        """See `Storage`."""
        with self._report_errors(f"read {self.location}/{name}"):
            try:
                data: bytes = _file_system(self.protocol).cat_file(f"{self.prefix}/{name}")
            except FileNotFoundError:
                return None
            return data

    def write(self, name: str, data: bytes) -> None:
        """See `Storage`."""
        with self._report_errors(f"write {self.location}/{name}"):
            _file_system(self.protocol).pipe_file(f"{self.prefix}/{name}", data)

    def write_new(self, name: str, data: bytes) -> bool:
        """See `Storage`."""
        path = f"{self.prefix}/{name}"
        for attempts_left in reversed(range(_MAX_ATTEMPTS)):
            try:
                _file_system(self.protocol).pipe_file(path, data, mode="create")
            except _STORAGE_EXCEPTIONS as fault:
                # The name is taken, perhaps by our own earlier attempt, or the store refused.
                present = self.read(name)
                if present is not None:
                    return present == data
                if not attempts_left:
                    raise self._machine_error(f"write {self.location}/{name}", fault) from fault
            else:
                return True
        return False

    def remove(self, names: Iterable[str]) -> None:
        """See `Storage`."""
        paths = [f"{self.prefix}/{name}" for name in names]
        with self._report_errors(f"remove files from {self.location}"):
            file_system = _file_system(self.protocol)
            for start in range(0, len(paths), _MAX_REMOVED_PER_CALL):
                batch = paths[start : start + _MAX_REMOVED_PER_CALL]
                try:
                    file_system.rm(batch)
                except FileNotFoundError:  # unlike S3: one missing object stops the removal
                    for path in batch:
                        with contextlib.suppress(FileNotFoundError):
                            file_system.rm(path)

    def exists(self) -> bool:
        """Return whether the bucket exists; a prefix in it exists as soon as it has an object.

        Raises:
            MachineError: the bucket does not answer, or refuses.
        """
        with self._report_errors(f"find {self.location}"):
            try:
                return bool(_file_system(self.protocol).exists(self.prefix.partition("/")[0]))
            except FileNotFoundError:
                return False

    def list_files(self, folder: str = "") -> Iterator[StorageEntry]:
        """See `Storage`."""
        start = f"{self.prefix}/{folder}".rstrip("/")
        with self._report_errors(f"list the files in {self.location}/{folder}"):
            file_system = _file_system(self.protocol)
            try:
                objects = file_system.find(start, detail=True)
            except FileNotFoundError:
                objects = {}
        for path in sorted(objects):
            details = objects[path]
            changed = details.get("LastModified") or details.get("created")
            change_tag = str(details.get("ETag") or changed)
            relative_name = path.lstrip("/").removeprefix(self.prefix).lstrip("/")
            yield StorageEntry(
                relative_name, int(details.get("size") or 0), change_tag, _unix_seconds(changed)
            )

    def cache_folder(self) -> Path:
        """See `Storage`."""
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        folder = base / "gyrorig" / hashlib.sha256(self.location.encode()).hexdigest()[:16]
        with _report_cache_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
        return folder

    def cached_copy(self, name: str) -> Path:
        """See `Storage`."""
        copy = self.cache_folder() / PurePosixPath(name).name
        if not copy.is_file():
            with self.local_copy(name) as fetched, _report_cache_errors(copy):
                write_atomically(copy, fetched.read_bytes(), durable=False)
        return copy

    @contextlib.contextmanager
    def local_copy(self, name: str) -> Iterator[Path]:
        """See `Storage`."""
        with tempfile.TemporaryDirectory(prefix="gyrorig-") as folder:
            path = Path(folder) / PurePosixPath(name).name
            with self._report_errors(f"read {self.location}/{name}"):
                try:
                    _file_system(self.protocol).get_file(f"{self.prefix}/{name}", str(path))
                except FileNotFoundError as fault:
                    raise InputError(
                        f"the file {self.location}/{name} was removed while the program ran",
                        "run the command again",
                    ) from fault
            yield path

    @contextlib.contextmanager
    def _report_errors(self, operation: str) -> Iterator[None]:
        """Turn errors of the object store into a MachineError."""
        try:
            yield
        except _STORAGE_EXCEPTIONS as fault:
            raise self._machine_error(operation, fault) from fault

    def _machine_error(self, operation: str, fault: BaseException) -> MachineError:
        reason = " ".join(str(fault).split())[:160] or type(fault).__name__
        return MachineError(
            f"the program cannot {operation} ({reason})",
            "check the name of the bucket, the network, and the credentials "
            "(AWS_ENDPOINT_URL, AWS_PROFILE)",
        )


@contextlib.contextmanager
def _report_cache_errors(path: Path) -> Iterator[None]:
    """Turn errors of the disk into a MachineError that names the file."""
    try:
        yield
    except OSError as fault:
        raise MachineError(
            f"the file or folder {path} in the cache cannot be written ({fault.strerror})",
            "free some disk space, or set XDG_CACHE_HOME to a folder that you can write",
        ) from fault


def open_bucket(location: str) -> Bucket:
    """Return the bucket of `s3://BUCKET/PREFIX`.

    Raises:
        UsageError: the URL has another scheme or no bucket, or s3fs is not installed.
    """
    protocol, _, rest = location.partition("://")
    if protocol not in PROTOCOLS:
        raise UsageError(
            f"the location {location} is neither a folder nor a bucket",
            "give a folder, or a bucket in the form s3://BUCKET/FOLDER",
        )
    prefix = rest.strip("/")
    if not prefix or ".." in prefix.split("/"):
        raise UsageError(
            f"the location {location} does not contain the name of a bucket",
            "write the location as s3://BUCKET/FOLDER",
        )
    try:
        _file_system(protocol)
    except ImportError as fault:
        raise UsageError(
            f"the location {location} needs the package s3fs, which is not installed",
            "run `pip install 'gyrorig[fleet]'`",
        ) from fault
    return Bucket(protocol, prefix)


def _load_storage_exceptions() -> tuple[type[BaseException], ...]:
    """Return the exceptions of the object store's library."""
    try:
        from botocore.exceptions import (  # type: ignore[import-untyped] # noqa: PLC0415
            BotoCoreError,
            ClientError,
        )
    except ImportError:
        return (OSError, asyncio.TimeoutError)
    return (OSError, asyncio.TimeoutError, BotoCoreError, ClientError)


def _file_system(protocol: str) -> Any:
    """Return this process's connection to an object store, opened at the first use."""
    global _STORAGE_EXCEPTIONS  # noqa: PLW0603 - botocore takes a second to load
    if protocol not in _file_systems:
        import fsspec  # type: ignore[import-untyped] # noqa: PLC0415

        options: dict[str, Any] = {}
        if protocol == "s3":
            limits = {"connect_timeout": CONNECT_TIMEOUT_S, "read_timeout": READ_TIMEOUT_S}
            options = {
                "use_listings_cache": False,  # other programs write too
                "config_kwargs": {**limits, "retries": {"mode": "standard", "max_attempts": 3}},
            }
        _file_systems[protocol] = fsspec.filesystem(protocol, **options)
        _STORAGE_EXCEPTIONS = _load_storage_exceptions()
    return _file_systems[protocol]


def _unix_seconds(moment: Any) -> float:
    """Return seconds since 1970; s3fs gives a datetime, fsspec's memory a number."""
    return moment.timestamp() if isinstance(moment, datetime) else float(moment or 0.0)
