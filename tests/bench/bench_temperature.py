"""Coverage of curves of the bias against the temperature, and false curves.

Soaks are simulated as in tests/support/simulated_soaks.py. For each kind, the table has the share
of 95 % intervals of the curve that contain the truth, the share of soaks with a stated dependence,
the mean lag and its standard deviation, and the share with a hysteresis.
"""

# ruff: noqa: T201

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from tests.support.simulated_soaks import Soak, simulate_soak  # noqa: E402
from tests.unit.temperature.test_temperature_fit import STEP_S, windows_of  # noqa: E402

from gyrorig_solver.estimate import fit_temperature  # noqa: E402

CURVES = {
    "soak 0..60..0 degC, flicker": Soak(),
    "soak 0..60..0 degC, flicker and walk": Soak(walk_dps=0.001),
    "heating 0..60 degC": Soak(profile="up", walk_dps=0.0003),
    "warm-up 22..52 degC": Soak(profile="warm_up", walk_dps=0.0003),
}
NULLS = {
    "no dependence, soak, flicker": Soak(),
    "no dependence, soak, walk": Soak(walk_dps=0.003),
    "no dependence, warm-up, walk": Soak(profile="warm_up", walk_dps=0.001),
    "no dependence, warm-up, strong walk": Soak(profile="warm_up", walk_dps=0.01),
}
LIMITS = (0.93, 0.97)
MAX_FALSE_SHARE = 0.01


def main() -> int:
    """Print the table; 1 if a limit is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--soaks", type=int, default=100)
    parser.add_argument("--only", default="", help="part of the name of a kind")
    arguments = parser.parse_args()
    failed = False
    for name, soak in CURVES.items():
        if arguments.only in name:
            coverage = _row(name, soak, arguments.soaks)[0]
            failed |= not LIMITS[0] <= coverage <= LIMITS[1]
    for name, soak in NULLS.items():
        if arguments.only in name:
            null = replace(soak, coefficients_dps=np.zeros((1, 3)))
            failed |= _row(name, null, arguments.soaks)[1] > MAX_FALSE_SHARE
    return int(failed)


def _row(name: str, soak: Soak, count: int) -> tuple[float, float]:
    inside, stated, lags, loops = [], [], [], []
    for seed in range(count):
        simulated = simulate_soak(soak, seed)
        fit = fit_temperature([windows_of(simulated)], STEP_S)
        if fit is None:
            raise AssertionError("a soak without a span")
        low, high = fit.range_degc
        degc = np.linspace(low, high, 13)[1:-1]
        truth = simulated.curve_dps(degc, soak.coefficients_dps)
        error = np.degrees(fit.value + fit.curve.change(degc)) - truth
        inside.append(np.abs(error) < 1.96 * np.degrees(fit.std(degc)))
        stated.append(fit.is_significant)
        lags.append(fit.lag_s)
        loops.append(fit.hysteresis is not None and fit.hysteresis.is_fitted)
    coverage, share = float(np.mean(inside)), float(np.mean(stated))
    print(
        f"{name:40} coverage {coverage:.3f}  stated {share:.2f}  lag {np.mean(lags):+.1f} ± "
        f"{np.std(lags):.1f} s  hysteresis {np.mean(loops):.2f}  ({count} soaks)",
        flush=True,
    )
    return coverage, share


if __name__ == "__main__":
    sys.exit(main())
