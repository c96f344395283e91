"""What the data bear of a hidden cause, from a session that another process made."""

import subprocess
import sys
from pathlib import Path

import pytest
from tests.hidden.scoring.answers import cases, opened, sealed
from tests.hidden.scoring.bound import bound_of

MAKER = Path(__file__).resolve().parent / "truth" / "make.py"
ASYMMETRY = 6  # turn of a ladder


@pytest.mark.long
def test_the_nearest_rival_of_an_asymmetry_is_a_square(tmp_path: Path) -> None:
    order = [sys.executable, str(MAKER), "--out", str(tmp_path), "--tier", "ladder", "--rungs", "3",
             "--base", "910000", "--first", str(910_000 + ASYMMETRY), "--count", "1"]  # fmt: skip
    subprocess.run(order, check=True, capture_output=True)
    (case,) = cases(tmp_path)
    answer = opened(case, sealed(case))
    bound = bound_of(case, answer)
    assert answer.names == ["scale_asymmetry"]
    assert bound is not None
    assert bound.rival == "scale_quadratic"
    assert bound.left < 0.3  # the two effects are alike to 84 % and more
    # what is near is as visible as the whole less what the rival takes
    assert bound.noncentrality == pytest.approx(bound.left * 9.0 * 24.80, rel=0.05)
    assert 0.5 < bound.chance < 1.0
