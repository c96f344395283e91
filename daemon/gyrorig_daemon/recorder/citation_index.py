"""Citation index: which recordings the calibrations in the stores cite.

What to use when: only in `retention`. Citations are found by digests and names anywhere in the
documents of a store, without parsing them. A damaged document, or one of a later version, still
protects its recordings.
"""

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from gyrorig_daemon.recorder.recovery import file_sha256
from gyrorig_daemon.recorder.retention_memory import RetentionMemory
from gyrorig_protocol.errors import MachineError

_DIGEST = re.compile(rb"[0-9a-f]{64}")
_NAME = re.compile(rb"[\w.+-]+\.mcap(?:\.part)?")
_DOCUMENTS = (".yaml", ".yml", ".json")
_LARGEST_DOCUMENT_BYTES = 16 << 20  # real documents have a few kB


class CitationIndex:
    """The digests and names in the documents of all stores."""

    def __init__(self, stores: Sequence[Path]) -> None:
        self._digests: set[str] = set()
        self._names: set[str] = set()
        self.counts: dict[str, int] = {}  # citations by store
        for store in stores:
            if not store.is_dir():
                raise MachineError(
                    f"the calibration store {store} does not exist. The daemon deletes no old "
                    "recordings, because it cannot check which of them the calibrations in this "
                    "store need",
                    "mount the disk of the store, or remove the store from `service: stores` in "
                    "the rig file",
                )
            try:
                self.counts[str(store)] = sum(map(self._read_document, _documents(store)))
            except OSError as fault:
                raise MachineError(
                    f"the daemon cannot read {fault.filename or store} in the calibration store "
                    f"({fault.strerror}). It deletes no old recordings, because it cannot check "
                    "which of them the calibrations in this store need",
                    "give the user of the daemon permission to read the store, or remove the store "
                    "from `service: stores` in the rig file",
                ) from fault

    def protects(self, path: Path) -> bool:
        """Whether a calibration was made from this file."""
        return path.name in self._names or _digest(path) in self._digests

    def _read_document(self, document: Path) -> int:
        """Read the citations of a document and return their number."""
        if document.stat().st_size > _LARGEST_DOCUMENT_BYTES:
            raise MachineError(
                f"the file {document} in the store is too large for a calibration (more than "
                f"{_LARGEST_DOCUMENT_BYTES / 1e6:.0f} MB)",
                "move the file out of the store",
            )
        text = document.read_bytes()
        digests, names = _DIGEST.findall(text), _NAME.findall(text)
        self._digests.update(match.decode() for match in digests)
        self._names.update(match.decode() for match in names)
        return len(digests) + len(names)


def check_citation_counts(
    counts: Mapping[str, int], previous: RetentionMemory, memory_path: Path
) -> None:
    """Check that each store is mounted, as far as that can be seen.

    Raises:
        MachineError: a store had citations at the last check, and has none now; or its folder is
            empty, as is the folder below a disk that is not mounted.
    """
    for store, count in counts.items():
        previous_count = previous.citation_counts.get(store, 0)
        if previous_count and not count:
            raise MachineError(
                f"the calibration store {store} had citations of recordings at the last check "
                f"({previous_count}), and has none now. The daemon deletes no old recordings, "
                "because the disk of the store may not be mounted",
                "mount the disk of the store. If the store is empty on purpose, delete the file "
                f"{memory_path}. All recordings then count as new",
            )
        if not count and not any(Path(store).iterdir()):
            raise MachineError(
                f"the folder of the calibration store {store} is empty. The daemon deletes no old "
                "recordings, because the disk of the store may not be mounted",
                "mount the disk of the store. If the store is new, create a file in its folder, "
                f"for example with `touch {store}/new-store`",
            )


def _documents(store: Path) -> Iterator[Path]:
    """Every document in a store, also through links; OSError if one cannot be read."""

    def refuse(fault: OSError) -> None:
        raise fault

    visited: set[str] = set()
    for folder, subfolders, names in os.walk(store, onerror=refuse, followlinks=True):
        real = os.path.realpath(folder)
        if real in visited:  # links in a circle
            subfolders.clear()
            continue
        visited.add(real)
        yield from (Path(folder, name) for name in names if name.endswith(_DOCUMENTS))


def _digest(path: Path) -> str:
    try:
        return file_sha256(path)
    except OSError as fault:
        raise MachineError(
            f"the old recording {path} cannot be read ({fault.strerror}). The daemon does not "
            "delete it, because without its SHA-256 it cannot check whether a calibration needs it",
            "give the user of the daemon permission to read the file, or check the disk",
        ) from fault
