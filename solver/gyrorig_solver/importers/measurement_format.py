"""What a format of measurements provides, and how a file's format is found.

What to use when: `formats` for every format; `find_format` for the one of a file; `named_format`
for the one that a person named. A new format is a new file in `importers.formats` with a `FORMAT`.
"""

import importlib
import pkgutil
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import islice
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.file_kinds import (
    DAMAGED_ZIP,
    HEAD_BYTES,
    RECORDING,
    describe_file_kind,
    describe_remedy,
)
from gyrorig_solver.importers import formats as format_folder
from gyrorig_solver.importers.map_keys import ImportMap
from gyrorig_solver.importers.measured_streams import MeasuredStreams

# Options that every format with a gyroscope uses.
BOARD_OPTIONS = frozenset({"board", "sensor"})
MAX_LISTED = 2000  # entries of a folder that `detect` may look at


@dataclass(frozen=True, slots=True)
class ImportOptions:
    """What a person chose about an import; None and () leave it to the format."""

    mapping: ImportMap | None = None  # the meaning of the columns
    board: str | None = None  # name of the board
    sensor: str | None = None  # sensor type
    topics: tuple[str, ...] = ()  # the streams to read, where a source has several
    stamp: str | None = None  # "sampled" or "arrival", instead of what the format finds

    def check_topics(self, known: Sequence[str]) -> None:
        """Check that the format has all chosen streams.

        Raises:
            UsageError: it does not have one of them.
        """
        unknown = [topic for topic in self.topics if topic not in known]
        if unknown:
            raise UsageError(
                f"the option --topic names {unknown[0]!r:.60}, which this format does not have",
                f"choose {' or '.join(known)}",
            )


@dataclass(frozen=True, slots=True)
class FormatMatch:
    """What a file is, as a format sees it."""

    description: str  # "a ROS 2 bag (MCAP)"
    is_complete: bool = True  # the format says what each value is; else a map is needed


class MeasurementFormat(Protocol):
    """One kind of file or folder with measurements."""

    @property
    def name(self) -> str:
        """Return the word of the command line."""
        ...

    @property
    def title(self) -> str:
        """Return the name for readers, "ROS 2 bag (MCAP or SQLite)"."""
        ...

    @property
    def extra(self) -> str:
        """Return the extra that installs the libraries, "" if none is needed."""
        ...

    @property
    def used_options(self) -> frozenset[str]:
        """Return the fields of `ImportOptions` that `read` uses."""
        ...

    def detect(self, source: Path) -> FormatMatch | None:
        """Return what the file or folder is, by its content; None if it is another format.

        Reads a bounded part of the source and raises no error but OSError.
        """
        ...

    def read(self, source: Path, options: ImportOptions) -> MeasuredStreams:
        """Return the streams of the source.

        Raises:
            InputError: the source is damaged, or lacks something.
            UsageError: an option does not fit the source.
            ModuleNotFoundError: a library of `extra` is not installed.
        """
        ...


@cache
def formats() -> MappingProxyType[str, MeasurementFormat]:
    """Return every format by its name, in alphabetical order."""
    by_name: dict[str, MeasurementFormat] = {}
    for module in pkgutil.iter_modules(format_folder.__path__):
        loaded = importlib.import_module(f"{format_folder.__name__}.{module.name}")
        candidate: MeasurementFormat | None = getattr(loaded, "FORMAT", None)
        if candidate is not None:
            by_name[candidate.name] = candidate
    return MappingProxyType(dict(sorted(by_name.items())))


def _find_matches(source: Path) -> list[tuple[MeasurementFormat, FormatMatch]]:
    """Return the formats that a file or folder can have, complete ones first."""
    pairs = []
    for candidate in formats().values():
        match = candidate.detect(source)
        if match is not None:
            pairs.append((candidate, match))
    return sorted(pairs, key=lambda pair: not pair[1].is_complete)


def find_format(source: Path, *, has_map: bool = False) -> tuple[MeasurementFormat, FormatMatch]:
    """Return the format of a file or folder, by its content.

    Args:
        source: a file or folder.
        has_map: a person gave a column map, so a format that uses one comes first.

    Raises:
        InputError: the source does not exist, or has no known format.
    """
    if not source.exists():
        raise InputError(
            f"the file {source} does not exist", "give the path of a file or folder to import"
        )
    try:
        pairs = _find_matches(source)
        if has_map:
            pairs.sort(key=lambda pair: "mapping" not in pair[0].used_options)
        if pairs:
            return pairs[0]
        kind = _describe_source(source)
    except OSError as error:
        raise InputError(
            f"{source.name} cannot be read ({error.strerror or type(error).__name__})",
            "check that the file can be read, and copy it again from its source",
        ) from error
    if kind == RECORDING:
        raise InputError(
            f"{source.name} is already a recording, or an MCAP file that is not a ROS 2 bag",
            "give a recording to `gyrorig check` or `gyrorig solve`",
        )
    raise InputError(
        f"{source.name} is {kind}, which `gyrorig import` cannot read",
        describe_remedy(kind)
        or "give a file or folder of one of the formats on the page docs/how-to/import.md",
    )


def _describe_source(source: Path) -> str:
    if source.is_dir():
        names = sorted(path.name for path in islice(source.iterdir(), MAX_LISTED))
        listed = ", ".join(name[:40] for name in names[:6]) or "nothing"
        return f"a folder that contains {listed}{' and more' if len(names) > 6 else ''}"
    head = read_head(source)
    if head.startswith(b"PK") and not zipfile.is_zipfile(source):
        return DAMAGED_ZIP
    return describe_file_kind(head)


def read_head(source: Path, size: int = HEAD_BYTES) -> bytes:
    """Return the first bytes of a file; b"" for a folder."""
    if not source.is_file():
        return b""
    with source.open("rb") as file:
        return file.read(size)
