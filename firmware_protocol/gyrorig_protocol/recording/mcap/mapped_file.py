"""Memory-mapped files: a file as bytes, without a copy of it in memory.

What to use when: `map_mcap_file` for a recording, `map_file` for any file. A reader that goes
through the file once calls `PageReleaser.release_before`, so that the system can free the pages
that were read. Otherwise an hour of samples adds 140 MB to the process's memory.
"""

import mmap
import stat
from pathlib import Path

from gyrorig_protocol.errors import InputError, MachineError
from gyrorig_protocol.file_kinds import HEAD_BYTES, IMPORTABLE, describe_file_kind
from gyrorig_protocol.recording.mcap.mcap_summary import MAGIC

_STRIDE_BYTES = 16 << 20  # pages are released in steps of this size, at almost no cost


def map_file(path: Path) -> memoryview:
    """Map a file into memory; the system reads its bytes when they are used.

    Raises:
        InputError: the file does not exist, is empty, or is not a regular file.
        MachineError: this computer cannot read it.
    """
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise InputError(
                f"{path} is a folder, not a recording",
                "give the files of the recordings in the folder",
            )
        if not stat.S_ISREG(status.st_mode):
            raise InputError(
                f"{path} is not a regular file, so it cannot be a recording",
                "give the file of a recording (.mcap)",
            )
        if status.st_size == 0:
            raise InputError(
                f"the file {path} is empty, so it contains no recording", "record the session again"
            )
        with path.open("rb") as file:
            return memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
    except (FileNotFoundError, NotADirectoryError) as error:
        raise InputError(
            f"the recording {path} does not exist", "give the path of an existing recording"
        ) from error
    except ValueError as error:  # mmap of a file that was emptied after stat
        raise InputError(
            f"another program deleted the content of {path} while Gyrorig opened the file",
            "end the program that writes to the file, and run the command again",
        ) from error
    except OSError as error:
        raise MachineError(
            f"the recording {path} cannot be read ({error.strerror})",
            "correct the permissions of the file, or check its disk",
        ) from error


def map_mcap_file(path: Path) -> memoryview:
    """Map a file that begins as an MCAP file does.

    Raises:
        InputError: as `map_file`, or the file is of another kind.
        MachineError: this computer cannot read it.
    """
    data = map_file(path)
    if data[: len(MAGIC)] != MAGIC:
        kind = describe_file_kind(bytes(data[:HEAD_BYTES]))
        remedy = "give the file of a recording (.mcap)"
        if kind in IMPORTABLE:
            remedy = "convert it with `gyrorig import`"
        raise InputError(f"{path} is {kind}, not a recording", remedy)
    return data


class PageReleaser:
    """Release mapped pages behind a reader that goes from the beginning to the end."""

    def __init__(self, data: memoryview) -> None:
        # Plain bytes, and systems without madvise, release nothing.
        mapping = data.obj
        can_release = isinstance(mapping, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED")
        self._mapping = mapping if can_release and isinstance(mapping, mmap.mmap) else None
        self._released_bytes = 0

    def release_before(self, offset: int) -> None:
        """Release the pages before byte `offset`; they can be read again, but slowly."""
        if self._mapping is not None and offset - self._released_bytes >= _STRIDE_BYTES:
            end = offset // mmap.PAGESIZE * mmap.PAGESIZE
            self._mapping.madvise(
                mmap.MADV_DONTNEED, self._released_bytes, end - self._released_bytes
            )
            self._released_bytes = end
