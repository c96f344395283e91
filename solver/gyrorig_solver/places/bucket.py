"""A bucket of an object store, `s3://BUCKET/PREFIX`, through fsspec and s3fs.

What to use when: through `choose.place_at`. Who one is and where the store is, is said as to
every other program: `AWS_ACCESS_KEY_ID`, `AWS_PROFILE`, `AWS_ENDPOINT_URL` and the files in
`~/.aws`. Nothing of it passes through here or is written anywhere.

Theory of operation: a put with `If-None-Match: *` is the one thing that an object store does
for one of several at once and for no other. Its answer may be lost on the way, and the put
tried again then meets its own object. So after every doubt the object is read: ours is what
has our bytes.
"""

import asyncio
import contextlib
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path, PurePosixPath
from typing import Any

from gyrorig_protocol.errors import InputError, MachineError, UsageError
from gyrorig_solver.places.place import Entry

CONNECT_S, ANSWER_S = 5, 60
PROTOCOLS = ("s3", "memory")  # memory: of one process; for tests
_TRIES = 3
_REMOVED_AT_ONCE = 1_000  # the most that S3 takes
_systems: dict[str, Any] = {}  # one connection a process and protocol
_FAULTS: tuple[type[BaseException], ...] = (OSError, asyncio.TimeoutError)  # and botocore's


@dataclass(frozen=True, slots=True)
class Bucket:
    """All objects below one prefix."""

    protocol: str
    prefix: str  # bucket and what follows, without a slash at the end

    @property
    def text(self) -> str:
        """As a person names it."""
        return f"{self.protocol}://{self.prefix}"

    def read(self, name: str) -> bytes | None:
        """See `Place`."""
        with self._told(f"read {self.text}/{name}"):
            try:
                found: bytes = _system(self.protocol).cat_file(f"{self.prefix}/{name}")
            except FileNotFoundError:
                return None
            return found

    def put(self, name: str, data: bytes) -> None:
        """See `Place`."""
        with self._told(f"write {self.text}/{name}"):
            _system(self.protocol).pipe_file(f"{self.prefix}/{name}", data)

    def put_new(self, name: str, data: bytes) -> bool:
        """See `Place`."""
        path = f"{self.prefix}/{name}"
        for left in reversed(range(_TRIES)):
            try:
                _system(self.protocol).pipe_file(path, data, mode="create")
            except _FAULTS as fault:
                # The name is taken, by ourselves perhaps; or the store refused.
                there = self.read(name)
                if there is not None:
                    return there == data
                if not left:
                    raise self._refused(f"write {self.text}/{name}", fault) from fault
            else:
                return True
        return False

    def remove(self, names: Iterable[str]) -> None:
        """See `Place`."""
        paths = [f"{self.prefix}/{name}" for name in names]
        with self._told(f"remove from {self.text}"):
            system = _system(self.protocol)
            for start in range(0, len(paths), _REMOVED_AT_ONCE):
                some = paths[start : start + _REMOVED_AT_ONCE]
                try:
                    system.rm(some)
                except FileNotFoundError:  # not S3's way: one that is gone keeps the others
                    for path in some:
                        with contextlib.suppress(FileNotFoundError):
                            system.rm(path)

    def entries(self, below: str = "") -> Iterator[Entry]:
        """See `Place`."""
        start = f"{self.prefix}/{below}".rstrip("/")
        with self._told(f"list {self.text}/{below}"):
            system = _system(self.protocol)
            try:
                found = system.find(start, detail=True)
            except FileNotFoundError:
                found = {}
        for path in sorted(found):
            about = found[path]
            changed = about.get("LastModified") or about.get("created")
            stamp = str(about.get("ETag") or changed)
            inside = path.lstrip("/").removeprefix(self.prefix).lstrip("/")
            yield Entry(inside, int(about.get("size") or 0), stamp, _seconds(changed))

    def changed_s(self, name: str) -> float | None:
        """Return when an object was written, by the clock of the store; None without one."""
        with self._told(f"look at {self.text}/{name}"):
            try:
                return _seconds(_system(self.protocol).modified(f"{self.prefix}/{name}"))
            except FileNotFoundError:
                return None

    @contextlib.contextmanager
    def local(self, name: str) -> Iterator[Path]:
        """See `Place`."""
        with tempfile.TemporaryDirectory(prefix="gyrorig-") as folder:
            path = Path(folder) / PurePosixPath(name).name
            with self._told(f"read {self.text}/{name}"):
                try:
                    _system(self.protocol).get_file(f"{self.prefix}/{name}", str(path))
                except FileNotFoundError as fault:
                    raise InputError(
                        f"there is no {self.text}/{name} any more",
                        "it was removed meanwhile: run again",
                    ) from fault
            yield path

    @contextlib.contextmanager
    def _told(self, doing: str) -> Iterator[None]:
        """Turn what the object store refuses in the block into a MachineError."""
        try:
            yield
        except _FAULTS as fault:
            raise self._refused(doing, fault) from fault

    def _refused(self, doing: str, fault: BaseException) -> MachineError:
        said = " ".join(str(fault).split())[:160] or type(fault).__name__
        return MachineError(
            f"cannot {doing}, {said}",
            "check the bucket's name, the network, and the keys (AWS_ENDPOINT_URL, AWS_PROFILE)",
        )


def bucket_at(text: str) -> Bucket:
    """Return the bucket of `s3://BUCKET/PREFIX`.

    Raises:
        UsageError: it is of another kind, names no bucket, or s3fs is not installed.
    """
    protocol, _, rest = text.partition("://")
    if protocol not in PROTOCOLS:
        raise UsageError(
            f"{text} is neither a folder nor a bucket", "name a folder, or s3://BUCKET/FOLDER"
        )
    prefix = rest.strip("/")
    if not prefix or ".." in prefix.split("/"):
        raise UsageError(f"{text} names no bucket", "write it as s3://BUCKET/FOLDER")
    try:
        _system(protocol)
    except ImportError as fault:
        raise UsageError(
            f"{text} needs s3fs, which is not installed", "pip install 'gyrorig[fleet]'"
        ) from fault
    return Bucket(protocol, prefix)


def _faults() -> tuple[type[BaseException], ...]:
    """Return what an object store's library raises when the store refuses or is gone."""
    try:
        from botocore.exceptions import (  # type: ignore[import-untyped] # noqa: PLC0415
            BotoCoreError,
            ClientError,
        )
    except ImportError:
        return (OSError, asyncio.TimeoutError)
    return (OSError, asyncio.TimeoutError, BotoCoreError, ClientError)


def _system(protocol: str) -> Any:
    """Return this process's connection to an object store; made when it is first needed."""
    global _FAULTS  # noqa: PLW0603 - botocore takes a second to load
    if protocol not in _systems:
        import fsspec  # type: ignore[import-untyped] # noqa: PLC0415

        options: dict[str, Any] = {}
        if protocol == "s3":
            limits = {"connect_timeout": CONNECT_S, "read_timeout": ANSWER_S}
            options = {
                "use_listings_cache": False,  # others write too
                "config_kwargs": {**limits, "retries": {"mode": "standard", "max_attempts": 3}},
            }
        _systems[protocol] = fsspec.filesystem(protocol, **options)
        _FAULTS = _faults()
    return _systems[protocol]


def _seconds(moment: Any) -> float:
    """Return a moment since 1970: s3fs has it as such, the memory of tests as a number."""
    return moment.timestamp() if isinstance(moment, datetime) else float(moment or 0.0)
