"""A name stands alone where its rivals lose by more than forms are untrue."""

import numpy as np
import pytest

from gyrorig_solver.discover.cause_ranking import CREDIBLE_SET_LEVEL, posterior_probabilities


@pytest.mark.parametrize(("won", "sole"), [(100.0, True), (1000.0, False)])
def test_a_rival_falls_by_more_than_forms_are_untrue(won: float, sole: bool) -> None:
    belief = posterior_probabilities(np.array([won, won - 10.0]), won)
    assert belief[0] > belief[1]
    assert (belief[0] > CREDIBLE_SET_LEVEL) == sole
