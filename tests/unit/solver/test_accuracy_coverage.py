"""The coverage bench on planted errors, and single runs of it end to end."""

from typing import Any

import numpy as np
import pytest
from tests.bench.accuracy.coverage import (
    ALL_NAMES,
    coverage_rows,
    run_program,
    shipped_programs,
    summarise_program,
    verdict,
)

RUNS = 200


def planted(claimed: dict[str, float], nulls: dict[str, int]) -> list[dict[str, Any]]:
    """Runs whose errors are normal; `claimed` is the stated deviation over the true one."""
    rng = np.random.default_rng(1)
    rows: list[dict[str, Any]] = []
    for number in range(RUNS):
        error: list[float | None] = rng.normal(size=len(ALL_NAMES)).tolist()
        std: list[float | None] = [claimed.get(name, 1.0) for name in ALL_NAMES]
        for name, count in nulls.items():
            if number < count:
                error[ALL_NAMES.index(name)] = std[ALL_NAMES.index(name)] = None
        rows.append({"seed": number, "error": error, "std": std, "duration_s": 75.0})
    return rows


def test_one_overconfident_parameter_is_named_and_not_pooled() -> None:
    programs = {"p.yaml": summarise_program(planted({"scale.x": 0.4}, {}))}
    beyond = [row.item for row in coverage_rows(programs) if row.verdict == "NO"]
    assert beyond == ["p.yaml: 95 % intervals, scale.x"]
    scale = programs["p.yaml"]["parameters"]["scale.x"]
    assert scale["value"] == pytest.approx(0.567, abs=0.09)
    assert scale["rms_z"] == pytest.approx(2.5, rel=0.15)
    assert scale["low"] < scale["value"] < scale["high"]


def test_too_wide_an_interval_is_named_too() -> None:
    summary = summarise_program(planted({"bias.y": 3.0}, {}))
    assert verdict(summary["parameters"]["bias.y"]) == "NO"


def test_nulls_are_counted_and_have_no_coverage() -> None:
    rows = [*planted({}, {"scale.y": RUNS, "misalignment.x": 50}), {"seed": 0, "failed": "why"}]
    summary = summarise_program(rows)
    assert (summary["runs"], summary["failed"]) == (RUNS, 1)
    assert summary["parameters"]["scale.y"] == {"nulls": RUNS}
    assert verdict(summary["parameters"]["scale.y"]) == ""
    assert summary["parameters"]["misalignment.x"]["nulls"] == 50
    assert summary["parameters"]["bias.x"]["nulls"] == 0


def test_every_shipped_program_is_measured() -> None:
    assert {"paper.yaml", "static.yaml", "quick.yaml", "full.yaml"} <= set(shipped_programs())


def test_the_papers_program_has_null_factors_and_intervals_that_hold() -> None:
    """Two runs: every error within five of its own deviations, and no factor has a number."""
    for seed in range(2):
        row = run_program("paper.yaml", seed)
        by_name = dict(zip(ALL_NAMES, zip(row["error"], row["std"], strict=True), strict=True))
        assert by_name["scale.x"] == (None, None)
        assert by_name["nonorthogonality.zx"] == (None, None)
        for name in ("bias.x", "gain.xx", "gain.zz", "time_offset, its constant apart"):
            error, std = by_name[name]
            assert abs(error) < 5.0 * std, name
