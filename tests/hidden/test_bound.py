"""Test the bound on right names with a session that another process makes."""

import subprocess
import sys
from pathlib import Path

import pytest
from tests.hidden.scoring.answers import list_cases, open_answer, read_seal
from tests.hidden.scoring.bound import compute_bound

MAKER = Path(__file__).resolve().parent / "truth" / "make.py"
ASYMMETRY_NUMBER = 6  # number of the cause in a ladder


@pytest.mark.long
def test_the_best_rival_of_a_scale_asymmetry_is_a_quadratic_scale(tmp_path: Path) -> None:
    command = [
        sys.executable, str(MAKER), "--out", str(tmp_path), "--tier", "ladder", "--rungs", "3",
        "--base", "910000", "--first", str(910_000 + ASYMMETRY_NUMBER), "--count", "1",
    ]  # fmt: skip
    subprocess.run(command, check=True, capture_output=True)
    (case,) = list_cases(tmp_path)
    answer = open_answer(case, read_seal(case))
    bound = compute_bound(case, answer)
    assert answer.names == ["scale_asymmetry"]
    assert bound is not None
    assert bound.rival == "scale_quadratic"
    assert bound.left < 0.3  # the correlation of the two effects is at least 84 %
    # The non-centrality is that of the effect after subtracting the part that the rival explains.
    assert bound.noncentrality == pytest.approx(bound.left * 9.0 * 24.80, rel=0.05)
    assert 0.5 < bound.chance < 1.0
