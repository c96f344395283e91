"""A folder and a bucket do the same; what a bucket refuses is said, and nothing is taken twice."""

import os
import threading
from pathlib import Path

import fsspec  # type: ignore[import-untyped] # it has no types
import pytest

from gyrorig_protocol.errors import InputError, MachineError, UsageError
from gyrorig_solver.storage import Folder, Storage, storage_at
from gyrorig_solver.storage import bucket as buckets
from gyrorig_solver.storage.bucket import Bucket


@pytest.fixture(params=["folder", "bucket"])
def storage(request: pytest.FixtureRequest, tmp_path: Path) -> Storage:
    bucket = f"memory://{tmp_path.name}/store"
    return Folder(tmp_path) if request.param == "folder" else storage_at(bucket)


def test_written_files_are_read_back(storage: Storage) -> None:
    assert storage.read("a/b.txt") is None
    storage.write("a/b.txt", b"one")
    storage.write("a/b.txt", b"two")
    assert storage.read("a/b.txt") == b"two"
    with storage.local_copy("a/b.txt") as path:
        assert (path.name, path.read_bytes()) == ("b.txt", b"two")
    storage.remove(["a/b.txt", "a/none"])
    assert storage.read("a/b.txt") is None
    with pytest.raises(InputError, match=r"b\.txt"), storage.local_copy("a/b.txt"):
        pass


def test_a_name_is_taken_once(storage: Storage) -> None:
    assert storage.write_new("claims/x", b"mine")
    assert not storage.write_new("claims/x", b"yours")
    assert storage.read("claims/x") == b"mine"


def test_one_of_many_threads_takes_a_name(storage: Storage) -> None:
    winners: list[int] = []

    def take(number: int) -> None:
        if storage.write_new("claims/x", b"%d" % number):
            winners.append(number)

    threads = [threading.Thread(target=take, args=(number,)) for number in range(8)]
    for item in threads:
        item.start()
    for item in threads:
        item.join()
    assert len(winners) == 1
    assert storage.read("claims/x") == b"%d" % winners[0]


def test_a_listing_has_the_names_of_a_folder(storage: Storage) -> None:
    assert list(storage.list_files()) == []
    for name in ("b/2", "a/1", "b/1/x"):
        storage.write(name, name.encode())
    assert sorted(entry.name for entry in storage.list_files()) == ["a/1", "b/1/x", "b/2"]
    below = list(storage.list_files("b"))
    assert {(entry.name, entry.size) for entry in below} == {("b/1/x", 5), ("b/2", 3)}
    assert all(entry.change_tag and entry.modified_s > 1e9 for entry in below)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("http://x/y", "neither a folder nor a bucket"),
        ("s3://", "does not contain the name of a bucket"),
        ("s3://b/../c", "does not contain the name of a bucket"),
    ],
)
def test_an_invalid_location_is_refused(text: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        storage_at(text)


class Flaky:
    """An object store that does as it is told, and then says it has not; or refuses."""

    def __init__(self, refuses: int) -> None:
        self.refuses = refuses
        self.alike = False  # every refusal is one
        self.inner = fsspec.filesystem("memory")

    def __getattr__(self, name: str) -> object:
        return getattr(self.inner, name)

    def pipe_file(self, path: str, data: bytes, mode: str = "overwrite") -> None:
        if self.refuses:
            self.refuses -= 1
            if self.refuses % 2 == 0 and not self.alike:  # done, and the answer is lost
                self.inner.pipe_file(path, data, mode=mode)
            raise OSError(os.strerror(5))
        self.inner.pipe_file(path, data, mode=mode)


@pytest.fixture
def flaky(monkeypatch: pytest.MonkeyPatch) -> Flaky:
    item = Flaky(0)
    monkeypatch.setitem(buckets._file_systems, "memory", item)
    return item


def test_a_put_with_a_lost_answer_is_recognised_as_ours(flaky: Flaky) -> None:
    storage = Bucket("memory", "flaky/store")
    flaky.refuses = 1
    assert storage.write_new("x", b"mine")
    flaky.refuses = 1
    assert not storage.write_new("x", b"yours")
    flaky.refuses = 2  # refused, then done without an answer
    assert storage.write_new("y", b"mine")


def test_repeated_refusals_of_a_bucket_are_reported(flaky: Flaky) -> None:
    flaky.alike = True
    flaky.refuses = 99
    storage = Bucket("memory", "flaky/store")
    with pytest.raises(MachineError, match="Check the name of the bucket, the network"):
        storage.write("x", b"mine")
    with pytest.raises(MachineError, match="Check the name of the bucket, the network"):
        storage.write_new("x", b"mine")
    assert storage.read("x") is None
