"""Read access to /proc, /sys, /etc and /dev of a computer.

What to use when: every check takes a `SystemFiles`. The default is this computer; a test has its
own folders under `root`.
"""

import contextlib
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class SystemFiles:
    """A computer's system files, below a root folder."""

    root: Path = Path("/")

    def path(self, name: str) -> Path:
        """Return where `name`, an absolute path, is below the root."""
        return self.root / name.lstrip("/")

    def read_text(self, name: str) -> str | None:
        """Return the text of a small file, None if it cannot be read."""
        with contextlib.suppress(OSError):
            return self.path(name).read_text(encoding="utf-8", errors="replace").strip()
        return None

    def read_number(self, name: str) -> int | None:
        """Return the first integer in a small file, None if there is none."""
        fields = (self.read_text(name) or "").split()
        with contextlib.suppress(ValueError, IndexError):
            return int(fields[0])
        return None

    def list_names(self, folder: str, pattern: str = "*") -> list[str]:
        """Return the sorted names in a folder; none if the folder does not exist."""
        with contextlib.suppress(OSError):
            return sorted(path.name for path in self.path(folder).glob(pattern))
        return []

    def running_programs(self) -> set[str]:
        """Return the names of all running programs."""
        pids = (name for name in self.list_names("/proc") if name.isdecimal())
        return {self.read_text(f"/proc/{pid}/comm") or "" for pid in pids} - {""}
