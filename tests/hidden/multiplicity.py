"""Measure the effective number of independent trials of a search, with simulated noise.

Each row of the bank of a cause is a few directions of the whitened residual after a fit of the base
model. If the residual contains only noise, the scores of the directions are normal. Their
covariance is the matrix of the products of the directions. The program draws the scores thousands
of times. The trials of a cause are the probability that its best row passes a threshold, divided by
the probability for one row. The independent tests are the probability that any cause passes its
threshold, divided by the probability for one test.

The search tests lost steps and lines at the positions that the residual shows first. For these
two causes the program uses the number of trials that the search counts.

Run: python tests/hidden/multiplicity.py SESSION... [--out docs/discovery/multiplicity.json]
A session is a folder of a corpus without a hidden effect.
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
from tests.hidden.scoring.answers import open_answer, read_seal
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
TAIL_CHANCE = 2e-3  # probability in the tail that still has enough draws
MAX_ROWS = 200  # evenly spaced rows of a bank; neighbouring rows are similar
DRAWS_PER_BLOCK = 10_000  # limits the memory
MIN_ENERGY, MIN_STRENGTH = 1e-9, 1e-7  # relative energy after the fit; strength of directions


@dataclass(frozen=True, slots=True, eq=False)
class Bank:
    """Unit directions of a cause after the fit; a direction that the fit absorbs is zero."""

    term: Term
    white: FloatArray  # (rows * sizes, n)
    sizes: int

    @classmethod
    def make(cls, projection: NuisanceProjector, term: Term) -> "Bank":
        """Return the bank of a cause, with `MAX_ROWS` rows at most."""
        rows, _ = all_templates(projection, term)
        size = np.abs(rows[:, value_indices(term, role="size")]).max(axis=1)
        # to first order, as in the search
        rows = rows[size == 0.0] if (size == 0.0).any() else rows
        rows = rows[:: -(-len(rows) // MAX_ROWS)]
        signals = np.concatenate(
            [
                projection.evaluate_signals(
                    partial(_compute_directions, term, row), term=term
                ).dense()
                for row in rows
            ]
        )
        projected = np.array([projection.orthogonal_component(signal) for signal in signals])
        energy, full_energy = np.sum(projected**2, axis=1), np.sum(signals**2, axis=1)
        is_visible = energy > MIN_ENERGY * np.maximum(full_energy, 1e-300)
        scale = np.where(is_visible, np.sqrt(np.maximum(energy, 1e-300)), 1.0)
        white = np.where(is_visible[:, None], projected, 0.0) / scale[:, None]
        return cls(term, white, len(signals) // len(rows))

    def find_best(self, score: FloatArray, at: IntArray) -> tuple[FloatArray, int]:
        """Return the largest statistic of a row in each draw, (draws,), and its degrees of freedom.

        Args:
            score: of all directions, (rows * sizes, draws).
            at: indices of the sizes of a place.
        """
        best, degrees = np.zeros(score.shape[1]), 0
        for first in range(0, len(self.white), self.sizes):
            index = first + at
            index = index[np.any(self.white[index] != 0.0, axis=1)]
            if not index.size:
                continue
            strength, along = np.linalg.eigh(self.white[index] @ self.white[index].T)
            keep = strength > MIN_STRENGTH
            root = along[:, keep] / np.sqrt(strength[keep])
            best = np.maximum(best, np.sum((root.T @ score[index]) ** 2, axis=0))
            degrees = max(degrees, int(keep.sum()))
        return best, degrees


def _compute_directions(term: Term, row: FloatArray, scene: SignalState) -> FloatArray:
    return term.tangent_signals(scene, row)


def draw_scores(white: FloatArray, draws: int, seed: int) -> Iterator[FloatArray]:
    """Yield scores of directions for a residual with noise only, (k, draws of a block)."""
    strength, along = np.linalg.eigh(white @ white.T)
    keep = strength > 1e-12 * strength[-1]
    root = along[:, keep] * np.sqrt(strength[keep])
    rng = np.random.default_rng(seed)
    for _ in range(0, draws, DRAWS_PER_BLOCK):
        yield root @ rng.standard_normal((root.shape[1], DRAWS_PER_BLOCK))


def measure_session(session: Path, draws: int) -> Multiplicity:
    """Measure one session without a hidden effect."""
    recording = read_recording(session / "recording.mcap")
    projection = build_projector(fit_base_model([recording], recording.board_ids[0]), typical=True)
    terms = testable_terms(projection)
    banks = [Bank.make(projection, t) for t in terms if t.cause not in BY_RESIDUAL]
    ends = np.cumsum([len(bank.white) for bank in banks])
    places = [
        (k, np.array(at)) for k, bank in enumerate(banks) for _, at in testable_places(bank.term)
    ]
    best: list[list[FloatArray]] = [[] for _ in places]
    degrees = [0] * len(places)
    for score in draw_scores(np.concatenate([bank.white for bank in banks]), draws, seed=1):
        parts = np.split(score, ends[:-1])
        for j, (k, at) in enumerate(places):
            statistics, degrees[j] = banks[k].find_best(parts[k], at)
            best[j].append(statistics)
    looks: dict[str, float] = {t.cause: quick_templates(projection, t)[1] for t in terms
                               if t.cause in BY_RESIDUAL}  # fmt: skip
    chances = np.ones(draws)
    for j, (k, _) in enumerate(places):
        if not degrees[j]:
            continue
        all_draws = np.concatenate(best[j])[:draws]
        own_tests = 1.0
        if len(banks[k].white) > banks[k].sizes:
            threshold = float(np.quantile(all_draws, 1.0 - TAIL_CHANCE))
            own_tests = max(own_tests, TAIL_CHANCE / float(chi2.sf(threshold, degrees[j])))
        chances = np.minimum(chances, own_tests * chi2.sf(all_draws, degrees[j]))
        cause = banks[k].term.cause
        looks[cause] = max(looks.get(cause, 1.0), own_tests)
    tests = count_tests(terms)
    by_residual = count_tests([t for t in terms if t.cause in BY_RESIDUAL])
    effective = SEARCH_FALSE_ALARMS / float(np.quantile(chances, SEARCH_FALSE_ALARMS)) + by_residual
    answer = open_answer(session, read_seal(session))
    rounded = {cause: round(value, 2) for cause, value in sorted(looks.items())}
    return Multiplicity(answer.program, answer.soak_k != 0.0, tests, round(effective, 1), rounded)


def main() -> None:
    """Measure sessions and write the results."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("session", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, default=OUT)
    parser.add_argument("--draws", type=int, default=200_000)
    arguments = parser.parse_args()
    results = []
    for session in arguments.session:
        results.append(measure_session(session, arguments.draws))
        last = results[-1]
        sys.stderr.write(f"{last.program}: {last.effective_tests} of {last.tests} tests\n")
    arguments.out.write_bytes(msgspec.json.format(msgspec.json.encode(results), indent=1) + b"\n")


if __name__ == "__main__":
    main()
