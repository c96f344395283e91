"""Inputs of the golden set that no program of the project makes: files of other origin.

What to use when: add a function to `MATERIALS`, with the recordings that it starts from. Each
function writes into an empty folder and depends on nothing but its inputs.

Nothing here imports the project. A recording is read as the contract of recordings describes
it: MCAP records, and IMU messages of 64 bytes.
"""

import shutil
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from mcap.reader import make_reader
from tests.goldens import tables

_MAGIC_BYTES = 8
_CHUNK_OPCODE = 0x06
_BOARD = "GY80-1"
_EMULATED = {"port": "emulated", "baud": 460800}
_SENSOR = {"odr_hz": 100, "bandwidth_hz": 25.0, "gyro_full_scale_dps": 250}


@dataclass(frozen=True, slots=True)
class Material:
    """How a folder of input files is made.

    Attributes:
        make: writes into its first folder, reads the folders of `needs`, in their order.
        needs: names of the cases whose output it reads.
    """

    make: Callable[..., None]
    needs: tuple[str, ...] = ()


def _write_yaml(path: Path, document: object) -> None:
    path.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")


def _rig(name: str, boards: list[dict[str, object]], **more: object) -> dict[str, object]:
    return {
        "schema": "gyrorig/rig/1",
        "rig": name,
        "site": {"gravity_m_s2": 9.80665},
        "ptu": {"port": "emulated", "baud": 115200},
        "boards": boards,
        "emulator": {"seed": 1, **_SENSOR},
        **more,
    }


def make_rigs(out: Path) -> None:
    """Write rig configurations: four boards, a CAN bus, an older unit, one not homed."""
    single_board: list[dict[str, object]] = [{"id": _BOARD, **_EMULATED}]
    four: list[dict[str, object]] = [{"id": f"B{number}", **_EMULATED} for number in range(1, 5)]
    on_bus: list[dict[str, object]] = [
        {"id": f"C{node}", "bus": "can0", "node": node} for node in (1, 2)
    ]
    bus = {"id": "can0", "port": "emulated", "bitrate": 1000000, "sync_hz": 5.0}
    older = {**_SENSOR, "seed": 1, "dialect": "d46", "odr_hz": 200, "bandwidth_hz": 50.0}
    unit = {"port": "emulated", "baud": 9600, "pan_sign": -1}
    _write_yaml(out / "four.yaml", _rig("four", four))
    _write_yaml(out / "can.yaml", _rig("can", on_bus, buses=[bus]))
    _write_yaml(out / "d46.yaml", _rig("older", single_board, ptu=unit, emulator=older))
    not_homed = {**_SENSOR, "seed": 1, "homed": False}
    _write_yaml(out / "not-homed.yaml", _rig("not-homed", single_board, emulator=not_homed))


def make_programs(out: Path) -> None:
    """Write motion programs: a short one that shows all parameters, and one out of range."""
    settings = {"base_speed_deg_s": 3.0, "acceleration_deg_s2": 200.0, "default_speed_deg_s": 90.0}
    steps: list[dict[str, object]] = [{"rest": {"seconds": 2.5, "phase": "static"}}]
    for pan_deg, tilt_deg in ((90, 0), (90, 28), (-90, 28), (-90, -44), (90, -44), (0, 0)):
        steps += [{"move": {"pan_deg": pan_deg, "tilt_deg": tilt_deg}}, {"rest": {"seconds": 0.4}}]
    steps.append({"rest": {"seconds": 2.5, "phase": "static"}})
    document = {"schema": "gyrorig/program/1", "name": "short", "settings": settings}
    _write_yaml(out / "short.yaml", {**document, "steps": steps})
    too_far = [{"move": {"pan_deg": 900.0}}]
    _write_yaml(out / "too-far.yaml", {**document, "name": "too-far", "steps": too_far})


def make_text(out: Path) -> None:
    """Write an empty file, a file of text, and YAML that is none of the project's documents."""
    (out / "empty.mcap").touch()
    (out / "text.mcap").write_text("this is not a recording\n" * 40, encoding="utf-8")
    (out / "foreign.yaml").write_text("schema: somebody/else/7\nanswer: 42\n", encoding="utf-8")


def make_fleet_table(out: Path) -> None:
    """Write the table of lots and sites."""
    (out / "boards.csv").write_text(
        "board,lot,site\nGY80-1,L1,north\nB1,L1,north\nB2,L2,north\nB3,L2,south\n", encoding="utf-8"
    )


def _only_recording(folder: Path) -> Path:
    (path,) = folder.glob("*.mcap")
    return path


def _chunks(content: bytes) -> Iterator[tuple[int, int]]:
    """Yield where each chunk of a recording begins and ends, in bytes."""
    at = _MAGIC_BYTES
    while at + 9 <= len(content) - _MAGIC_BYTES:
        opcode, length = struct.unpack_from("<BQ", content, at)
        if opcode == _CHUNK_OPCODE:
            yield at, at + 9 + length
        at += 9 + length


def make_truncated(out: Path, recording: Path) -> None:
    """Cut a recording in the middle of the chunk two thirds through it."""
    content = _only_recording(recording).read_bytes()
    chunks = list(_chunks(content))
    begin, end = chunks[2 * len(chunks) // 3]
    for name in ("cut.mcap", "cut.mcap.part"):
        (out / name).write_bytes(content[: (begin + end) // 2])


def make_damaged(out: Path, recording: Path) -> None:
    """Change one byte in the middle of one chunk of a recording."""
    content = bytearray(_only_recording(recording).read_bytes())
    chunks = list(_chunks(bytes(content)))
    begin, end = chunks[len(chunks) // 2]
    content[(begin + end) // 2] ^= 0xFF
    (out / "flipped.mcap").write_bytes(bytes(content))


def make_unclean(out: Path, recording: Path) -> None:
    """Leave an unfinished recording, as a power cut does."""
    make_truncated(out, recording)
    (out / "cut.mcap").unlink()


def make_spool(out: Path, *recordings: Path) -> None:
    """Copy recordings of several nights and boards, a cut one and a foreign file."""
    for number, folder in enumerate(recordings):
        shutil.copyfile(_only_recording(folder), out / f"night-{number}.mcap")
    content = (out / "night-1.mcap").read_bytes()
    (out / "short-copy.mcap").write_bytes(content[: len(content) // 2])
    (out / "text.mcap").write_text("this is not a recording\n", encoding="utf-8")


def make_spool_of_one(out: Path, recording: Path) -> None:
    """Copy one recording."""
    shutil.copyfile(_only_recording(recording), out / "night.mcap")


def make_phone(out: Path, recording: Path) -> None:
    """Write the log of a phone that was on the stage and has a separate clock."""
    ticks, counts = [], []
    with _only_recording(recording).open("rb") as stream:
        reader = make_reader(stream)
        scale = 0.0
        for item in reader.iter_metadata():
            if item.name == f"gyrorig.board.{_BOARD}":
                scale = float(item.metadata["gyro_scale_rad_s"])
        for _, _, message in reader.iter_messages(topics=[f"/board/{_BOARD}/imu_raw"]):
            fields = struct.unpack_from("<iIQIHh3i", message.data, 4)
            ticks.append(fields[2] & 0xFFFFFFFF)
            counts.append(fields[6:9])
    step = np.remainder(np.diff(np.array(ticks, np.int64)), 1 << 32)
    time_s = np.concatenate([[0.0], np.cumsum(step) * 1e-6]) * 1.000040 + 54321.7
    lines = ["time,seconds_elapsed,z,y,x"]
    rates = np.array(counts, np.float64) * scale
    for at_s, (x, y, z) in zip(time_s.tolist(), rates.tolist(), strict=True):
        lines.append(f"0,{at_s:.9f},{z:.9f},{y:.9f},{x:.9f}")
    log = out / "GyroscopeUncalibrated.csv"
    log.write_text("\n".join(lines) + "\n", encoding="utf-8")


MATERIALS = {
    "rigs": Material(make_rigs),
    "programs": Material(make_programs),
    "text": Material(make_text),
    "fleet-table": Material(make_fleet_table),
    "attitude": Material(tables.make_attitude),
    "turns": Material(tables.make_turns),
    "gravity": Material(tables.make_gravity),
    "phone": Material(make_phone, ("rec-plain",)),
    "truncated": Material(make_truncated, ("rec-plain",)),
    "damaged": Material(make_damaged, ("rec-plain",)),
    "unclean": Material(make_unclean, ("rec-quick",)),
    "spool": Material(make_spool, ("rec-plain", "rec-quick", "rec-four", "rec-rest", "rec-can")),
    "spool-backlash": Material(make_spool_of_one, ("rec-backlash",)),
}
