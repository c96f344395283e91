"""Products of long rows, against numpy's own."""

import numpy as np
import pytest
from scipy.sparse import csr_array

from gyrorig_solver.estimate.products import product, sparse_product


@pytest.mark.parametrize("length", [0, 1, 63, 5000, 20001])
@pytest.mark.parametrize("signals", [0, 1, 3, 20, 21, 70])
def test_products_are_those_of_numpy(signals: int, length: int) -> None:
    rng = np.random.default_rng(signals)
    first, second = rng.standard_normal((29, length)), rng.standard_normal((signals, length))
    assert product(first, second) == pytest.approx(first @ second.T, rel=1e-10, abs=1e-9)
    assert product(second, second) == pytest.approx(second @ second.T, rel=1e-10, abs=1e-9)
    sparse = csr_array(np.where(np.abs(first) > 1.0, first, 0.0))
    wanted = sparse.toarray() @ second.T
    assert sparse_product(sparse, second) == pytest.approx(wanted, rel=1e-10, abs=1e-9)
