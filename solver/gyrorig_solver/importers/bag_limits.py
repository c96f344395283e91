"""Limits of the bags of others, checked before a library loads them.

What to use when: `check_mcap_chunks` and `check_ros1_chunks` before the library unpacks a bag;
`parsing_errors` around every call of a library that parses untrusted bytes.
"""

import bz2
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import lz4.frame  # type: ignore[import-untyped]
import zstandard

from gyrorig_protocol.errors import GyrorigError, InputError

MAX_CHUNK_BYTES = 512_000_000  # unpacked; recorders make chunks of about 1 MB
PIECE_BYTES = 1 << 20
MCAP_MAGIC = b"\x89MCAP0\r\n"
ROS1_MAGIC = b"#ROSBAG V2.0\n"
_MCAP_CHUNK = 0x06
_ROS1_CHUNK = b"\x05"


@contextmanager
def parsing_errors(name: str, remedy: str) -> Iterator[None]:
    """Convert any error of a parsing library to an `InputError` of one line.

    Args:
        name: the file.
        remedy: what to do.
    """
    try:
        yield
    except (GyrorigError, ModuleNotFoundError):
        raise
    except Exception as error:  # noqa: BLE001, RUF100 - untrusted bytes: a library can raise anything
        text = " ".join(str(error).split())[:160] or type(error).__name__
        raise InputError(f"the file {name} cannot be read ({text.rstrip('.')})", remedy) from error


def check_mcap_chunks(path: Path) -> None:
    """Check the sizes of all records of an MCAP file, packed and unpacked.

    Raises:
        InputError: the file ends inside a record, or a chunk is larger than it states.
    """
    with path.open("rb") as file:
        end = path.stat().st_size
        file.seek(len(MCAP_MAGIC))
        while (head := file.read(9)) and head != MCAP_MAGIC:
            if len(head) < 9:
                break  # the final magic has 8 bytes
            opcode, length = head[0], int.from_bytes(head[1:], "little")
            start = file.tell()
            if start + length > end:
                raise InputError(
                    f"the file {path.name} ends inside a record, so its recording was not finished",
                    "repair it with `mcap recover`",
                )
            if opcode == _MCAP_CHUNK:
                fields = file.read(min(length, 64))
                unpacked, _, name_length = struct.unpack_from("<QII", fields, 16)
                name = fields[32 : 32 + name_length].decode("ascii", errors="replace")
                file.seek(start + 40 + name_length)
                packed = _read_checked(file, length - 40 - name_length, unpacked, path.name)
                _check_unpacked(packed, name, unpacked, path.name)
            elif length > MAX_CHUNK_BYTES:
                raise _too_large(path.name)
            file.seek(start + length)


def check_ros1_chunks(path: Path) -> None:
    """Check the sizes of all records of a ROS 1 bag, packed and unpacked.

    Raises:
        InputError: the file ends inside a record, or a chunk is larger than it states.
    """
    with path.open("rb") as file:
        end = path.stat().st_size
        file.seek(len(ROS1_MAGIC))
        while head := file.read(4):
            header_length = int.from_bytes(head, "little")
            if len(head) < 4 or file.tell() + header_length + 4 > end:
                raise _unfinished_ros1(path.name)
            fields = _ros1_fields(_read_checked(file, header_length, 0, path.name))
            length = int.from_bytes(file.read(4), "little")
            start = file.tell()
            if start + length > end:
                raise _unfinished_ros1(path.name)
            if fields.get(b"op") == _ROS1_CHUNK:
                unpacked = int.from_bytes(fields.get(b"size", b""), "little")
                packed = _read_checked(file, length, unpacked, path.name)
                name = fields.get(b"compression", b"").decode("ascii", errors="replace")
                _check_unpacked(packed, name, unpacked, path.name)
            elif length > MAX_CHUNK_BYTES:
                raise _too_large(path.name)
            file.seek(start + length)


def _ros1_fields(header: bytes) -> dict[bytes, bytes]:
    fields = {}
    at = 0
    while at + 4 <= len(header):
        length = int.from_bytes(header[at : at + 4], "little")
        name, _, value = header[at + 4 : at + 4 + length].partition(b"=")
        fields[name] = value
        at += 4 + length
    return fields


def _read_checked(file: IO[bytes], length: int, unpacked: int, name: str) -> bytes:
    if length < 0 or max(length, unpacked) > MAX_CHUNK_BYTES:
        raise _too_large(name)
    return file.read(length)


def _check_unpacked(packed: bytes, compression: str, unpacked: int, name: str) -> None:
    """Unpack without keeping anything, and stop at the stated size."""
    counters: dict[str, Callable[[bytes], Iterator[int]]] = {
        "zstd": _zstd_sizes,
        "lz4": _lz4_sizes,
        "bz2": _bz2_sizes,
    }
    if compression not in counters:
        return  # not packed, or a compression that the library refuses
    total = 0
    with parsing_errors(name, "copy the bag again from its source"):
        for size in counters[compression](packed):
            total += size
            if total > unpacked:
                break
    if total != unpacked:
        raise InputError(
            f"a chunk of the file {name} is not as large as it states",
            "copy the bag again from its source",
        )


def _zstd_sizes(packed: bytes) -> Iterator[int]:
    reader = zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True)
    while piece := reader.read(PIECE_BYTES):
        yield len(piece)


def _lz4_sizes(packed: bytes) -> Iterator[int]:
    decompressor = lz4.frame.LZ4FrameDecompressor()
    piece = decompressor.decompress(packed, max_length=PIECE_BYTES)
    yield len(piece)
    while piece and not decompressor.eof:
        piece = decompressor.decompress(b"", max_length=PIECE_BYTES)
        yield len(piece)


def _bz2_sizes(packed: bytes) -> Iterator[int]:
    while packed:
        decompressor = bz2.BZ2Decompressor()
        piece = decompressor.decompress(packed, max_length=PIECE_BYTES)
        yield len(piece)
        while not decompressor.eof and not (decompressor.needs_input and not piece):
            piece = decompressor.decompress(b"", max_length=PIECE_BYTES)
            yield len(piece)
        packed = decompressor.unused_data


def _too_large(name: str) -> InputError:
    return InputError(
        f"the file {name} has a record of more than {MAX_CHUNK_BYTES // 1_000_000} MB",
        "record again without images, or only the topics of the IMU and of the reference",
    )


def _unfinished_ros1(name: str) -> InputError:
    return InputError(
        f"the file {name} ends inside a record, so its recording was not finished",
        "repair it with `rosbag reindex`",
    )
