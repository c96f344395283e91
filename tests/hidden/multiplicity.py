"""Measure how many independent looks a search makes, by drawing noise beside a fit.

Beside the base model's fit of a session, each row of each cause's bank is a few directions of the
whitened residual. Where there is only noise their scores are normal with the directions' products
as covariance: they are drawn from it, thousands of times, without a session. The looks of a cause
are how much likelier the best of its rows is to pass a bar than one row is; the independent tests
are how much likelier any cause is to pass its own than one test.

Lost steps and lines are looked for wherever the residual shows them first; of these two the
number that the search itself counts is taken.

Run: python tests/hidden/multiplicity.py SESSION... [--out docs/discovery/multiplicity.json]
where a session is a folder of a corpus that hides nothing.
"""

import argparse
import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import msgspec
import numpy as np
from scipy.stats import chi2
from tests.hidden.scoring.answers import opened, sealed
from tests.hidden.scoring.goals import SEARCH_FALSE_ALARMS
from tests.hidden.scoring.once import Multiplicity
from tests.support.board_fits import fit_base_model

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.discover.checks.typical_noise import build_projector
from gyrorig_solver.discover.score_tests import testable_places
from gyrorig_solver.discover.template_choice import all_templates, quick_templates
from gyrorig_solver.discover.testable_terms import count_tests, testable_terms
from gyrorig_solver.estimate import NuisanceProjector
from gyrorig_solver.model import SignalState, Term, value_indices

OUT = Path(__file__).resolve().parents[2] / "docs" / "discovery" / "multiplicity.json"
BY_RESIDUAL = ("lost_steps", "supply_hum")
BAR = 2e-3  # chance at which the looks of a cause are read: in the tail, and drawn often enough
ROWS = 200  # of a bank, evenly: more are alike
AT_ONCE = 10_000  # draws: memory counts
VANISHED, ALIKE = 1e-9, 1e-7  # of energy beside the fit; of directions


@dataclass(frozen=True, slots=True, eq=False)
class Bank:
    """A cause's directions beside the fit, each of length one; those the fit follows are zero."""

    term: Term
    white: FloatArray  # (rows * sizes, n)
    sizes: int

    @classmethod
    def of(cls, projection: NuisanceProjector, term: Term) -> "Bank":
        """Return the bank of a cause, at most `ROWS` of it."""
        rows = all_templates(projection, term)
        size = np.abs(rows[:, value_indices(term, role="size")]).max(axis=1)
        rows = rows[size == 0.0] if (size == 0.0).any() else rows  # to first order, as searched
        rows = rows[:: -(-len(rows) // ROWS)]
        every = np.concatenate(
            [
                projection.evaluate_signals(partial(_directions, term, row), term=term).dense()
                for row in rows
            ]
        )
        left = np.array([projection.orthogonal_component(signal) for signal in every])
        energy, raw = np.sum(left**2, axis=1), np.sum(every**2, axis=1)
        is_visible = energy > VANISHED * np.maximum(raw, 1e-300)
        scale = np.where(is_visible, np.sqrt(np.maximum(energy, 1e-300)), 1.0)
        white = np.where(is_visible[:, None], left, 0.0) / scale[:, None]
        return cls(term, white, len(every) // len(rows))

    def best(self, score: FloatArray, at: IntArray) -> tuple[FloatArray, int]:
        """Return the best row's statistic in each draw (draws,), and its degrees of freedom.

        Args:
            score: of all directions, (rows * sizes, draws).
            at: which sizes a place has.
        """
        best, degrees = np.zeros(score.shape[1]), 0
        for first in range(0, len(self.white), self.sizes):
            index = first + at
            index = index[np.any(self.white[index] != 0.0, axis=1)]
            if not index.size:
                continue
            strength, along = np.linalg.eigh(self.white[index] @ self.white[index].T)
            keep = strength > ALIKE
            root = along[:, keep] / np.sqrt(strength[keep])
            best = np.maximum(best, np.sum((root.T @ score[index]) ** 2, axis=0))
            degrees = max(degrees, int(keep.sum()))
        return best, degrees


def _directions(term: Term, row: FloatArray, scene: SignalState) -> FloatArray:
    return term.tangent_signals(scene, row)


def drawn(white: FloatArray, draws: int, seed: int) -> Iterator[FloatArray]:
    """Yield scores of directions where there is only noise, (k, some draws)."""
    strength, along = np.linalg.eigh(white @ white.T)
    keep = strength > 1e-12 * strength[-1]
    root = along[:, keep] * np.sqrt(strength[keep])
    rng = np.random.default_rng(seed)
    for _ in range(0, draws, AT_ONCE):
        yield root @ rng.standard_normal((root.shape[1], AT_ONCE))


def measured(session: Path, draws: int) -> Multiplicity:
    """Measure one session that hides nothing."""
    recording = read_recording(session / "recording.mcap")
    projection = build_projector(fit_base_model([recording], recording.board_ids[0]), typical=True)
    terms = testable_terms(projection)
    banks = [Bank.of(projection, t) for t in terms if t.cause not in BY_RESIDUAL]
    ends = np.cumsum([len(bank.white) for bank in banks])
    spots = [
        (k, np.array(at)) for k, bank in enumerate(banks) for _, at in testable_places(bank.term)
    ]
    best: list[list[FloatArray]] = [[] for _ in spots]
    degrees = [0] * len(spots)
    for score in drawn(np.concatenate([bank.white for bank in banks]), draws, seed=1):
        parts = np.split(score, ends[:-1])
        for j, (k, at) in enumerate(spots):
            statistics, degrees[j] = banks[k].best(parts[k], at)
            best[j].append(statistics)
    looks: dict[str, float] = {t.cause: quick_templates(projection, t)[1] for t in terms
                               if t.cause in BY_RESIDUAL}  # fmt: skip
    chance = np.ones(draws)
    for j, (k, _) in enumerate(spots):
        if not degrees[j]:
            continue
        all_draws = np.concatenate(best[j])[:draws]
        own_tests = 1.0
        if len(banks[k].white) > banks[k].sizes:
            bar = float(np.quantile(all_draws, 1.0 - BAR))
            own_tests = max(own_tests, BAR / float(chi2.sf(bar, degrees[j])))
        chance = np.minimum(chance, own_tests * chi2.sf(all_draws, degrees[j]))
        cause = banks[k].term.cause
        looks[cause] = max(looks.get(cause, 1.0), own_tests)
    tests = count_tests(terms)
    apart = count_tests([t for t in terms if t.cause in BY_RESIDUAL])
    effective = SEARCH_FALSE_ALARMS / float(np.quantile(chance, SEARCH_FALSE_ALARMS)) + apart
    answer = opened(session, sealed(session))
    rounded = {cause: round(value, 2) for cause, value in sorted(looks.items())}
    return Multiplicity(answer.program, answer.soak_k != 0.0, tests, round(effective, 1), rounded)


def main() -> None:
    """Measure sessions and write what was found."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("session", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, default=OUT)
    parser.add_argument("--draws", type=int, default=200_000)
    arguments = parser.parse_args()
    results = []
    for session in arguments.session:
        results.append(measured(session, arguments.draws))
        last = results[-1]
        sys.stderr.write(f"{last.program}: {last.effective_tests} of {last.tests} tests\n")
    arguments.out.write_bytes(msgspec.json.format(msgspec.json.encode(results), indent=1) + b"\n")


if __name__ == "__main__":
    main()
