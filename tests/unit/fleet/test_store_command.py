"""What `gyrorig store ls`, `show` and `diff` print, and which calibrations their filters leave."""

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from tests.unit.fleet.conftest import row

from gyrorig_protocol.identity import BoardId
from gyrorig_solver.calibration.document import Calibration, parse_calibration, to_yaml
from gyrorig_solver.calibration.store import CalibrationStore, make_sharded
from gyrorig_solver.cli import run
from gyrorig_solver.fleet.index import Index
from gyrorig_solver.fleet.journal import Journal
from gyrorig_solver.fleet.overview import overview
from gyrorig_solver.fleet.rows import Row, row_of_calibration

GOLDEN = Path(__file__).parents[1] / "output" / "golden" / "good.yaml"
STD = 2.0**-12  # of every parameter of the golden calibration but the time offset


def document(board: str, version: int, day: int, made: int, **more: Any) -> Calibration:
    """Return a calibration of a recording of one day of January, solved on another."""
    plain = yaml.safe_load(GOLDEN.read_text(encoding="utf-8"))
    plain["board"] |= {"id": board, "sensor": more.get("sensor", "L3G4200D")}
    plain["board"]["config"]["config_hash"] = more.get("config", "c0ffee")
    plain |= {"version": version, "created": f"2026-01-{made:02d}T03:00:00Z"}
    plain["inputs"][0] |= {
        "name": f"{board}-{day}.mcap",
        "sha256": hashlib.sha256(f"{board} {day}".encode()).hexdigest(),
        "start": f"2026-01-{day:02d}T02:00:00Z",
    }
    plain["parameters"]["bias"]["value"][0] = day / 1024.0
    return parse_calibration(yaml.safe_dump(plain), board)


def put(store: CalibrationStore, made: Calibration, rig: str) -> Row:
    path = store.prepare(BoardId(made.board.id)) / f"v{made.version:04d}.yaml"
    path.write_text(to_yaml(made), encoding="utf-8")
    return row_of_calibration(
        made,
        key=f"{made.board.id}-{made.version}",
        batch="night",
        session="s",
        rig=rig,
        file=str(path.relative_to(store.folder)),
        file_sha256=hashlib.sha256(path.read_bytes()).hexdigest(),
    )


@pytest.fixture
def store(tmp_path: Path) -> Path:
    """Three boards; the third version of GY-1 is of a backlog, measured before its second."""
    made = make_sharded(tmp_path / "store")
    rows = [
        put(made, document("GY-1", 1, day=10, made=10), "rig-a"),
        put(made, document("GY-1", 2, day=13, made=13), "rig-a"),
        put(made, document("GY-1", 3, day=11, made=15, config="beef"), "rig-b"),
        put(made, document("GY-2", 1, day=11, made=11), "rig-b"),
        put(made, document("BM-1", 1, day=12, made=12, sensor="BMI270"), "rig-a"),
        row("bad", status="rejected", board="", reason="no motion", names=["x.mcap"]),
        row("worse", status="failed", board="GY-2", reason="slow", names=["y.mcap"]),
    ]
    with Journal(tmp_path / "store", "night") as journal:
        journal.add(rows)
    Index(tmp_path / "store").fold_left_behind()
    return tmp_path / "store"


def said(capsys: pytest.CaptureFixture[str], *command: object, code: int = 0) -> str:
    capsys.readouterr()
    assert run(["store", *(str(word) for word in command)]) == code
    return capsys.readouterr().out


def test_ls_prints_the_last_measured_version_of_each_board(
    store: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = [" ".join(line.split()) for line in said(capsys, "ls", store).splitlines()]
    assert lines == [
        "board version trust created start sensor rig",
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
def test_each_filter_leaves_what_it_says(
    store: Path,
    capsys: pytest.CaptureFixture[str],
    options: tuple[str, ...],
    expected: dict[str, list[int]],
) -> None:
    found: dict[str, list[int]] = {}
    for one in json.loads(said(capsys, "ls", store, *options, "--json"))["rows"]:
        found.setdefault(one["board"], []).append(one["version"])
    assert found == expected


def test_a_list_that_was_cut_says_so(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert said(capsys, "ls", store, "--limit", 2).endswith(
        "the first 2; for more give a larger --limit\n"
    )
    assert "--limit" not in said(capsys, "ls", store)


def test_what_went_wrong_is_listed_with_its_reason(
    store: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = [" ".join(one.split()) for one in said(capsys, "ls", store, "--wrong").splitlines()]
    assert lines[0] == "status board created names reason"
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
def test_show_takes_the_last_measured_or_what_is_asked_for(
    store: Path, capsys: pytest.CaptureFixture[str], options: tuple[str, ...], version: int
) -> None:
    told = said(capsys, "show", store, "GY-1", *options)
    day = {1: 10, 2: 13, 3: 11}[version]
    assert told.startswith(f"GY-1 (L3G4200D), version {version}: good\n")
    assert f"  from                  GY-1-{day}.mcap, 2026-01-{day}T02:00:00Z, sha256 " in told
    assert f"/GY-1/v{version:04d}.yaml\n" in told
    found = json.loads(said(capsys, "show", store, "GY-1", *options, "--json"))
    assert found["calibration"]["version"] == version
    assert found["file"].endswith(f"/GY-1/v{version:04d}.yaml")


@pytest.mark.parametrize(
    ("command", "code", "words"),
    [
        (("GY-1", "--version", "4"), 3, "no version 4 of board GY-1: give one from 1 to 3"),
        (("GY-9",), 3, "holds no board GY-9"),
        (
            ("GY-1", "--at", "2026-01-01"),
            3,
            "no version of board GY-1 measured by 2026-01-01 00:00",
        ),
        (("GY-1", "--config", "none"), 3, "no version of board GY-1 with the configuration none"),
        (("GY-1", "--version", "1", "--config", "beef"), 2, "names one calibration already"),
    ],
)
def test_show_says_what_is_not_there(
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
def test_diff_compares_the_last_measured_with_the_one_before_it(
    store: Path,
    capsys: pytest.CaptureFixture[str],
    options: tuple[int, ...],
    versions: tuple[int, int],
    days: tuple[int, int],
) -> None:
    told = said(capsys, "diff", store, "GY-1", *options).splitlines()
    assert told[0] == f"GY-1: version {versions[0]} to {versions[1]}"
    assert told[1].split() == ["parameter", "before", "after", "change", "sigma"]
    name, before, after, change, sigma = told[2].split()
    expected = (days[1] - days[0]) / 1024.0
    assert name == "bias_x"
    assert (float(before), float(after)) == pytest.approx([d / 1024.0 for d in days], rel=1e-5)
    assert float(change) == pytest.approx(expected, rel=1e-5)
    assert float(sigma) == pytest.approx(expected / (2.0**0.5 * STD), rel=1e-5)
    found = json.loads(said(capsys, "diff", store, "GY-1", *options, "--json"))
    assert (found["from"], found["to"], len(found["parameters"])) == (*versions, 13)


def test_a_board_of_one_version_is_compared_with_itself(
    store: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert said(capsys, "diff", store, "GY-2").startswith("GY-2: version 1 to 1\n")


def test_a_version_that_no_index_knows_is_shown_by_when_it_was_measured(
    store: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As `gyrorig solve --out STORE` writes them."""
    made = CalibrationStore(store)
    put(made, document("GY-2", 2, day=9, made=20), "rig-a")
    assert "version 1:" in said(capsys, "show", store, "GY-2")
    put(made, document("GY-2", 3, day=21, made=21), "rig-a")
    assert "version 3:" in said(capsys, "show", store, "GY-2")


def test_the_fleet_is_told_by_what_was_measured_last(store: Path) -> None:
    boards = overview(store).boards
    assert dict(zip(boards.board, boards.version, strict=True)) == {"BM-1": 1, "GY-1": 2, "GY-2": 1}
    assert boards.value["bias_x"][boards.board.index("GY-1")] == 13.0 / 1024.0


def test_a_boards_clock_and_count_are_in_the_index(store: Path) -> None:
    boards = overview(store).boards
    assert boards.skew_ppm.tolist() == [-31.5] * 3
    assert boards.count_rad_s == pytest.approx([0.00015271630954950384] * 3)
