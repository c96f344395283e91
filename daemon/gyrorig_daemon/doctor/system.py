"""The files through which a computer shows itself, and how to read them without surprises.

What to use when: every module of the doctor takes a `System`; the real one is `System()`,
a test's has its own folders under `root`.
"""

import contextlib
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class System:
    """A computer's /proc, /sys, /etc and /dev."""

    root: Path = Path("/")

    def path(self, name: str) -> Path:
        """Return where `name`, an absolute path, is on this computer."""
        return self.root / name.lstrip("/")

    def text(self, name: str) -> str | None:
        """Return what a small file says, None where it says nothing."""
        with contextlib.suppress(OSError):
            return self.path(name).read_text(encoding="utf-8", errors="replace").strip()
        return None

    def number(self, name: str) -> int | None:
        """Return the first whole number in a small file, None where there is none."""
        words = (self.text(name) or "").split()
        with contextlib.suppress(ValueError, IndexError):
            return int(words[0])
        return None

    def names(self, folder: str, pattern: str = "*") -> list[str]:
        """Return the names in a folder, sorted; none where there is no such folder."""
        with contextlib.suppress(OSError):
            return sorted(found.name for found in self.path(folder).glob(pattern))
        return []

    def programs(self) -> set[str]:
        """Return the names of all running programs."""
        numbers = (name for name in self.names("/proc") if name.isdecimal())
        return {self.text(f"/proc/{number}/comm") or "" for number in numbers} - {""}
