"""Untrusted files of other programs, each read by the format that recognises it."""

import functools
from collections.abc import Callable, Sequence
from pathlib import Path

from tests.fuzz.file_targets import folder
from tests.fuzz.target import Target, expect_rejection
from tests.support import foreign_files
from tests.support.simulated_attitudes import SimulatedAttitudes, simulate_attitudes

from gyrorig_protocol.documents import convert_document, parse_yaml
from gyrorig_protocol.errors import GyrorigError
from gyrorig_solver.importers import ImportMap, ImportOptions, import_files

MAP = """
schema: gyrorig/import/1
board: B1
sensor: X
time: {key: t_imu, unit: s}
gyro: {keys: [gyr], unit: deg/s}
attitude: {keys: [quat], order: wxyz, time: {key: t_cam}}
"""


@functools.cache
def mapping() -> ImportMap:
    return convert_document(parse_yaml(MAP, "map"), ImportMap, "map")


@functools.cache
def session() -> SimulatedAttitudes:
    return simulate_attitudes(1, span_s=0.3)


def foreign_file(data: bytes) -> None:
    """A file of another program is rejected with one line, or its recording is written."""
    source, out = folder() / "foreign.bin", folder() / "foreign.mcap"
    source.write_bytes(data)
    out.unlink(missing_ok=True)
    for options in (ImportOptions(), ImportOptions(mapping=mapping())):
        expect_rejection(lambda _, o=options: import_files([source], out, o), GyrorigError, data)  # type: ignore[misc]
        out.unlink(missing_ok=True)


def _written(write: Callable[[Path], Path], name: str) -> Callable[[], Sequence[bytes]]:
    """Return a function that makes the bytes of a file once."""

    @functools.cache
    def seeds() -> Sequence[bytes]:
        path = folder() / name
        written = write(path)
        files = sorted(written.iterdir()) if written.is_dir() else [written]
        return [file.read_bytes() for file in files if file.suffix != ".yaml"]

    return seeds


def _euroc_table(path: Path) -> Path:
    return foreign_files.write_euroc_folder(path, session()) / "mav0" / "imu0" / "data.csv"


TARGETS = (
    Target(
        "ros1_bag",
        foreign_file,
        _written(lambda path: foreign_files.write_ros1_bag(path, session()), "a.bag"),
        65536,
    ),
    Target(
        "ros2_mcap",
        foreign_file,
        _written(lambda path: foreign_files.write_ros2_bag(path, session()), "mcap"),
        65536,
    ),
    Target(
        "ros2_sqlite",
        foreign_file,
        _written(
            lambda path: foreign_files.write_ros2_bag(path, session(), storage="sqlite3"), "db3"
        ),
        131072,
    ),
    Target(
        "matlab5",
        foreign_file,
        _written(lambda path: foreign_files.write_matlab5(path, session()), "a.mat"),
        32768,
    ),
    Target(
        "matlab73",
        foreign_file,
        _written(lambda path: foreign_files.write_matlab73(path, session()), "b.mat"),
        65536,
    ),
    Target(
        "parquet",
        foreign_file,
        _written(lambda path: foreign_files.write_parquet(path, session()), "a.parquet"),
        32768,
    ),
    Target(
        "tum",
        foreign_file,
        _written(lambda path: foreign_files.write_tum_trajectory(path, session()), "tum.txt"),
        4096,
    ),
    Target("euroc", foreign_file, _written(_euroc_table, "euroc"), 4096),
)
