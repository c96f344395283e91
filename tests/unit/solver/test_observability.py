"""The rank test on small cases whose answer is known by eye."""

import numpy as np

from gyrorig_solver.estimate import analyse_observability, derive_parameters
from gyrorig_solver.estimate.observability import BIAS_NAMES
from gyrorig_solver.model import GAIN_NAMES

NAMES = (*GAIN_NAMES, *BIAS_NAMES)
IDENTITY = np.concatenate([np.eye(3).ravel(), np.zeros(3)])


def information(columns: str, std: float = 1e-3) -> np.ndarray:
    seen = [n.startswith("bias") or n[-1] in columns for n in NAMES]
    return np.diag(np.where(seen, std**-2.0, 0.0))


def test_all_parameters_observable() -> None:
    parameters = derive_parameters(
        IDENTITY, NAMES, analyse_observability(information("xyz"), NAMES), {}
    )
    assert parameters.observability.rank == 12
    assert parameters.observability.unobservable == ()
    assert np.isclose(parameters.observability.condition, 1.0)
    assert all(np.isfinite(v) for v in parameters.values.values())


def test_unexcited_column_is_unobservable() -> None:
    words = {"y": "sweep pan at +T and -T"}
    parameters = derive_parameters(
        IDENTITY, NAMES, analyse_observability(information("xz"), NAMES), words
    )
    assert parameters.observability.rank == 9
    assert np.isnan(parameters.gain[:, 1]).all()
    assert "scale.y" in parameters.observability.unobservable
    assert parameters.observability.reasons == ("column y of the gain: sweep pan at +T and -T",)
    assert set(parameters.order).isdisjoint(parameters.observability.unobservable)
    assert parameters.covariance.shape == (len(parameters.order), len(parameters.order))


def test_two_columns_observable_only_together() -> None:
    """Pan at one tilt t: only sin(t) column y + cos(t) column z is seen."""
    t = 0.5
    total = np.diag([0.0] * 9 + [1e6] * 3)
    for row in range(3):
        direction = np.zeros(12)
        direction[3 * row + 1 : 3 * row + 3] = np.sin(t), np.cos(t)
        total += 1e6 * np.outer(direction, direction)
        total[3 * row, 3 * row] += 1e6
    parameters = derive_parameters(
        IDENTITY, NAMES, analyse_observability(total, NAMES), {"y": "one tilt", "z": "one tilt"}
    )
    assert parameters.observability.rank == 9
    assert np.isnan(parameters.gain[:, 1:]).all()
    assert np.isfinite(parameters.gain[:, 0]).all()


def test_units_do_not_change_the_decision() -> None:
    """Knowing the bias a million times better than the gain leaves the rank as it is."""
    weighed = information("xyz")
    weighed[9:, 9:] *= 1e12
    assert analyse_observability(weighed, NAMES).rank == 12


def test_columns_with_one_reason_share_a_sentence() -> None:
    words = {"x": "it lay still", "y": "it lay still", "z": "it lay still"}
    parameters = derive_parameters(
        IDENTITY, NAMES, analyse_observability(information(""), NAMES), words
    )
    assert parameters.observability.reasons == ("columns x, y, z of the gain: it lay still",)
