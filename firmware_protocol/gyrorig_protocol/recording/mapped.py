"""A file as bytes without reading it into memory, and without keeping what was read.

What to use when: under `reader`. `map_file` opens; a `Passage` tells the system, behind a
reader that goes through the file once, that its pages are not needed any more: else an
hour of samples would count 140 MB as this process's memory, on top of what it keeps.
"""

import mmap
import stat
from pathlib import Path

from gyrorig_protocol.errors import InputError, MachineError

_STRIDE_BYTES = 16 << 20  # pages are let go in strides of this, which costs next to nothing


def map_file(path: Path) -> memoryview:
    """The bytes of a file, read as they are looked at.

    Raises:
        InputError: there is no such file, or it is empty or no file.
        MachineError: this computer cannot read it.
    """
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise InputError(f"{path} is a folder", "name one recording in it")
        if not stat.S_ISREG(status.st_mode):
            raise InputError(f"{path} is no file", "name one recording")
        if status.st_size == 0:
            raise InputError(
                f"{path} is empty: its writer ended within its first moments", "record again"
            )
        with path.open("rb") as file:
            return memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
    except (FileNotFoundError, NotADirectoryError) as error:
        raise InputError(f"{path} does not exist", "name a recording that does") from error
    except ValueError as error:  # mmap of a file that has been emptied meanwhile
        raise InputError(
            f"{path} was emptied while it was being opened", "end the program that writes to it"
        ) from error
    except OSError as error:
        raise MachineError(
            f"cannot read {path}: {error.strerror}", "mend its rights, or look at its disk"
        ) from error


class Passage:
    """One way through mapped bytes, from the beginning to the end."""

    def __init__(self, data: memoryview) -> None:
        # Bytes in memory, and systems without the call, keep what they have.
        whole = data.obj
        can = isinstance(whole, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED")
        self._file = whole if can and isinstance(whole, mmap.mmap) else None
        self._behind = 0

    def reached(self, at: int) -> None:
        """Let go of what lies well before byte `at`; reading it again is allowed, and slow."""
        if self._file is not None and at - self._behind >= _STRIDE_BYTES:
            end = at // mmap.PAGESIZE * mmap.PAGESIZE
            self._file.madvise(mmap.MADV_DONTNEED, self._behind, end - self._behind)
            self._behind = end
