"""Three days of a rig in simulated time, in which much goes wrong: nothing is lost.

The 90 days are `tests/bench/bench_years.py`.
"""

from pathlib import Path

import pytest
from tests.bench import bench_years as years


@pytest.mark.long
def test_three_days_lose_nothing(tmp_path: Path) -> None:
    plans: list[list[years.Event]] = [
        [years.fill_disk, years.put_nonsense],
        [years.set_clock_back, years.suspend],
        [years.kill_in_session, years.miss_board],
    ]
    soak = years.run(tmp_path / "rig", plans, lambda _line: None)
    assert soak.faults == []
    assert soak.missing == 0
    assert soak.samples > 10_000
    # The part that the full disk interrupted is recovered later, and its session is solved again.
    assert soak.batch["ok"] >= len(plans)
    assert set(soak.batch) == {"ok"}
    assert soak.started["nightly"] >= len(plans) - 1  # the killed one is in another process
