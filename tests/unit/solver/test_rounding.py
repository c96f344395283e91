"""The bias of samples at rest whose noise is smaller than a count."""

from dataclasses import replace

import numpy as np
import pytest
from tests.unit.solver.made import samples_of

from gyrorig_solver.estimate import UNIT_REMEDIES, fit_motion
from gyrorig_solver.reference import RestReference, TimeInterval

QUANTUM_RAD_S, SAMPLES, SEEDS = 1.065e-3, 6000, 6
LARGEST_RMS_Z = 1.5


def bias_errors(noise_counts: float, seed: int) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return errors of the bias over their standard uncertainties, (3,), and the remarks."""
    rng = np.random.default_rng(seed)
    bias_rad_s = QUANTUM_RAD_S * rng.uniform(-5.0, 5.0, 3)
    noise_rad_s = rng.normal(scale=noise_counts * QUANTUM_RAD_S, size=(SAMPLES, 3))
    counts = np.rint((bias_rad_s + noise_rad_s) / QUANTUM_RAD_S)
    samples = samples_of(np.arange(SAMPLES) / 100.0, counts * QUANTUM_RAD_S)
    samples = replace(samples, quantum_rad_s=QUANTUM_RAD_S, metadata={})
    fit = fit_motion(samples, RestReference((TimeInterval(0.0, 60.0),)), UNIT_REMEDIES)
    std_rad_s = np.array([fit.std[f"bias.{axis}"] for axis in "xyz"])
    return (fit.bias_rad_s - bias_rad_s) / std_rad_s, fit.warnings


@pytest.mark.parametrize("noise_counts", [0.05, 0.24, 0.3, 0.6])
def test_the_bias_is_as_uncertain_as_stated(noise_counts: float) -> None:
    results = [bias_errors(noise_counts, seed) for seed in range(SEEDS)]
    rms_z = np.sqrt(np.mean([z**2 for z, _ in results]))
    assert rms_z < LARGEST_RMS_Z
    is_stated = [any("half a count" in text for text in remarks) for _, remarks in results]
    assert is_stated == [noise_counts < 0.45] * SEEDS
