"""The tables of many rigs count what they say."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from tests.bench.accuracy.board import NAMES
from tests.bench.bench_rigs import read_rows
from tests.bench.rigs.coverage import clopper_pearson, clustered, covered, is_missed, table_text
from tests.bench.rigs.trial import read_calibration, sigmas


def row(errors: list[float], total: float | None = None, verdict: str = "good") -> dict[str, Any]:
    """Return a row whose standard uncertainties are 1 and whose truth is 0."""
    return {
        "seed": 1,
        "truth": [0.0] * 13,
        "base_bias": [0.0] * 3,
        "value": [*errors, *[0.0] * (13 - len(errors))],
        "std": [1.0] * 13,
        "total": None if total is None else [total] * 13,
        "verdict": verdict,
        "reasons": [],
        "named": [],
        "terms": [],
        "causes": {"worm_error": {"pan": 1e-4}},
        "cpu_s": 1.0,
    }


def test_interval_of_95_percent_ends_at_1_96() -> None:
    inside = covered([row([1.95, 1.97, -1.97])], "std")
    assert inside[0, :4].tolist() == [1.0, 0.0, 0.0, 1.0]
    assert covered([row([1.97], total=2.0)], "total")[0, 0] == 1.0


def test_null_is_not_counted() -> None:
    null = row([])
    null["value"][3] = None
    null["std"][3] = None
    assert np.isnan(covered([null], "std")[0, 3])
    assert np.isnan(sigmas(null, "std")[3])


def test_limits_of_a_share() -> None:
    assert clopper_pearson(5, 5) == pytest.approx((0.4782, 1.0), abs=1e-4)
    low, high = clustered([np.zeros(13), np.ones(13)])
    assert (low, high) == (0.0, 1.0)


def test_goal_is_missed_only_beyond_chance() -> None:
    rng = np.random.default_rng(1)
    right = [row(rng.normal(size=13).tolist()) for _ in range(40)]
    wrong = [row((2.0 * rng.normal(size=13)).tolist()) for _ in range(40)]
    timid = [row((0.2 * rng.normal(size=13)).tolist()) for _ in range(40)]
    assert not is_missed(right)
    assert is_missed(wrong)
    assert is_missed(timid)
    assert is_missed([])
    assert not is_missed([r | {"total": [2.0] * 13, "interval": None} for r in wrong])


def test_tables_name_the_worst_good_calibration() -> None:
    rows = [row([9.0]), row([50.0], verdict="limited"), {"seed": 2, "causes": {}, "failed": ["x"]}]
    text = table_text(rows)
    assert "rigs: 3; calibrations: 2; refused by the program: 1" in text
    assert "| 1 | `bias.x` | 9.0 | - | worm_error pan 0.0001 |" in text
    assert "50.0" not in text


def test_torn_last_line_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    path.write_text('{"seed": 1}\n{"seed": 2', encoding="utf-8")
    assert read_rows(path) == [{"seed": 1}]


def document(**more: Any) -> dict[str, Any]:
    """Return what a calibration document has at least."""
    names = ("bias", "scale", "nonorthogonality", "misalignment")
    parameters: dict[str, Any] = {name: {"value": [1.0] * 3, "std": [0.1] * 3} for name in names}
    parameters["time_offset"] = {"value": 1.0, "std": 0.1}
    return {
        "parameters": parameters,
        "trust": {"verdict": "good", "reasons": []},
        "quality": {"reduced_chi2": 1.0},
        "solver": {"terms": ["bias"]},
        **more,
    }


def read(content: dict[str, Any], folder: Path) -> dict[str, Any]:
    path = folder / "v0001.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return read_calibration(path)


def test_document_without_a_total_has_none(tmp_path: Path) -> None:
    assert read(document(), tmp_path)["total"] is None


def test_stated_intervals_of_the_total_are_used(tmp_path: Path) -> None:
    entry = {"total": 0.2, "interval": [0.6, 1.4]}
    stated = {"parameters": {name: entry for name in NAMES if name != "scale.x"}}
    runs = read(document(uncertainty=stated), tmp_path)
    assert runs["total"] == [0.2, 0.2, 0.2, None, *[0.2] * 9]
    truth = {"truth": [0.61, 0.59, 1.4, *[1.0] * 10], "base_bias": [1.0] * 3}
    inside = covered([runs | truth], "total")[0]
    assert inside[:3].tolist() == [1.0, 0.0, 1.0]
    assert np.isnan(inside[3])
    assert covered([runs | truth], "total", base_bias=True)[0, 1] == 1.0
