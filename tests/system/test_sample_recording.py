"""A recording made by another program, read, solved and compared with its truth."""

import json
from pathlib import Path

import numpy as np

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.model import factorise
from gyrorig_solver.pipeline import solve_recordings

# Second-order Butterworth, 25 Hz: the delay at zero frequency that the published lag,
# taken before the sensor's low-pass, does not hold.
LOW_PASS_DELAY_S = float(np.sqrt(2.0) / (2.0 * np.pi * 25.0))


def published(contracts: Path) -> dict[str, float]:
    truth = json.loads((contracts / "sample.expected.json").read_text())
    factors = factorise(np.array(truth["G"]))
    # S, T and M are published too: the factorisation must agree with another program's.
    assert np.allclose(factors.scale, truth["S"], atol=1e-12)
    assert np.allclose(factors.T, truth["T"], atol=1e-12)
    assert np.allclose(factors.M, truth["M"], atol=1e-12)
    values = {f"bias.{a}": v for a, v in zip("xyz", truth["bias_rad_s"], strict=True)}
    values |= {f"scale.{a}": v for a, v in zip("xyz", factors.scale, strict=True)}
    values |= {
        f"nonorthogonality.{a}": v
        for a, v in zip(("xy", "zx", "zy"), factors.nonorthogonality, strict=True)
    }
    values |= {f"misalignment.{a}": v for a, v in zip("xyz", factors.misalignment_rad, strict=True)}
    return values | {"time_offset": truth["tau_s"] + LOW_PASS_DELAY_S}


def test_every_parameter_is_within_its_deviations(contracts: Path) -> None:
    recording = read_recording(contracts / "sample.mcap")
    assert recording.is_complete
    fit = solve_recordings([recording], "GY80-P4242")
    truth = published(contracts)
    assert set(fit.order) == set(truth)
    off = {n: (fit.value(n) - truth[n]) / fit.std[n] for n in fit.order}
    assert {n: z for n, z in off.items() if abs(z) > 3.5} == {}
    # And the deviations are small enough to be of use: a few 1e-4 of gain, 0.01 deg/s, 1 ms.
    assert all(fit.std[n] < 6e-4 for n in fit.order if n != "time_offset")
    assert fit.std["time_offset"] < 1e-3
    error = np.array([fit.value(n) - truth[n] for n in fit.order])
    # scipy.stats.chi2.ppf(0.999, 13) = 34.5
    assert error @ np.linalg.solve(fit.covariance, error) < 34.5


def test_a_cut_recording_is_solved_and_says_what_is_lost(contracts: Path, tmp_path: Path) -> None:
    whole = (contracts / "sample.mcap").read_bytes()
    cut = tmp_path / "cut.mcap.part"
    cut.write_bytes(whole[: len(whole) * 9 // 10])
    recording = read_recording(cut)
    fit = solve_recordings([recording], "GY80-P4242")
    assert recording.losses
    assert [w for w in fit.warnings if "cut.mcap.part: " in w] == [
        f"cut.mcap.part: {loss.text}" for loss in recording.losses
    ]


def test_solving_again_changes_no_number(contracts: Path) -> None:
    first, second = (
        solve_recordings([read_recording(contracts / "sample.mcap")], "GY80-P4242")
        for _ in range(2)
    )
    assert [first.value(n) for n in first.order] == [second.value(n) for n in second.order]
    assert np.array_equal(first.covariance, second.covariance)
