"""What `gyrorig store ls`, `show` and `diff` print, and which calibrations their filters leave."""

import hashlib
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from tests.unit.fleet.conftest import row

from gyrorig_protocol.identity import BoardId
from gyrorig_solver.calibration import (
    CalibrationDocument,
    CalibrationStore,
    create_store,
    parse_calibration,
)
from gyrorig_solver.calibration.calibration_document import calibration_as_yaml
from gyrorig_solver.cli import run
from gyrorig_solver.fleet.drift import build_overview
from gyrorig_solver.fleet.store import IndexRow, StoreIndex
from gyrorig_solver.fleet.store.coordination import RowJournal
from gyrorig_solver.fleet.store.index_rows import calibration_row
from gyrorig_solver.storage import Folder

GOLDEN = Path(__file__).parents[1] / "output" / "golden" / "good.yaml"
STD = 2.0**-12  # of every parameter of the golden calibration but the time offset


def document(
    board: str, version: int, day: int, solved_day: int, **more: Any
) -> CalibrationDocument:
    """Return a calibration of a recording of one day of January, solved on another."""
    plain = yaml.safe_load(GOLDEN.read_text(encoding="utf-8"))
    plain["board"] |= {"id": board, "sensor": more.get("sensor", "L3G4200D")}
    plain["board"]["config"]["config_hash"] = more.get("config", "c0ffee")
    plain |= {"version": version, "created": f"2026-01-{solved_day:02d}T03:00:00Z"}
    plain["inputs"][0] |= {
        "name": f"{board}-{day}.mcap",
        "sha256": hashlib.sha256(f"{board} {day}".encode()).hexdigest(),
        "start": f"2026-01-{day:02d}T02:00:00Z",
    }
    plain["parameters"]["bias"]["value"][0] = day / 1024.0
    return parse_calibration(yaml.safe_dump(plain), board)


def add_version(store: CalibrationStore, calibration: CalibrationDocument, rig: str) -> IndexRow:
    stored = store.add_version(
        BoardId(calibration.board.id), lambda _number, _before: calibration_as_yaml(calibration)
    )
    return calibration_row(
        calibration,
        key=f"{calibration.board.id}-{calibration.version}",
        batch="night",
        session="s",
        rig=rig,
        file=stored.name,
        file_sha256=stored.digest().removeprefix("sha256:"),
    )


@pytest.fixture(scope="module")
def written_store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three boards; the third version of GY-1 is of a backlog, measured before its second."""
    folder = tmp_path_factory.mktemp("written") / "store"
    store_of_boards = create_store(folder)
    rows = [
        add_version(store_of_boards, document("GY-1", 1, day=10, solved_day=10), "rig-a"),
        add_version(store_of_boards, document("GY-1", 2, day=13, solved_day=13), "rig-a"),
        add_version(
            store_of_boards, document("GY-1", 3, day=11, solved_day=15, config="beef"), "rig-b"
        ),
        add_version(store_of_boards, document("GY-2", 1, day=11, solved_day=11), "rig-b"),
        add_version(
            store_of_boards, document("BM-1", 1, day=12, solved_day=12, sensor="BMI270"), "rig-a"
        ),
        row("bad", status="rejected", board="", reason="no motion", names=["x.mcap"], inputs=["a"]),
        row("worse", status="failed", board="GY-2", reason="slow", names=["y.mcap"], inputs=["b"]),
    ]
    with RowJournal(Folder(folder), "night") as journal:
        journal.add(rows)
    StoreIndex(folder).merge_ended_batches()
    return folder


@pytest.fixture
def store(written_store: Path, tmp_path: Path) -> Path:
    """A copy of the store, for tests that change it."""
    return Path(shutil.copytree(written_store, tmp_path / "store"))


def output_of(capsys: pytest.CaptureFixture[str], *command: object, code: int = 0) -> str:
    capsys.readouterr()
    assert run(["store", *(str(word) for word in command)]) == code
    return capsys.readouterr().out


def test_ls_prints_the_last_recorded_version_of_each_board(
    store: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = [" ".join(line.split()) for line in output_of(capsys, "ls", store).splitlines()]
    assert lines == [
        "board version verdict created recorded sensor rig",
        "BM-1 1 good 2026-01-12 03:00 2026-01-12 02:00 BMI270 rig-a",
        "GY-1 2 good 2026-01-13 03:00 2026-01-13 02:00 L3G4200D rig-a",
        "GY-2 1 good 2026-01-11 03:00 2026-01-11 02:00 L3G4200D rig-b",
    ]


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ((), {"BM-1": [1], "GY-1": [2], "GY-2": [1]}),
        (("--all",), {"BM-1": [1], "GY-1": [1, 2, 3], "GY-2": [1]}),
        (("--board", "GY-*"), {"GY-1": [2], "GY-2": [1]}),
        (("--board", "GY-?", "--all"), {"GY-1": [1, 2, 3], "GY-2": [1]}),
        (("--board", "GY-2"), {"GY-2": [1]}),
        (("--board", "nobody"), {}),
        (("--sensor", "BMI270"), {"BM-1": [1]}),
        (("--rig", "rig-b"), {"GY-1": [3], "GY-2": [1]}),
        (("--config", "beef"), {"GY-1": [3]}),
        (("--config", "c0ffee", "--board", "GY-1"), {"GY-1": [2]}),
        (("--since", "2026-01-13"), {"GY-1": [2]}),
        (("--since", "2026-01-14", "--all"), {"GY-1": [3]}),
        (("--since", "2026-01-11T03:00:00Z"), {"BM-1": [1], "GY-1": [2], "GY-2": [1]}),
        (("--until", "2026-01-11"), {"GY-1": [1]}),
        (("--until", "2026-01-11T03:00:00Z"), {"GY-1": [1]}),
        (("--since", "2026-01-11", "--until", "2026-01-13"), {"BM-1": [1], "GY-2": [1]}),
        (("--limit", "2"), {"BM-1": [1], "GY-1": [2]}),
    ],
)
def test_each_filter_selects_its_versions(
    store: Path,
    capsys: pytest.CaptureFixture[str],
    options: tuple[str, ...],
    expected: dict[str, list[int]],
) -> None:
    listed: dict[str, list[int]] = {}
    for item in json.loads(output_of(capsys, "ls", store, *options, "--json"))["rows"]:
        listed.setdefault(item["board"], []).append(item["version"])
    assert listed == expected


def test_a_truncated_list_is_reported(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert output_of(capsys, "ls", store, "--limit", 2).endswith(
        "Only the first 2 are listed. Use a larger --limit for more.\n"
    )
    assert "--limit" not in output_of(capsys, "ls", store)


def test_unsuccessful_work_is_listed_with_its_reason(
    store: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = [
        " ".join(item.split()) for item in output_of(capsys, "ls", store, "--wrong").splitlines()
    ]
    assert lines[0] == "status board created recordings reason"
    assert sorted(lines[1:]) == [
        "failed GY-2 2026-01-31 02:30 y.mcap slow",
        "rejected 2026-01-31 02:30 x.mcap no motion",
    ]


@pytest.mark.parametrize(
    ("options", "version"),
    [
        ((), 2),
        (("--version", "1"), 1),
        (("--at", "2026-01-12"), 3),
        (("--at", "2026-01-10T02:00:00Z"), 1),
        (("--config", "beef"), 3),
        (("--at", "2026-01-12", "--config", "c0ffee"), 1),
    ],
)
def test_show_selects_the_last_recorded_or_the_requested_version(
    store: Path, capsys: pytest.CaptureFixture[str], options: tuple[str, ...], version: int
) -> None:
    text = output_of(capsys, "show", store, "GY-1", *options)
    day = {1: 10, 2: 13, 3: 11}[version]
    assert text.startswith(f"GY-1 (L3G4200D), version {version}: good\n")
    assert f"  recording             GY-1-{day}.mcap, 2026-01-{day}T02:00:00Z, sha256 " in text
    assert f"/GY-1/v{version:04d}.yaml\n" in text
    listed = json.loads(output_of(capsys, "show", store, "GY-1", *options, "--json"))
    assert listed["calibration"]["version"] == version
    assert listed["file"].endswith(f"/GY-1/v{version:04d}.yaml")


@pytest.mark.parametrize(
    ("command", "code", "words"),
    [
        (
            ("GY-1", "--version", "4"),
            3,
            "calibration version 4 of board GY-1. Choose a calibration version from 1 to 3.",
        ),
        (("GY-9",), 3, "does not contain board GY-9"),
        (
            ("GY-1", "--at", "2026-01-01"),
            3,
            "no calibration of board GY-1 that was recorded until 2026-01-01 00:00",
        ),
        (
            ("GY-1", "--config", "none"),
            3,
            "no calibration of board GY-1 that was made with the configuration none",
        ),
        (("GY-1", "--version", "1", "--config", "beef"), 2, "already selects one calibration"),
    ],
)
def test_show_reports_missing_versions(
    store: Path,
    capsys: pytest.CaptureFixture[str],
    command: tuple[str, ...],
    code: int,
    words: str,
) -> None:
    assert run(["store", "show", str(store), *command]) == code
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "versions", "days"),
    [((), (3, 2), (11, 13)), ((1,), (1, 2), (10, 13)), ((1, 3), (1, 3), (10, 11))],
)
def test_diff_compares_the_last_two_recorded_versions(
    store: Path,
    capsys: pytest.CaptureFixture[str],
    options: tuple[int, ...],
    versions: tuple[int, int],
    days: tuple[int, int],
) -> None:
    text = output_of(capsys, "diff", store, "GY-1", *options).splitlines()
    assert text[0] == (
        f"GY-1: version {versions[0]}, recorded 2026-01-{days[0]} "
        f"to version {versions[1]}, recorded 2026-01-{days[1]}"
    )
    assert text[1].split() == ["parameter", "before", "after", "change", "unit", "sigma"]
    name, before, after, change, unit, sigma = text[2].split()
    expected = (days[1] - days[0]) / 1024.0
    assert (name, unit) == ("bias.x", "deg/s")
    in_deg_s = [np.rad2deg(day / 1024.0) for day in days]
    assert (float(before), float(after)) == pytest.approx(in_deg_s, rel=1e-5)
    assert float(change) == pytest.approx(np.rad2deg(expected), rel=1e-5)
    assert float(sigma) == pytest.approx(expected / (2.0**0.5 * STD), rel=1e-5)
    listed = json.loads(output_of(capsys, "diff", store, "GY-1", *options, "--json"))
    assert (listed["from"], listed["to"], len(listed["parameters"])) == (*versions, 13)


def test_a_board_of_one_version_is_compared_with_itself(
    store: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert output_of(capsys, "diff", store, "GY-2").startswith(
        "GY-2: version 1, recorded 2026-01-11 to version 1, recorded 2026-01-11\n"
        "  remark: version 1 is compared with itself"
    )
    assert "remark" not in output_of(capsys, "diff", store, "GY-1")


def test_a_version_without_a_row_is_ordered_by_its_recording(
    store: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As `gyrorig solve --out STORE` writes them."""
    store_of_boards = CalibrationStore(store)
    add_version(store_of_boards, document("GY-2", 2, day=9, solved_day=20), "rig-a")
    assert "version 1:" in output_of(capsys, "show", store, "GY-2")
    add_version(store_of_boards, document("GY-2", 3, day=21, solved_day=21), "rig-a")
    assert "version 3:" in output_of(capsys, "show", store, "GY-2")


def test_the_overview_uses_the_last_recorded_version(store: Path) -> None:
    boards = build_overview(store).boards
    assert dict(zip(boards.board, boards.version, strict=True)) == {"BM-1": 1, "GY-1": 2, "GY-2": 1}
    assert boards.value["bias_x"][boards.board.index("GY-1")] == 13.0 / 1024.0


def test_a_boards_clock_and_count_are_in_the_index(store: Path) -> None:
    boards = build_overview(store).boards
    assert boards.clock_skew_ppm.tolist() == [-31.5] * 3
    assert boards.count_size_rad_s == pytest.approx([0.00015271630954950384] * 3)
