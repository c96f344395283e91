"""A session whose parts do not come to the spool together: in the end all of them count."""

import shutil
from collections import Counter
from pathlib import Path

from tests.unit.fleet.test_batch import night
from tests.unit.recorder.test_parts_in_motion import recorded

from gyrorig_protocol.identity import BoardId
from gyrorig_solver.calibration import create_store, parse_calibration
from gyrorig_solver.fleet.store import StoreIndex

PROGRAMS = Path(__file__).resolve().parents[3] / "config" / "programs"
BOARD = BoardId("B-1")


def test_a_later_part_makes_the_session_new(tmp_path: Path) -> None:
    program = (PROGRAMS / "survey-40.yaml").read_bytes()
    _, parts = recorded(tmp_path / "rig", 30.0, program)
    assert len(parts) == 2
    spool, store = tmp_path / "spool", tmp_path / "store"
    spool.mkdir()
    for number, part in enumerate(parts, 1):
        shutil.copy(part.path, spool)
        batch_result = night(spool, store)
        assert (batch_result.done_before, batch_result.sessions_by_status) == (0, Counter(ok=1)), (
            batch_result.unsuccessful_rows
        )
        versions = create_store(store).versions(BOARD)
        assert len(versions) == number
        made = parse_calibration(versions[-1].data(), "newest")
        assert {item.sha256 for item in made.inputs} == {item.sha256 for item in parts[:number]}
    assert night(spool, store).done_before == 1
    rows = StoreIndex(store).query("SELECT version, len(inputs) FROM rows ORDER BY version")
    assert rows == [(1, 1), (2, 2)]


def test_parts_wait_for_an_unfinished_part(tmp_path: Path) -> None:
    program = (PROGRAMS / "survey-40.yaml").read_bytes()
    _, (first, second) = recorded(tmp_path / "rig", 30.0, program)
    spool, store = tmp_path / "spool", tmp_path / "store"
    spool.mkdir()
    shutil.copy(first.path, spool)
    open_part = spool / (second.path.name + ".part")
    shutil.copy(second.path, open_part)
    assert night(spool, store).sessions == 0
    open_part.rename(spool / second.path.name)
    assert night(spool, store).sessions_by_status == Counter(ok=1)
    assert len(create_store(store).versions(BOARD)) == 1
