"""Versions of a unit's posterior: chain, concurrency, recordings counted once, hostile files."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from tests.support.reference_recordings import BOARD, SimulatedGyro, record_rest

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.calibration import CalibrationStore
from gyrorig_solver.calibration.unit_document import (
    CountedRecording,
    UnitIdentity,
    UnitPosteriorDocument,
    parse_unit,
    posterior_of,
    unit_as_yaml,
    unit_document,
)
from gyrorig_solver.calibration.unit_store import StoredPosterior, UnitStore
from gyrorig_solver.pipeline import solve_board
from gyrorig_solver.pipeline.unit_prior import contradicts
from gyrorig_solver.storage import Folder
from gyrorig_solver.uncertainty import UnitPosterior, default_settings
from gyrorig_solver.uncertainty.unit_values import UnitInformation, unit_value_names

SETTINGS = default_settings()
UNIT = UnitIdentity("E46-0001", "serial")
DAY_NS = 86_400_000_000_000
SQUARENESS = unit_value_names().index("axis_nonorthogonality.angle")


def shows(squareness_rad: float, std_rad: float) -> UnitInformation:
    """Return the information of a recording that shows the squareness only."""
    size = len(unit_value_names())
    matrix, vector = np.zeros((size, size)), np.zeros(size)
    matrix[SQUARENESS, SQUARENESS] = std_rad**-2.0
    vector[SQUARENESS] = squareness_rad / std_rad**2
    return UnitInformation(matrix, vector)


def next_version(
    digest: str, information: UnitInformation, start_ns: int = 0
) -> Callable[[StoredPosterior | None], UnitPosteriorDocument]:
    def make(newest: StoredPosterior | None) -> UnitPosteriorDocument:
        before = None if newest is None else newest.document
        prior = (
            UnitPosterior.from_table(SETTINGS) if before is None else posterior_of(before, SETTINGS)
        )
        recordings = [CountedRecording("r.mcap", digest, "GY80-1")]
        return unit_document(UNIT, prior.updated(information), before, recordings, start_ns)

    return make


@pytest.fixture(name="store")
def _store(tmp_path: Path) -> UnitStore:
    return UnitStore(Folder(tmp_path))


def test_versions_form_a_chain_of_digests(store: UnitStore) -> None:
    for digest in ("a", "b"):
        assert store.add(UNIT, [digest], next_version(digest, shows(0.001, 0.001)))
    first, newest = store.prior_for(UNIT, ["b"]), store.latest(UNIT)
    assert first is not None
    assert newest is not None
    assert (first.document.version, newest.document.version) == (1, 2)
    assert newest.document.previous == first.sha256
    assert newest.document.based_on == 1
    assert newest.document.digests == {"a", "b"}


def test_a_recording_is_counted_once(store: UnitStore) -> None:
    make = next_version("a", shows(0.001, 0.001))
    assert store.add(UNIT, ["a"], make)
    assert store.add(UNIT, ["a"], make) is None
    assert store.add(UNIT, ["b", "a"], make) is None
    newest = store.latest(UNIT)
    assert newest is not None
    assert newest.document.version == 1


def test_the_prior_of_a_recording_is_the_version_before_it(store: UnitStore) -> None:
    for number, digest in enumerate("abcde"):
        store.add(UNIT, [digest], next_version(digest, shows(0.001, 0.001), number * DAY_NS))
    versions = {}
    for digest in "abcdefg":
        stored = store.prior_for(UNIT, [digest])
        versions[digest] = None if stored is None else stored.document.version
    assert versions == {"a": None, "b": 1, "c": 2, "d": 3, "e": 4, "f": 5, "g": 5}


def test_no_update_of_another_solver_is_lost(store: UnitStore) -> None:
    """The second solver has read the store before the first one writes."""
    slow = next_version("slow", shows(0.002, 0.001))
    calls = []

    def slow_while_another_writes(newest: StoredPosterior | None) -> UnitPosteriorDocument:
        calls.append(newest)
        if len(calls) == 1:
            assert store.add(UNIT, ["fast"], next_version("fast", shows(0.001, 0.001)))
        return slow(newest)

    written = store.add(UNIT, ["slow"], slow_while_another_writes)
    assert written is not None
    assert (len(calls), written.version) == (2, 2)
    assert written.digests == {"fast", "slow"}
    posterior = posterior_of(written, SETTINGS)
    table_information = (np.radians(0.15)) ** -2.0
    assert posterior.covariance[SQUARENESS, SQUARENESS] == pytest.approx(
        1.0 / (2e6 + table_information)
    )
    assert posterior.mean[SQUARENESS] == pytest.approx(3e3 / (2e6 + table_information))


def test_a_posterior_reads_back_exactly() -> None:
    posterior = UnitPosterior.from_table(SETTINGS).updated(shows(0.0013, 1e-4))
    document = unit_document(UNIT, posterior, None, [], 5 * DAY_NS)
    again = parse_unit(unit_as_yaml(document), "v0001.yaml")
    assert again == document
    assert np.array_equal(posterior_of(again, SETTINGS).covariance, posterior.covariance)
    assert again.days_until(7 * DAY_NS) == pytest.approx(2.0)
    assert again.days_until(3 * DAY_NS) == pytest.approx(2.0)


def test_a_size_that_an_older_version_lacks_has_the_prior_of_the_table() -> None:
    table = UnitPosterior.from_table(SETTINGS)
    document = unit_document(UNIT, table.updated(shows(0.001, 1e-4)), None, [], 0)
    older = msgspec.structs.replace(
        document,
        names=document.names[:1],
        units=document.units[:1],
        mean=document.mean[:1],
        covariance=[document.covariance[0][:1]],
    )
    posterior = posterior_of(older, SETTINGS)
    assert np.diag(posterior.covariance)[1:] == pytest.approx(np.diag(table.covariance)[1:])
    assert posterior.mean[0] == document.mean[0]


def damaged(**changes: object) -> str:
    document = unit_document(UNIT, UnitPosterior.from_table(SETTINGS), None, [], 0)
    return unit_as_yaml(msgspec.structs.replace(document, **changes))


SIZE = len(unit_value_names())
NEGATIVE = (-np.eye(SIZE)).tolist()
SKEWED = (np.eye(SIZE) + np.triu(np.ones((SIZE, SIZE)), 1)).tolist()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("just words", "Give a file with schema gyrorig/unit/1"),
        ("schema: gyrorig/calibration/1\n", "is a calibration"),
        (damaged(covariance=NEGATIVE), "has no valid covariance"),
        (damaged(covariance=SKEWED), "has no valid covariance"),
        (damaged(covariance=[[1e300] * SIZE] * SIZE), None),
        (damaged(mean=[0.0]), "has lists of different lengths"),
        (damaged(mean=[1e300] * SIZE), "states an impossible value of"),
        (damaged(names=["x"] * SIZE), "has a name twice"),
        (damaged(units=["m"] * SIZE), "in another unit than"),
        (damaged(as_of="yesterday"), "has an invalid time"),
        (damaged(version=0), "version"),
        (damaged(unit=UnitIdentity("../../etc", "rig")), "has an invalid id"),
    ],
)
def test_a_damaged_posterior_is_refused_in_one_line(text: str, message: str | None) -> None:
    if message is None:
        parse_unit(text, "v0001.yaml")
        return
    with pytest.raises(InputError, match=message) as refusal:
        parse_unit(text, "v0001.yaml")
    assert "\n" not in str(refusal.value)


def test_a_posterior_of_another_unit_is_refused(store: UnitStore, tmp_path: Path) -> None:
    store.add(UNIT, ["a"], next_version("a", shows(0.001, 0.001)))
    other = UnitIdentity("E46-0001", "rig")
    with pytest.raises(InputError, match=r"pan-tilt unit E46-0001 \(identified by serial\)"):
        store.latest(other)


def test_a_recording_that_contradicts_the_unit_is_noticed() -> None:
    prior = UnitPosterior.from_table(SETTINGS).updated(shows(0.001, 1e-4))
    assert not contradicts(prior, shows(0.0013, 1e-4))
    assert contradicts(prior, shows(0.0025, 1e-4))
    assert not contradicts(prior, replace(shows(0.0, 1.0), matrix=np.zeros((SIZE, SIZE))))


def test_a_recording_from_the_future_does_not_age_the_posterior() -> None:
    """The clock of one rig was wrong by decades."""
    posterior = UnitPosterior.from_table(SETTINGS).updated(shows(0.0013, 1e-4))
    wrong = unit_document(UNIT, posterior, None, [], 100 * 365 * DAY_NS)
    assert wrong.as_of <= wrong.created
    older = msgspec.structs.replace(wrong, as_of="2069-12-07T00:00:00Z")
    later = unit_document(UNIT, posterior, older, [], 5 * DAY_NS)
    assert later.as_of <= later.created


def test_nothing_is_written_if_a_check_before_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before, the posterior of the unit was written before the check."""
    path = record_rest(tmp_path / "rest.mcap", SimulatedGyro(), span_s=40.0)
    added: list[bool] = []
    monkeypatch.setattr(solve_board, "add_to_unit", lambda *_: added.append(True))
    recordings = [read_recording(path)]
    store = CalibrationStore(tmp_path / "out")

    def refuse() -> None:
        raise InputError("another board has this name", "rename it")

    with pytest.raises(InputError, match="another board"):
        solve_board.solve_and_store(store, recordings, BoardId(BOARD), before_writing=refuse)
    assert added == []
    assert not list((tmp_path / "out").rglob("*.yaml"))
    solve_board.solve_and_store(store, recordings, BoardId(BOARD))
    assert added == [True]
