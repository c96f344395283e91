"""MATLAB, HDF5 and Parquet files: a map printed to complete, imported, solved, compared."""

import zlib
from pathlib import Path

import h5py  # type: ignore[import-untyped]
import numpy as np
import pytest
from scipy.io import savemat
from tests.support.foreign_files import write_matlab5, write_matlab73, write_parquet
from tests.support.simulated_attitudes import SimulatedAttitudes, simulate_attitudes
from tests.support.solved_truth import check_solved

from gyrorig_protocol.documents import parse_yaml
from gyrorig_protocol.errors import InputError
from gyrorig_solver import cli
from gyrorig_solver.importers import MissingMapError, array_files, find_format, import_files
from gyrorig_solver.importers.measurement_columns import open_columns

MATLAB_MAP = """
schema: gyrorig/import/1
board: IMU-7
sensor: MPU-6050
time: {key: PREFIXt_imu, unit: s}
gyro: {keys: [PREFIXgyr], unit: deg/s}
attitude: {keys: [PREFIXquat], order: wxyz, time: {key: PREFIXt_cam}}
"""
PARQUET_MAP = """
schema: gyrorig/import/1
board: IMU-7
sensor: MPU-6050
time: {key: time_us, unit: us}
gyro: {keys: [gyro_x, gyro_y, gyro_z], unit: rad/s}
attitude: {keys: [qx, qy, qz, qw], order: xyzw}
"""


@pytest.fixture(scope="module")
def session() -> SimulatedAttitudes:
    return simulate_attitudes(4, span_s=40.0)


@pytest.fixture(scope="module")
def short() -> SimulatedAttitudes:
    return simulate_attitudes(2, span_s=5.0)


@pytest.mark.parametrize("kind", ["v5", "v5-struct", "v7.3", "parquet"])
def test_a_file_of_arrays_is_imported_with_a_map_and_solved(
    kind: str, session: SimulatedAttitudes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    source = Path("log.dat")
    text = MATLAB_MAP.replace("PREFIX", "" if kind == "v5" else "log.")
    if kind == "v7.3":
        write_matlab73(source, session)
    elif kind == "parquet":
        write_parquet(source, session)
        text = PARQUET_MAP
    else:
        write_matlab5(source, session, as_struct=kind == "v5-struct")
    Path("map.yaml").write_text(text)
    assert cli.run(["import", "log.dat", "--map", "map.yaml"]) == 0
    check_solved(tmp_path / "log.mcap", session, tmp_path / "calibrations")


def test_without_a_map_the_import_prints_one_to_complete(
    short: SimulatedAttitudes,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    write_parquet(Path("log.parquet"), short)
    assert find_format(Path("log.parquet"))[1].description == "a Parquet file"
    assert cli.run(["import", "log.parquet"]) == 2
    printed = capsys.readouterr()
    assert printed.err.count("\n") == 1
    assert "does not specify what its columns measure: time_us, gyro_x, gyro_y" in printed.err
    assert parse_yaml(printed.out, "map")["gyro"] == {
        "keys": ["gyro_x", "gyro_y", "gyro_z"],
        "unit": "UNIT",
    }
    sketch = printed.out
    Path("sketch.yaml").write_text(sketch)
    assert cli.run(["import", "log.parquet", "--map", "sketch.yaml"]) == 2  # no unit is guessed
    complete = sketch.replace("unit: UNIT}  # s,", "unit: us}  # s,")
    complete = complete.replace("UNIT}  # rad/s", "rad/s}  # rad/s").replace("ORDER", "xyzw")
    Path("map.yaml").write_text(complete)
    assert cli.run(["import", "log.parquet", "--map", "map.yaml"]) == 0


def test_tables_and_matlab_files_print_a_map_too(short: SimulatedAttitudes, tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("timestamp;acc_x;acc_y;acc_z;wx;wy;wz\n1;2;3;4;5;6;7\n")
    write_matlab73(tmp_path / "log.mat", short)
    for name, keys in (
        ("log.csv", ["wx", "wy", "wz"]),
        ("log.mat", ["log.gyr"]),
    ):
        with pytest.raises(MissingMapError) as caught:
            import_files([tmp_path / name], tmp_path / "out.mcap")
        assert parse_yaml(caught.value.sketch, "map")["gyro"]["keys"] == keys


def test_damaged_files_of_arrays_are_refused_in_one_line(
    short: SimulatedAttitudes, tmp_path: Path
) -> None:
    for source, name in (
        (write_matlab5(tmp_path / "a.mat", short), "quat"),
        (write_matlab73(tmp_path / "b.mat", short), "log.quat"),
        (write_parquet(tmp_path / "c.parquet", short), "qx"),
    ):
        whole = source.read_bytes()
        cut = tmp_path / f"cut-{source.stem}"
        cut.write_bytes(whole[: len(whole) * 2 // 3])
        with pytest.raises(InputError) as caught:
            open_columns(cut, [name])
        assert "\n" not in str(caught.value)


def test_a_small_file_that_unpacks_to_gigabytes_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(array_files, "MAX_ARRAY_BYTES", 10_000_000)
    savemat(tmp_path / "big.mat", {"gyr": np.zeros((1_000_000, 3))}, do_compression=True)
    assert (tmp_path / "big.mat").stat().st_size < 100_000
    with pytest.raises(InputError, match="need more than"):
        open_columns(tmp_path / "big.mat", ["gyr"])
    packed = zlib.compress(bytes(20_000_000))
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    element = (15).to_bytes(4, "little") + len(packed).to_bytes(4, "little") + packed
    (tmp_path / "bomb.mat").write_bytes(head + element)
    with pytest.raises(InputError, match="need more than"):
        open_columns(tmp_path / "bomb.mat", ["gyr"])


def test_links_out_of_a_file_are_not_followed(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file["gyr"] = np.ones((10, 3))
    (tmp_path / "raw.bin").write_bytes(bytes(240))
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["gyr"] = h5py.ExternalLink("secret.h5", "gyr")
        file["t"] = np.arange(10.0)
        file.create_dataset(
            "raw", (10, 3), dtype="f8", external=[(str(tmp_path / "raw.bin"), 0, 240)]
        )
    for name in ("gyr", "raw"):
        with pytest.raises(InputError, match=f"contains no array '{name}'"):
            open_columns(tmp_path / "log.h5", [name])
