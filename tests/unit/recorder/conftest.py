"""Disks that fail, and what a folder of recordings contains afterwards."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from gyrorig_protocol.recording.mcap.disk_file import Disk, DiskFile
from gyrorig_protocol.recording.messages import SessionEvent
from gyrorig_protocol.recording.reader import read_recording

METADATA = {"gyrorig": {"session": "s", "anchor_utc_ns": "0", "anchor_monotonic_raw_ns": "0"}}
TOPIC = "/board/B-1/imu_raw"

Decide = Callable[[int], int]  # number of the operation -> errno, 0 for none


class FailingFile(DiskFile):
    """Asks before each operation whether it is to fail."""

    def __init__(self, path: Path, ask: Callable[[], None]) -> None:
        self._ask = ask
        self._synced_bytes = 0
        ask()
        super().__init__(path)

    def write(self, data: bytes) -> int:
        try:
            self._ask()
        except OSError:
            super().write(data[: len(data) // 2])  # as a full disk does: short at first
            raise
        return super().write(data)

    def sync(self) -> None:
        """As Linux: the unsynced data are lost, one error says so, and the next sync succeeds."""
        unsynced_bytes = max(self.tell() - self._synced_bytes, 0)
        start, self._synced_bytes = self._synced_bytes, self.tell()
        try:
            self._ask()
        except OSError:
            os.pwrite(self._descriptor, bytes(unsynced_bytes), start)
            raise

    def cut(self, length: int) -> None:
        self._ask()
        super().cut(length)
        self._synced_bytes = min(self._synced_bytes, length)


class FailingDisk(Disk):
    """A disk whose n-th operation fails with the errno that `decide(n)` gives."""

    def __init__(self, decide: Decide = lambda _: 0) -> None:
        self.decide = decide
        self.operations = 0
        self.free = 1 << 40

    def ask(self) -> None:
        self.operations += 1
        if code := self.decide(self.operations):
            raise OSError(code, "the test says so")

    def create(self, path: Path) -> DiskFile:
        return FailingFile(path, self.ask)

    def rename(self, old: Path, new: Path) -> None:
        self.ask()
        super().rename(old, new)

    def unlink(self, path: Path) -> None:
        self.ask()
        super().unlink(path)

    def sync_directory(self, folder: Path) -> None:
        self.ask()

    def free_bytes(self, folder: Path) -> int:
        return self.free


def sequences(folder: Path) -> list[int]:
    """The message sequence numbers of the samples in all finished files, in their order."""
    numbers: list[int] = []
    for path in sorted(folder.glob("*.mcap")):
        recording = read_recording(path)
        assert recording.is_complete, recording.losses
        if TOPIC in recording.topics:
            array = recording.array(TOPIC)
            numbers += array["message_sequence"].tolist()
            assert (array["device_time"] == array["message_sequence"]).all()
    return numbers


def events(folder: Path) -> list[str]:
    """The texts of the session's events in all finished files."""
    return [
        message.text
        for path in sorted(folder.glob("*.mcap"))
        for recording in [read_recording(path)]
        if "/session/event" in recording.topics
        for message in recording.messages("/session/event")
        if isinstance(message, SessionEvent)
    ]


@pytest.fixture
def failing_disk() -> type[FailingDisk]:
    return FailingDisk


@pytest.fixture
def sequences_in() -> Callable[[Path], list[int]]:
    return sequences


@pytest.fixture
def events_in() -> Callable[[Path], list[str]]:
    return events
