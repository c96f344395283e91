"""Retention memory: what the service saw of the recordings and of the calibration stores before.

What to use when: under `retention`. The time of a file is wrong if the system time was wrong
during the recording. Therefore the file counts as new when it is first seen with a valid system
time. A store that is not mounted is an empty folder. Therefore the number of its citations is
remembered.
"""

import json
from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from gyrorig_protocol.atomic_files import write_atomically
from gyrorig_protocol.errors import MachineError

_FILE_MODE = 0o640


@dataclass(frozen=True, slots=True)
class RetentionMemory:
    """What was seen at the last check."""

    first_seen_s: Mapping[str, float]  # by file: first valid system time at which it existed
    citation_counts: Mapping[str, int]  # by store

    def with_files(self, names: Collection[str], now_s: float | None) -> "RetentionMemory":
        """Return the memory with these files only; new ones are first seen now.

        Args:
            names: of all files that exist.
            now_s: present system time; None if it is not valid: then new files are not seen.
        """
        first_seen_s = {
            name: seen_s
            for name in names
            if (seen_s := self.first_seen_s.get(name, now_s)) is not None
        }
        return RetentionMemory(first_seen_s, self.citation_counts)

    def with_citations(self, citation_counts: Mapping[str, int]) -> "RetentionMemory":
        """Return the memory with the number of citations of each store."""
        return RetentionMemory(self.first_seen_s, citation_counts)


def read_memory(path: Path) -> RetentionMemory:
    """Return the memory in a file; an empty one if there is no file.

    Raises:
        MachineError: the file cannot be read.
    """
    try:
        document = json.loads(path.read_bytes())
        return RetentionMemory(
            {str(name): float(time_s) for name, time_s in document["first_seen_s"].items()},
            {str(store): int(count) for store, count in document["citation_counts"].items()},
        )
    except FileNotFoundError:
        return RetentionMemory({}, {})
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError) as fault:
        raise MachineError(
            f"the file {path} cannot be read ({fault}). The daemon deletes no old recordings, "
            "because it does not know how old they are and which stores have calibrations",
            "mount all stores, and delete this file. All recordings then count as new",
        ) from fault


def write_memory(path: Path, memory: RetentionMemory) -> None:
    """Write the memory; a full disk must not prevent that old recordings are deleted."""
    document = {
        "first_seen_s": dict(memory.first_seen_s),
        "citation_counts": dict(memory.citation_counts),
    }
    with suppress(OSError):
        write_atomically(path, json.dumps(document).encode(), mode=_FILE_MODE)
