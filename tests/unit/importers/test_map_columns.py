"""Columns that a map can name: occurrences, numbers, array elements, layouts, several files."""

import zipfile
from pathlib import Path

import msgspec
import numpy as np
import pytest
from docs.map_page import read_key_meanings
from docs.site_pages import PAGES
from scipy.spatial.transform import Rotation
from tests.unit.importers.test_import_measurements import BASE, archive, mapped, messages, sound

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_solver.data import FloatArray
from gyrorig_solver.importers import ImportMap, import_measurements
from gyrorig_solver.importers.map_keys import (
    AccelColumns,
    AttitudeColumns,
    GyroColumns,
    TableLayout,
    TimeBase,
)
from gyrorig_solver.importers.matrix_attitudes import quaternions_of_matrices
from gyrorig_solver.importers.measurement_columns import open_columns

THREE = BASE.replace("[g]", "[x, y, z]")


def table(tmp_path: Path, text: str, name: str = "in.csv") -> Path:
    path = tmp_path / name
    path.write_text(text)
    return path


def column(path: Path, key: str | int, **layout: object) -> list[float]:
    made = TableLayout(**layout)  # type: ignore[arg-type] # keys of the layout by name
    return [float(value) for value in open_columns(path, [key], made).matrix([key], 1)[:, 0]]


def test_a_name_that_occurs_twice_is_refused_with_both_numbers(tmp_path: Path) -> None:
    source = table(tmp_path, "t,w,x,y,z,x,y,z\n0,1,0,0,0,7,8,9\n1,1,0,0,0,7,8,9\n")
    with pytest.raises(InputError, match=r"2 columns with the name 'x'.*columns 3 and 6") as caught:
        import_measurements(source, mapped(THREE), tmp_path / "o.mcap")
    assert '"x#1" or "x#2"' in str(caught.value)
    assert "(3 or 6)" in str(caught.value)
    assert not (tmp_path / "o.mcap").exists()


@pytest.mark.parametrize("keys", ['["x#2", "y#2", "z#2"]', "[6, 7, 8]"])
def test_an_occurrence_or_a_number_says_which_column(tmp_path: Path, keys: str) -> None:
    source = table(tmp_path, "t,w,x,y,z,x,y,z\n0,1,0,0,0,.7,.8,.9\n1,1,0,0,0,.7,.8,.9\n")
    mapping = mapped(BASE.replace("[g]", keys))
    summary = import_measurements(source, mapping, tmp_path / "o.mcap")
    first = messages(summary.path, "/board/B1/imu_raw")[0]
    assert list(first.gyro) == [7_000_000, 8_000_000, 9_000_000]


def test_a_name_with_a_number_sign_is_first_a_name(tmp_path: Path) -> None:
    source = table(tmp_path, "x,x#2,x\n1,2,3\n")
    assert column(source, "x#2") == [2.0]
    assert column(source, "x#1") == [1.0]


def test_a_misspelt_name_gets_a_suggestion(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no column 'gyro_X'. Did you mean gyro_x"):
        column(table(tmp_path, "t,gyro_x\n0,1\n"), "gyro_X")
    with pytest.raises(InputError, match=r"no array 'gyro'. Did you mean gyr"):
        open_columns(archive(tmp_path / "in.npz", gyr=np.zeros(3)), ["gyro"])


def test_a_number_outside_the_table_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="has 2 columns, so it has no column 3"):
        column(table(tmp_path, "t,x\n0,1\n"), 3)


def test_rows_wider_than_the_header_are_refused(tmp_path: Path) -> None:
    """A decimal comma between commas shifts every column after it."""
    with pytest.raises(InputError, match=r"row 2 .* has 3 columns, but the header has 2"):
        column(table(tmp_path, "t,x\n0,1\n1,2,5\n"), "x")
    assert column(table(tmp_path, "t,x\n0,1,\n1,2,\n"), "x") == [1.0, 2.0]


@pytest.mark.parametrize(
    ("text", "key", "layout", "values"),
    [
        ("# made by X\n# y\nt,x\n# z\n0,1\n", "x", {"comment": "#"}, [1.0]),
        ("made by X\n\nt,x\n0,1\n", "x", {"skip_rows": 2}, [1.0]),
        ("t,x\ns,deg/s\n0,1\n", "x", {"header_rows": 2}, [1.0]),
        ("t,x\ns,deg/s\n0,1\n", "x deg/s", {"header_rows": 2}, [1.0]),
        ("gyro,,accel,\nx,y,x,y\n1,2,3,4\n", "accel y", {"header_rows": 2}, [4.0]),
        ("0 1   2\n 3 4 5\n", 2, {"header_rows": 0, "delimiter": "space"}, [1.0, 4.0]),
        ("t;x\n0,5;1,25\n1,5;-2,5e1\n", "x", {"decimal": "comma"}, [1.25, -25.0]),
        ("t,a b,x;c\n0,1,2\n", "x;c", {"delimiter": "comma"}, [2.0]),
        ("\ufefft,x\n0,1\n", "t", {}, [0.0]),
    ],
)
def test_layouts_of_tables(
    tmp_path: Path, text: str, key: str | int, layout: dict[str, object], values: list[float]
) -> None:
    assert column(table(tmp_path, text), key, **layout) == values


def test_a_group_line_makes_a_name_unique(tmp_path: Path) -> None:
    source = table(tmp_path, "gyro,,accel,\nx,y,x,y\n1,2,3,4\n")
    with pytest.raises(InputError, match="2 columns with the name 'x'"):
        column(source, "x", header_rows=2)
    assert column(source, "accel x", header_rows=2) == [3.0]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("t;x\n0,5;1,25\n", "Set `decimal: comma`"),
        ("t,x\ns,deg/s\n0,1\n", "If row 1 contains units, set `header_rows: 2`"),
    ],
)
def test_errors_name_the_key_of_the_layout(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        column(table(tmp_path, text), "x")


def test_a_file_of_one_long_line_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="a line of more than"):
        column(table(tmp_path, "t,x\n" + "0" * 200_000), "x")


def test_columns_of_arrays(tmp_path: Path) -> None:
    data = sound(20)
    source = archive(
        tmp_path / "in.npz", log=np.column_stack([data["t"], data["g"]]), other=np.zeros(3)
    )
    text = BASE.replace("key: t", 'key: "log[0]"').replace("[g]", '["log[1]", "log[2]", "log[3]"]')
    summary = import_measurements(source, mapped(text), tmp_path / "o.mcap")
    counts = np.array([m.gyro for m in messages(summary.path, "/board/B1/imu_raw")])
    assert np.abs(counts * 1e-7 - data["g"]).max() < 1e-7
    with pytest.raises(InputError, match="has no column 4"):
        open_columns(source, ["log[4]"]).matrix(["log[4]"], 1)


def test_an_array_shorter_than_its_header_is_never_allocated(tmp_path: Path) -> None:
    path = tmp_path / "in.npy"
    np.save(path, np.zeros(4))
    sound_array = path.read_bytes()
    for shape in (b"(9, ", b"(4, 9**9", b"(4000000000, 2), }"):
        lying = sound_array.replace(b"(4,), }".ljust(len(shape)), shape)
        with zipfile.ZipFile(tmp_path / "in.npz", "w") as out:
            out.writestr("a.npy", lying)
        with pytest.raises(InputError, match=r"damaged|shorter than its header"):
            open_columns(tmp_path / "in.npz", ["a"])


def test_zeros_per_axis(tmp_path: Path) -> None:
    data = sound(10)
    data["a"] = np.tile([0.1, 0.2, 1.3], (10, 1))
    text = BASE.replace("unit: rad/s}", "unit: rad/s, zero: [0.1, -0.2, 0.3]}")
    text += "accel: {keys: [a], unit: g, zero: [0.1, 0.2, 0.3]}\n"
    summary = import_measurements(
        archive(tmp_path / "in.npz", **data), mapped(text), tmp_path / "o.mcap"
    )
    result = messages(summary.path, "/board/B1/imu_raw")
    counts = np.array([m.gyro for m in result])
    assert np.abs(counts * 1e-7 - (data["g"] - [0.1, -0.2, 0.3])).max() < 1e-7
    assert np.allclose(np.array(result[0].accel) * 1e-6, [0.0, 0.0, 9.80665], atol=1e-6)


def test_offsets_of_counts_per_axis(tmp_path: Path) -> None:
    data = {"t": np.arange(10) * 0.01, "g": np.tile([32770, 32771, 5], (10, 1))}
    text = BASE.replace(
        "unit: rad/s}", "unit: counts, scale_rad_s: 1.0e-4, offset_counts: [32768, 32770, 0]}"
    )
    summary = import_measurements(
        archive(tmp_path / "in.npz", **data), mapped(text), tmp_path / "o.mcap"
    )
    assert list(messages(summary.path, "/board/B1/imu_raw")[0].gyro) == [2, 1, 5]


def rotations(count: int) -> Rotation:
    return Rotation.random(count, rng=np.random.default_rng(3))


@pytest.mark.parametrize("shape", [(-1, 9), (-1, 3, 3)])
def test_rotation_matrices_are_attitudes(tmp_path: Path, shape: tuple[int, ...]) -> None:
    data = sound(50)
    truth = rotations(50)
    data["r"] = truth.as_matrix().reshape(shape)
    text = BASE + "attitude: {keys: [r], order: matrix}\n"
    summary = import_measurements(
        archive(tmp_path / "in.npz", **data), mapped(text), tmp_path / "o.mcap"
    )
    read = Rotation.from_quat(
        [m.orientation for m in messages(summary.path, "/reference/attitude")]
    )
    assert (read.inv() * truth).magnitude().max() < 1e-7


def test_every_branch_of_the_conversion_agrees_with_scipy() -> None:
    half_turns = Rotation.from_rotvec(np.concatenate([np.pi * np.eye(3), np.zeros((1, 3))]))
    truth = Rotation.concatenate([rotations(500), half_turns])
    rows: FloatArray = truth.as_matrix().reshape(-1, 9)
    read = Rotation.from_quat(quaternions_of_matrices(rows))
    assert (read.inv() * truth).magnitude().max() < 1e-7
    assert np.isnan(quaternions_of_matrices(np.full((1, 9), np.nan))).all()


@pytest.mark.parametrize(
    ("matrix", "says"),
    [
        (2.0 * np.eye(3), "row 3 of the attitude columns is not a rotation matrix"),
        (np.diag([1.0, 1.0, -1.0]), "row 3 of the attitude columns is a reflection"),
    ],
)
def test_matrices_that_are_no_rotations_are_refused(matrix: FloatArray, says: str) -> None:
    rows = np.tile(np.eye(3).ravel(), (5, 1))
    rows[2] = matrix.ravel()
    with pytest.raises(InputError, match=says):
        quaternions_of_matrices(rows)


def test_streams_in_several_files(tmp_path: Path) -> None:
    source = table(
        tmp_path, "t,x,y,z\n" + "".join(f"{k / 100},1,2,3\n" for k in range(100)), "gyro.csv"
    )
    table(
        tmp_path,
        "exported by X\nframe;time;w;x;y;z\n"
        + "".join(f"{k};{k / 50};1;0;0;0\n" for k in range(40)),
        "mocap.csv",
    )
    text = THREE + (
        "attitude: {keys: [w, x, y, z], order: wxyz, file: mocap.csv, table: {skip_rows: 1}, "
        "time: {key: time}}\n"
    )
    summary = import_measurements(source, mapped(text), tmp_path / "o.mcap")
    assert (summary.samples, summary.attitudes) == (100, 40)
    (tmp_path / "mocap.csv").unlink()
    with pytest.raises(InputError, match=r"mocap.csv does not exist"):
        import_measurements(source, mapped(text), tmp_path / "p.mcap")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (BASE + "accel: {keys: [a], unit: g, file: b.csv}\n", "has no times"),
        (BASE + "accel: {keys: [a], unit: g, table: {}}\n", "but no key `file`"),
        (BASE + "accel: {keys: [a], unit: g, file: ../b.csv}\n", "file is the text"),
        (BASE + "accel: {keys: [a], unit: g, file: /etc/passwd}\n", "file is the text"),
        (BASE + "table: {decimal: comma, delimiter: comma}\n", "both between columns and in"),
        (BASE.replace("rad/s}", "rad/s, offset_counts: 3}"), "does not apply to the unit rad/s"),
        (BASE + "attitude: {keys: [a, b, c, d], order: matrix}\n", "4 entries instead of 1 or 9"),
    ],
)
def test_contradictions_are_refused(text: str, says: str) -> None:
    with pytest.raises(UsageError, match=says):
        mapped(text)


def test_every_key_of_a_map_has_a_meaning() -> None:
    page = PAGES["reference/import-map.md"]()
    for struct in (ImportMap, TableLayout, TimeBase, GyroColumns, AccelColumns, AttitudeColumns):
        fields = {field.encode_name for field in msgspec.structs.fields(struct)}
        assert set(read_key_meanings(struct)) == fields
        for name in fields:
            assert f"| `{name}` |" in page
