"""Broken and foreign files at the command line: one line that says what it is and what to do."""

import gzip
import io
import resource
import sqlite3
import struct
import tarfile
import zipfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from tests.support.flight_log_writers import (
    dataflash_head,
    dataflash_message,
    write_blackbox,
    write_dataflash,
    write_ulog,
)
from tests.support.handheld_session import (
    HandheldSession,
    simulate_session,
    write_phyphox,
    write_sensor_logger,
    write_ximu3,
    write_xsens,
)

from gyrorig_solver.cli import run
from gyrorig_solver.importers import text_columns

ROOT = Path(__file__).resolve().parents[3]
REFUSED = (2, 3)  # usage, input
WrongFile = Callable[[Path], Path]
MAX_EXTRA_BYTES = 600_000_000  # of memory, for any wrong file


def plain(name: str, content: bytes | str) -> WrongFile:
    """Return a function that writes a file with this content."""

    def write(folder: Path) -> Path:
        path = folder / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return write


def archive(name: str, members: dict[str, bytes]) -> WrongFile:
    def write(folder: Path) -> Path:
        with zipfile.ZipFile(folder / name, "w", zipfile.ZIP_DEFLATED) as out:
            for member, content in members.items():
                out.writestr(member, content)
        return folder / name

    return write


def cut(write: Callable[[Path, HandheldSession], Path], share: float) -> WrongFile:
    """Return a function that writes the first part of a sound file."""

    def written(folder: Path) -> Path:
        path = write(folder, simulate_session(3, moves=1))
        whole = path.read_bytes()
        path.write_bytes(whole[: int(share * len(whole))])
        return path

    return written


def empty_folder(folder: Path) -> Path:
    (folder / "log").mkdir()
    return folder / "log"


def folder_of_pictures(folder: Path) -> Path:
    for k in range(3):
        (folder / f"IMG_{k}.jpg").write_bytes(b"\xff")
    return folder


def zip_bomb(folder: Path) -> Path:
    """Write an archive of 1 GB of zeros, packed to 4 MB; a smaller one takes longer to pack."""
    return packed_table(folder, [bytes(1_000_000)] * 1000)


def zip_bomb_of_lines(folder: Path) -> Path:
    return packed_table(folder, [b"\n" * 300_000])


def packed_table(folder: Path, parts: Sequence[bytes]) -> Path:
    path = folder / "bomb.zip"
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as out,
        out.open("Gyroscope.csv", "w") as member,
    ):
        member.write(b"time,seconds_elapsed,z,y,x\n")
        for part in parts:
            member.write(part)
    return path


def bag_of_images(folder: Path) -> Path:
    path = folder / "images"
    store = get_typestore(Stores.ROS2_HUMBLE)
    image, header = store.types["sensor_msgs/msg/Image"], store.types["std_msgs/msg/Header"]
    stamp = store.types["builtin_interfaces/msg/Time"]
    with Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        topic = writer.add_connection("/camera", "sensor_msgs/msg/Image", typestore=store)
        for k in range(3):
            message = image(header(stamp(k, 0), "c"), 1, 1, "mono8", 0, 1, np.zeros(1, np.uint8))
            data = store.serialize_cdr(message, "sensor_msgs/msg/Image")
            writer.write(topic, k * 10**9, data)
    return path


def mcap_without_imu(folder: Path) -> Path:
    path = folder / "empty.mcap"
    from mcap.writer import Writer as McapWriter  # noqa: PLC0415 - only this file

    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="", library="other")
        schema = writer.register_schema("Text", "jsonschema", b"{}")
        channel = writer.register_channel("/text", "json", schema)
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()  # type: ignore[no-untyped-call] # the library has no types
    return path


def database(folder: Path) -> Path:
    path = folder / "notes.db3"
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE notes (text TEXT)")
    connection.close()
    return path


def pickles(folder: Path) -> Path:
    np.savez(folder / "a.npz", t=np.array([{"a": 1}] * 5), g=np.zeros((5, 3)))
    return folder / "a.npz"


def hdf5(folder: Path) -> Path:
    h5py = pytest.importorskip("h5py")
    with h5py.File(folder / "a.h5", "w") as file:
        file["x"] = np.zeros(3)
    return folder / "a.h5"


def tar_archive(folder: Path) -> Path:
    with tarfile.open(folder / "a.tar", "w") as out:
        info = tarfile.TarInfo("Gyroscope.csv")
        info.size = 3
        out.addfile(info, io.BytesIO(b"a,b"))
    return folder / "a.tar"


def lying_ulog(folder: Path) -> Path:
    """Write 300 bytes that describe a type with four billion fields."""

    def message(kind: bytes, body: bytes) -> bytes:
        return struct.pack("<HB", len(body), kind[0]) + body

    content = b"\x55\x4c\x6f\x67\x01\x12\x35\x01" + bytes(8)
    content += message(b"F", b"inner:float[65000] x;") + message(
        b"F", b"sensor_gyro:uint64_t timestamp;inner[65000] y;"
    )
    content += message(b"A", b"\0\0\0sensor_gyro")
    (folder / "a.ulg").write_bytes(content)
    return folder / "a.ulg"


def ulog_without_gyro(folder: Path) -> Path:
    return write_ulog(folder, simulate_session(3, moves=1), ["battery_status"])


def ximu3_without_numbers(folder: Path) -> Path:
    path = write_ximu3(folder, simulate_session(3, moves=1))
    (path / "Inertial.csv").write_text("Timestamp (us),Gyroscope X (deg/s)\n1,2\n")
    return path


XLSX = {"[Content_Types].xml": b"<Types/>", "xl/workbook.xml": b"<workbook/>"}
HTML = "<!DOCTYPE html>\n<html><head><title>404 Not Found</title></head></html>\n"
LFS = "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n"
NMEA = "$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\n" * 5
WORDS = "name,town\nAnn,Rome\nBob,Oslo\n"
MARKED = "\ufeffa,b\n1,2\n"
CALIBRATION = "schema: gyrorig/calibration/1\nboard: {id: A}\n"

# name -> file, what the line names, what it tells the person to do
WRONG: dict[str, tuple[WrongFile, str, str]] = {
    "jpeg": (plain("a.jpg", b"\xff\xd8\xff\xe0" + bytes(99)), "a picture (JPEG)", "Give a file"),
    "png": (plain("a.csv", b"\x89PNG\r\n\x1a\n" + bytes(99)), "a picture (PNG)", "Give a file"),
    "pdf": (plain("a.pdf", "%PDF-1.7\n%\xe2\n"), "a PDF document", "Give a file"),
    "empty": (plain("a.csv", b""), "an empty file", "Copy the file again"),
    "missing": (lambda folder: folder / "none.csv", "does not exist", "Give the path"),
    "empty folder": (empty_folder, "a folder that contains nothing", "Give a file or folder"),
    "folder of pictures": (folder_of_pictures, "a folder that contains IMG_0.jpg", "Give a file"),
    "zip bomb": (zip_bomb, "a line of more than", "one line per sample"),
    "zip bomb of lines": (zip_bomb_of_lines, "more than 100000 rows", "Split"),
    "zip of words": (archive("a.zip", {"a.txt": b"x"}), "a ZIP archive", "Unpack it"),
    "cut zip": (cut(write_sensor_logger, 0.5), "a damaged or incomplete ZIP", "Copy the file"),
    "cut phyphox": (cut(write_phyphox, 0.5), "a damaged or incomplete ZIP", "Copy the file"),
    "cut ulog header": (cut(write_ulog, 0.00001), "which `gyrorig import` cannot read", "Give a"),
    "cut ulog": (cut(write_ulog, 0.0003), "damaged or incomplete", "Copy the log"),
    "ulog of four billion fields": (lying_ulog, "too many fields", "Copy the log"),
    "ulog without gyro": (ulog_without_gyro, "contains no gyroscope", "Set SDLOG_PROFILE"),
    "cut dataflash": (cut(write_dataflash, 0.0002), "too short for", "Download the log"),
    "dataflash without formats": (
        plain("a.bin", b"\xa3\x95\x80" + bytes(100)), "contains no FMT message", "Download the log"
    ),
    "dataflash without gyro": (
        plain("a.bin", dataflash_head(["BAT"]) + dataflash_message("BAT", 1, 16.0, 1)),
        "no messages of a gyroscope", "LOG_BITMASK",
    ),
    "cut blackbox": (cut(write_blackbox, 0.005), "header of the blackbox log", "Download the log"),
    "cut xsens": (cut(write_xsens, 0.0001), "text", "Give"),
    "x-imu3 without accelerometer": (ximu3_without_numbers, "has no column", "Did you mean"),
    "bag of images": (bag_of_images, "sensor_msgs/msg/Image", "Record the topic of the IMU"),
    "mcap without imu": (mcap_without_imu, "not a ROS 2 bag", "Give a recording"),
    "database": (database, "a SQLite database", "Give a file or folder"),
    "csv without map": (plain("a.csv", "a,b\n1,2\n3,4\n"), "needs a column map", "--map"),
    "csv of words": (plain("a.csv", WORDS), "needs a column map", "--map"),
    "csv with a byte order mark": (plain("a.csv", MARKED), "needs a column map", "--map"),
    "utf-16": (plain("a.csv", "t,x\n0,1\n".encode("utf-16")), "a text in UTF-16", "as UTF-8"),
    "xlsx": (archive("a.xlsx", XLSX), "an Excel workbook", "Save the sheet as a table (CSV)"),
    "hdf5": (hdf5, "needs a column map", "complete this map"),
    "npz of pickles": (pickles, "a.npz", "--map"),
    "gzip": (plain("a.csv.gz", gzip.compress(b"t,x\n0,1\n")), "(gzip)", "Unpack it"),
    "tar": (tar_archive, "a tar archive", "Unpack it"),
    "calibration": (plain("a.yaml", CALIBRATION), "a calibration", "Give a file or folder"),
    "findings": (plain("a.yaml", "schema: gyrorig/findings/1\n"), "findings", "Give a file"),
    "git lfs": (plain("a.npz", LFS), "a pointer of Git LFS", "git lfs pull"),
    "html": (plain("a.csv", HTML), "a web page", "Download the file again"),
    "nmea": (plain("a.csv", NMEA), "a GPS log (NMEA)", "log of a gyroscope"),
    "pcap": (plain("a.pcap", b"\xd4\xc3\xb2\xa1" + bytes(20)), "network capture", "Give a file"),
    "random bytes": (plain("a.bin", bytes(range(256)) * 9), "a binary file", "Give a file"),
}  # fmt: skip


@pytest.fixture
def bounded_memory() -> Iterator[None]:
    """Limit the address space of this process while a wrong file is read."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + MAX_EXTRA_BYTES
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (limit, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, before)


def check_one_line(text: str) -> None:
    assert "Traceback" not in text
    lines = [line for line in text.splitlines() if line and not line.startswith("importing")]
    assert len(lines) == 1, text
    assert len(lines[0]) < 700


@pytest.mark.parametrize("name", WRONG)
def test_import_says_what_a_wrong_file_is_and_what_to_do(
    tmp_path: Path,
    name: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    bounded_memory: None,
) -> None:
    monkeypatch.setattr(text_columns, "MAX_ROWS", 100_000)
    write, what, remedy = WRONG[name]
    (tmp_path / "in").mkdir()
    source, out = write(tmp_path / "in"), tmp_path / "out.mcap"
    status = run(["--quiet", "import", str(source), "--output", str(out)])
    text = capsys.readouterr().err
    assert status in REFUSED, text
    check_one_line(text)
    assert what in text
    assert remedy in text
    assert not out.exists()


@pytest.mark.parametrize("command", ["solve", "check"])
@pytest.mark.parametrize("name", ["jpeg", "ulog without gyro", "html", "csv of words", "git lfs"])
def test_solve_and_check_refuse_what_is_not_a_recording(
    tmp_path: Path, name: str, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    source = WRONG[name][0](tmp_path)
    extra = ["--out", str(tmp_path / "calibrations")] if command == "solve" else []
    status = run(["--quiet", command, str(source), *extra])
    text = capsys.readouterr().err
    assert status in REFUSED
    check_one_line(text)
    assert "not a recording" in text
    has_import = name in ("ulog without gyro", "csv of words")
    assert ("gyrorig import" in text) == has_import
