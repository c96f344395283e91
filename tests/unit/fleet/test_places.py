"""A folder and a bucket do the same; what a bucket refuses is said, and nothing is taken twice."""

import os
import threading
from pathlib import Path

import fsspec  # type: ignore[import-untyped] # it has no types
import pytest

from gyrorig_protocol.errors import InputError, MachineError, UsageError
from gyrorig_solver.places import bucket as buckets
from gyrorig_solver.places.bucket import Bucket
from gyrorig_solver.places.choose import place_at
from gyrorig_solver.places.folder import Folder
from gyrorig_solver.places.place import Place


@pytest.fixture(params=["folder", "bucket"])
def place(request: pytest.FixtureRequest, tmp_path: Path) -> Place:
    bucket = f"memory://{tmp_path.name}/store"
    return Folder(tmp_path) if request.param == "folder" else place_at(bucket)


def test_what_is_put_is_read(place: Place) -> None:
    assert place.read("a/b.txt") is None
    place.put("a/b.txt", b"one")
    place.put("a/b.txt", b"two")
    assert place.read("a/b.txt") == b"two"
    with place.local("a/b.txt") as path:
        assert (path.name, path.read_bytes()) == ("b.txt", b"two")
    place.remove(["a/b.txt", "a/none"])
    assert place.read("a/b.txt") is None
    with pytest.raises(InputError, match=r"b\.txt"), place.local("a/b.txt"):
        pass


def test_a_name_is_taken_once(place: Place) -> None:
    assert place.put_new("claims/x", b"mine")
    assert not place.put_new("claims/x", b"yours")
    assert place.read("claims/x") == b"mine"


def test_one_of_many_takes_a_name(place: Place) -> None:
    took: list[int] = []

    def take(number: int) -> None:
        if place.put_new("claims/x", b"%d" % number):
            took.append(number)

    threads = [threading.Thread(target=take, args=(number,)) for number in range(8)]
    for one in threads:
        one.start()
    for one in threads:
        one.join()
    assert len(took) == 1
    assert place.read("claims/x") == b"%d" % took[0]


def test_a_listing_has_the_names_below(place: Place) -> None:
    assert list(place.entries()) == []
    for name in ("b/2", "a/1", "b/1/x"):
        place.put(name, name.encode())
    assert sorted(entry.name for entry in place.entries()) == ["a/1", "b/1/x", "b/2"]
    below = list(place.entries("b"))
    assert {(entry.name, entry.size) for entry in below} == {("b/1/x", 5), ("b/2", 3)}
    assert all(entry.stamp and entry.changed_s > 1e9 for entry in below)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("http://x/y", "neither a folder nor a bucket"),
        ("s3://", "no bucket"),
        ("s3://b/../c", "no bucket"),
    ],
)
def test_what_is_no_place_is_refused(text: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        place_at(text)


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
    one = Flaky(0)
    monkeypatch.setitem(buckets._systems, "memory", one)
    return one


def test_a_put_whose_answer_was_lost_is_known_as_ours(flaky: Flaky) -> None:
    place = Bucket("memory", "flaky/store")
    flaky.refuses = 1
    assert place.put_new("x", b"mine")
    flaky.refuses = 1
    assert not place.put_new("x", b"yours")
    flaky.refuses = 2  # refused, then done without an answer
    assert place.put_new("y", b"mine")


def test_what_a_bucket_refuses_again_and_again_is_said(flaky: Flaky) -> None:
    flaky.alike = True
    flaky.refuses = 99
    place = Bucket("memory", "flaky/store")
    with pytest.raises(MachineError, match="check the bucket's name, the network"):
        place.put("x", b"mine")
    with pytest.raises(MachineError, match="check the bucket's name, the network"):
        place.put_new("x", b"mine")
    assert place.read("x") is None
