# ruff: noqa: T201
"""Largest log-likelihood ratio between a steady drift of the bias and a warm-up, by duration.

    python tests/bench/bench_ramp_bound.py

Neither effect depends on the motion, so a rest of the same duration, with a known gain, is at
least as good as every motion program. The noise is that of the emulated sensor (mean values of
`rig_truth`), whitened in the cosine transform. One effect is the noise-free truth. The other one is
fitted to it with a free constant, and half the whitened energy that remains is the expected log
likelihood ratio. The solver states one name from 2.9 nats on.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct

FloatArray = NDArray[np.float64]

DEG = np.pi / 180.0
WHITE_RAD_S_RTHZ, INSTABILITY_RAD_S = 0.03 * DEG, 30.0 * DEG / 3600.0
WALK_RAD_S_RTS = 0.3e-3 * DEG
BLOCK_HZ = 10.0  # much faster than both effects
LONGEST_S = 1200.0  # largest time constant of a warm-up in the catalogue
TIME_CONSTANTS_S = np.geomspace(5.0, LONGEST_S, 200)
DURATIONS_S = (40.0, 120.0, 160.0, 300.0, 600.0, 1200.0)
SLOPES_RAD_S2 = (8e-5, 1.6e-4)  # of bench_separation
BEGIN_RAD_S = 1.2e-2
SHOWN_CONSTANTS_S = (60.0, 200.0, 500.0, 1200.0)


def whiten(signal: FloatArray) -> FloatArray:
    """Return the cosine transform in units of the noise, without the constant."""
    count = signal.size
    frequency_hz = np.arange(1, count) * BLOCK_HZ / (2.0 * count)
    density = WHITE_RAD_S_RTHZ**2 + INSTABILITY_RAD_S**2 / (np.pi * frequency_hz)
    density += 2.0 * WALK_RAD_S_RTS**2 / (2.0 * np.pi * frequency_hz) ** 2
    spectrum = dct(signal, norm="ortho")[1:] / np.sqrt(density * BLOCK_HZ / 2.0)
    return np.asarray(spectrum, dtype=np.float64)


def left_nats(truth: FloatArray, alternatives: list[FloatArray]) -> float:
    """Return what the best alternative leaves of the truth."""
    signal = whiten(truth)
    left = []
    for alternative in map(whiten, alternatives):
        residual = signal - alternative * (alternative @ signal) / (alternative @ alternative)
        left.append(0.5 * float(residual @ residual))
    return min(left)


def main() -> None:
    """Print the table: nats per axis."""
    heads = [f"drift {slope:.1e} rad/s²" for slope in SLOPES_RAD_S2]
    heads += [f"warm-up of {constant:.0f} s" for constant in SHOWN_CONSTANTS_S]
    print("| duration, s | " + " | ".join(heads) + " |")
    print("|---" * (len(heads) + 1) + "|")
    for duration_s in DURATIONS_S:
        time_s = np.arange(int(duration_s * BLOCK_HZ)) / BLOCK_HZ
        decays = [np.exp(-time_s / constant) for constant in TIME_CONSTANTS_S]
        cells = [left_nats(slope * time_s, decays) for slope in SLOPES_RAD_S2]
        cells += [
            left_nats(BEGIN_RAD_S * np.exp(-time_s / constant), [time_s])
            for constant in SHOWN_CONSTANTS_S
        ]
        print(f"| {duration_s:.0f} | " + " | ".join(f"{nats:.2f}" for nats in cells) + " |")


if __name__ == "__main__":
    main()
