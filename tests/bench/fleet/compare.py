"""Hold the rows-only maker against recordings that were solved: are their statistics the same?

For each family of parameters: what boards differ by, what changes on a board from night to
night, and what a calibration states, as a store of `make` has it and as `parts` has it.

Run: python tests/bench/fleet/compare.py STORE [--nights N]   (the nights before a drift begins)
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

import numpy as np
from tests.bench.fleet.parts import ERROR, SCATTER, SPREAD

from gyrorig_solver.fleet.drift import PARAMETER_COLUMNS
from gyrorig_solver.fleet.store import StoreIndex


def figures(store: Path, nights: int) -> dict[str, tuple[float, ...]]:
    """Return spread of boards, scatter of nights and stated deviation by family, rms."""
    squares: dict[str, list[tuple[float, float, float]]] = {}
    for name in PARAMETER_COLUMNS:
        sql = (
            f"SELECT board, {name}, {name}_std, "  # noqa: S608 - ours
            "date_diff('day', min(start::DATE) OVER (), start::DATE) AS night FROM rows "
            f"WHERE status = 'ok' AND {name} IS NOT NULL QUALIFY night < ?"
        )
        rows = StoreIndex(store).query(sql, [nights])
        board = np.array([row[0] for row in rows])
        value, std = (np.array([row[at] for row in rows], dtype=float) for at in (1, 2))
        means, within, free = [], 0.0, 0
        for board_name in np.unique(board):
            board_values = value[board == board_name]
            means.append(board_values.mean())
            within += float(((board_values - board_values.mean()) ** 2).sum())
            free += board_values.size - 1
        family = name.split("_", maxsplit=1)[0]
        estimates = (
            float(np.var(means, ddof=1)),
            within / max(free, 1),
            float(np.median(std)) ** 2,
        )
        squares.setdefault(family, []).append(estimates)
    return {
        family: tuple(float(np.sqrt(np.mean(column))) for column in zip(*three, strict=True))
        for family, three in squares.items()
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("store", type=Path)
    parser.add_argument("--nights", type=int, default=10_000)
    options = parser.parse_args(arguments)
    lines = [
        "| family | boards differ by | drawn | a board's nights | drawn with what is stated "
        "| stated | rows-only maker |",
        "|---|---|---|---|---|---|---|",
    ]
    for family, (spread, within, stated) in figures(options.store, options.nights).items():
        expected = float(np.hypot(SCATTER[family], stated))
        lines.append(
            f"| {family} | {spread:.2e} | {SPREAD[family]:.0e} | {within:.2e} | {expected:.2e} "
            f"| {stated:.1e} | {ERROR[family]:.0e} |"
        )
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
