"""A disk that remembers every operation, and what of it a power cut could have left.

What to use when: in tests of crash safety. `PowerCutDisk` does everything for real and
keeps a log; `states` makes the legal states of the folder after a power cut behind any
operation, to be written somewhere and recovered from.

The rules are weaker than those of ext4 in its usual mode, so that what survives them
survives others too. Behind the last sync of a file, each page of 512 bytes may have
reached the disk or not, in any order; a page that did not is as it was, or zero where the
file has grown; its length is any that it had since, or cut at a page. Of the names, those
created, changed and deleted since the last sync of the folder have happened up to some
point, in order.

Source: SQLite's test6.c keeps writes in a list and lets an arbitrary subset reach the file.
"""

import random
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from gyrorig_protocol.recording.mcap.disk_file import Disk, DiskFile

PAGE_BYTES = 512
RANDOM_SUBSETS = 3  # of pages, a crash point and file

State = dict[str, bytes]  # name below the folder -> content


@dataclass(slots=True)
class _FileImage:
    """What a file holds, as the program sees it and as is certain to be on the disk."""

    current: bytes = b""
    synced: bytes = b""
    lengths: list[int] = field(default_factory=lambda: [0])  # since the last sync

    def write(self, offset: int, data: bytes) -> None:
        self.current = self.current[:offset] + data + self.current[offset + len(data) :]
        self.lengths.append(len(self.current))

    def cut(self, length: int) -> None:
        self.current = self.current[:length]
        self.lengths.append(length)

    def sync(self) -> None:
        self.synced = self.current
        self.lengths = [len(self.current)]


@dataclass(frozen=True, slots=True)
class Operation:
    """One entry of the log; what each kind uses is told by its name."""

    kind: str  # create, write, cut, sync, rename, unlink, sync_directory
    file: int = 0
    name: str = ""
    other: str = ""
    offset: int = 0
    data: bytes = b""


class _LoggedFile(DiskFile):
    def __init__(self, path: Path, number: int, disk: "PowerCutDisk") -> None:
        super().__init__(path)
        self._number, self._log = number, disk.log
        disk.log.append(Operation("create", number, disk.name(path)))

    def write(self, data: bytes) -> int:
        offset = self.tell()
        written = super().write(data)
        self._log.append(Operation("write", self._number, offset=offset, data=bytes(data)))
        return written

    def sync(self) -> None:
        self._log.append(Operation("sync", self._number))

    def cut(self, length: int) -> None:
        super().cut(length)
        self._log.append(Operation("cut", self._number, offset=length))


class PowerCutDisk(Disk):
    """Everything below one folder, with a log."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._files = 0
        self.log: list[Operation] = []

    def name(self, path: Path) -> str:
        """How the log calls a path."""
        return str(path.relative_to(self._folder))

    def create(self, path: Path) -> DiskFile:
        """As `Disk.create`."""
        self._files += 1
        return _LoggedFile(path, self._files, self)

    def rename(self, old: Path, new: Path) -> None:
        """As `Disk.rename`."""
        super().rename(old, new)
        self.log.append(Operation("rename", name=self.name(old), other=self.name(new)))

    def unlink(self, path: Path) -> None:
        """As `Disk.unlink`."""
        super().unlink(path)
        self.log.append(Operation("unlink", name=self.name(path)))

    def sync_directory(self, folder: Path) -> None:
        """Note it; the real disk need not be troubled."""
        self.log.append(Operation("sync_directory", name=self.name(folder)))


@dataclass(frozen=True, slots=True)
class PowerCut:
    """A legal state after a power cut, and what is certain to be in it."""

    operations: int  # that had been done
    state: State
    synced: State  # of each file that has a name for certain, what was synced


def power_cuts(
    log: list[Operation],
    initial: State | None = None,
    seed: int = 1,
    page_bytes: int = PAGE_BYTES,
) -> Iterator[PowerCut]:
    """Every crash point of a log, with the states that could follow; none of them twice.

    Args:
        log: of a `PowerCutDisk`.
        initial: files that were there, and safe, before the log began.
        seed: of the random subsets of pages.
        page_bytes: the unit that reaches the disk whole or not at all.
    """
    rng = random.Random(seed)
    history = _FolderHistory(initial or {}, page_bytes)
    seen: set[frozenset[tuple[str, bytes]]] = set()
    for completed in range(len(log) + 1):
        for state in history.possible_states(rng):
            key = frozenset(state.items())
            if key not in seen:
                seen.add(key)
                yield PowerCut(completed, state, history.durable_state())
        if completed < len(log):
            history.apply(log[completed])


class _FolderHistory:
    """The files and names as a log goes on."""

    def __init__(self, initial: State, page_bytes: int) -> None:
        self._page_bytes = page_bytes
        self._images: dict[int, _FileImage] = {}
        self._names: dict[str, int] = {}  # as certain on the disk
        self._pending: list[Operation] = []  # of names, since
        for number, (name, content) in enumerate(initial.items()):
            self._images[-1 - number] = _FileImage(content, content, [len(content)])
            self._names[name] = -1 - number

    def apply(self, operation: Operation) -> None:
        """One more operation has been done."""
        match operation.kind:
            case "create":
                self._images[operation.file] = _FileImage()
                self._pending.append(operation)
            case "write":
                self._images[operation.file].write(operation.offset, operation.data)
            case "cut":
                self._images[operation.file].cut(operation.offset)
            case "sync":
                self._images[operation.file].sync()
            case "sync_directory":
                self._names = self._names_after(len(self._pending))
                self._pending.clear()
            case _:
                self._pending.append(operation)

    def durable_state(self) -> State:
        """What was synced of files whose names are certain."""
        return {name: self._images[number].synced for name, number in self._names.items()}

    def possible_states(self, rng: random.Random) -> Iterator[State]:
        """The states that a power cut now could leave."""
        for completed in range(len(self._pending) + 1):
            names = self._names_after(completed)
            used = sorted(set(names.values()))
            choices = {
                number: list(
                    _PossibleContents(self._images[number], self._page_bytes).possibilities(rng)
                )
                for number in used
            }
            # One file at a time through all its choices; the others all or nothing.
            for others in (0, 1):
                base = {n: choices[n][min(others, len(choices[n]) - 1)] for n in used}
                yield {name: base[number] for name, number in names.items()}
                for number in used:
                    for content in choices[number][2:]:
                        contents = base | {number: content}
                        yield {name: contents[n] for name, n in names.items()}

    def _names_after(self, completed: int) -> dict[str, int]:
        names = dict(self._names)
        for operation in self._pending[:completed]:
            match operation.kind:
                case "create":
                    names[operation.name] = operation.file
                case "rename":
                    names[operation.other] = names.pop(operation.name)
                case "unlink":
                    names.pop(operation.name)
        return names


class _PossibleContents:
    """What a file may hold after a power cut."""

    def __init__(self, image: _FileImage, page_bytes: int) -> None:
        self._image = image
        self._page_bytes = page_bytes

    def possibilities(self, rng: random.Random) -> Iterator[bytes]:
        """First what was synced, then everything, then what lies between."""
        image = self._image
        yield image.synced
        if image.current == image.synced:
            return
        yield image.current
        length = len(image.current)
        pages = range((max(length, len(image.synced)) - 1) // self._page_bytes + 1)
        changed = {p for p in pages if self._page(image.current, p) != self._page(image.synced, p)}
        steps = range(len(image.synced), length, self._page_bytes)
        for size in sorted({*image.lengths, *steps}):
            if size <= length:
                yield image.current[:size]  # written in order, up to some byte
        yield self._with_pages(set())  # the length, and nothing of what is new
        for page in sorted(changed):
            yield self._with_pages({page})
            yield self._with_pages(changed - {page})
        for _ in range(RANDOM_SUBSETS):
            yield self._with_pages({page for page in sorted(changed) if rng.random() < 0.5})

    def _page(self, content: bytes, page: int) -> bytes:
        size = self._page_bytes
        return content[page * size : (page + 1) * size].ljust(size, b"\0")

    def _with_pages(self, written_pages: set[int]) -> bytes:
        """The newest length, with those pages that reached the disk."""
        image, length = self._image, len(self._image.current)
        pages = range((length - 1) // self._page_bytes + 1)
        mixed = b"".join(
            self._page(image.current if page in written_pages else image.synced, page)
            for page in pages
        )
        return mixed[:length]
