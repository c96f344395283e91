# ruff: noqa: T201
"""Separation of two causes by the proposed program of 120 s, by others, and an upper bound.

    python tests/bench/bench_separation_bound.py [--minutes 10] [--motions 60] [--trials 120]

The sessions are those of `bench_separation.py`, without drift and warm-up, which have a bench of
their own (`bench_ramp_bound.py`). The bench changes the proposed program at random, keeps each
change that separates the causes better, and evaluates each program as a whole.

To first order, the expected log Bayes factor is a concave function of the time that a program gives
to each motion, because it is the smallest value of functions that are linear in the information.
The bench maximises it over all such times, also over parts of a motion, so that no program of these
motions can exceed the printed bound: the maximum plus the duality gap of Frank and Wolfe (1956).
This bound is not sharp: it adds motions as if the noise of each were independent of the others. The
motions of the bound are all blocks of the product and others that it does not have: more speeds and
tilts, and random poses.
"""

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import reduce
from operator import add
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

import numpy as np  # noqa: E402 - the lines above make threads few and find the packages
from tests.bench.bench_separation import PAIRS, draw_of  # noqa: E402
from tests.hidden.truth.session import record  # noqa: E402
from tests.support.board_fits import explain_recordings  # noqa: E402

from gyrorig_protocol.errors import GyrorigError  # noqa: E402
from gyrorig_protocol.program import MotionProgram, PtuSettings, Rest, Step  # noqa: E402
from gyrorig_protocol.recording.reader import read_recording  # noqa: E402
from gyrorig_solver.data import FloatArray  # noqa: E402
from gyrorig_solver.estimate import ConvergedFit  # noqa: E402
from gyrorig_solver.plan.program_family import MotionSpace, moves_between  # noqa: E402
from gyrorig_solver.plan.program_timeline import simulate_program  # noqa: E402
from gyrorig_solver.plan.separation import CausePair, propose_program, recorded_unit  # noqa: E402
from gyrorig_solver.plan.separation.cause_pairs import (  # noqa: E402
    FirstOrder,
    PairProducts,
    judged_by_typical_noise,
    pair_products,
)
from gyrorig_solver.plan.separation.motion_blocks import (  # noqa: E402
    BLOCK_STATIC_S,
    DWELL_S,
    MotionBlock,
    motion_blocks,
    program_of_blocks,
)
from gyrorig_solver.plan.separation.next_program import (  # noqa: E402
    MAX_PROGRAM_S,
    ambiguous_groups,
    sole_name_probability,
)
from gyrorig_solver.plan.separation.simulated_recording import simulate_recording  # noqa: E402
from gyrorig_solver.plan.unit_model import UnitModel  # noqa: E402

SPEED_SHARES = (0.8, 0.4, 0.15, 0.05)  # between those of the product's blocks
TILTS = 5
LONGEST_SWEEP_S = 5.0
FASTEST_DEG_S = 225.0  # 90 % of the full scale of the emulated gyroscope, as in the planner
RANDOM_SHARES = (1.0, 0.8, 0.55, 0.4, 0.25, 0.1)
STEPS = (0.5, 0.25, 0.12, 0.06, 0.03, 0.015, 0.007)  # of a line search
SMALL = 1e-3  # of a numeric derivative
ITERATIONS, GAP_SHARE = 80, 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """One motion with its duration and the products of the pair."""

    duration_s: float
    products: PairProducts


def other_blocks(space: MotionSpace, random_count: int) -> Iterator[MotionBlock]:
    """Yield motions that the product does not have."""
    home = (space.home.pan_deg, space.home.tilt_deg)
    rng = np.random.default_rng(1)

    def block(points: list[tuple[float, float]], share: float, dwell_s: float) -> MotionBlock:
        poses = [(round(pan, 1), round(tilt, 1)) for pan, tilt in (home, *points, home)]
        speeds = (share * space.pan_speed_deg_s, share * space.tilt_speed_deg_s)
        steps = moves_between(poses, iter(lambda: speeds, None), dwell_s)
        return MotionBlock("", tuple(steps))

    for share in SPEED_SHARES:
        ends = _reachable(space.pan_deg, LONGEST_SWEEP_S * share * space.pan_speed_deg_s)
        for tilt in np.linspace(*space.tilt_deg, TILTS).tolist():
            yield block([(home[0], tilt), *((pan, tilt) for pan in ends)], share, DWELL_S)
        tilts = _reachable(space.tilt_deg, LONGEST_SWEEP_S * share * space.tilt_speed_deg_s)
        yield block([(home[0], tilt) for tilt in tilts], share, DWELL_S)
        yield block(list(zip(reversed(ends), tilts, strict=True)), share, DWELL_S)
    for _ in range(random_count):
        share = float(rng.choice(RANDOM_SHARES))
        pans = _reachable(space.pan_deg, LONGEST_SWEEP_S * share * space.pan_speed_deg_s)
        tilts = _reachable(space.tilt_deg, LONGEST_SWEEP_S * share * space.tilt_speed_deg_s)
        points = [
            (float(rng.uniform(*pans)), float(rng.uniform(*tilts)))
            for _ in range(int(rng.integers(2, 6)))
        ]
        yield block(points, share, float(rng.choice([0.0, DWELL_S, 1.0])))


def _reachable(limits: tuple[float, float], span_deg: float) -> tuple[float, float]:
    return max(limits[0], -span_deg / 2.0), min(limits[1], span_deg / 2.0)


def upper_bound(
    motions: list[Motion], outlook: Callable[[PairProducts], tuple[float, float]], time_s: float
) -> tuple[float, float]:
    """Return a bound on the nats of any program, and the log-likelihood that a cause gains."""
    durations_s = np.array([motion.duration_s for motion in motions])

    def values(counts: FloatArray) -> tuple[float, float]:
        parts = [
            replace(motion.products, information=count * motion.products.information)
            for motion, count in zip(motions, counts, strict=True)
            if count > 0.0
        ]
        return outlook(reduce(add, parts))

    counts = time_s / durations_s / len(motions)
    bound = np.inf
    for _ in range(ITERATIONS):
        nats = values(counts)[0]
        gradient = np.array(
            [
                (values(counts + SMALL * corner)[0] - nats) / SMALL
                for corner in np.diag(time_s / durations_s)
            ]
        )
        best = int(np.argmax(gradient))
        gap = float(gradient[best] - gradient @ (counts * durations_s / time_s))
        bound = min(bound, nats + gap)
        corner = np.zeros(len(motions))
        corner[best] = time_s / durations_s[best]
        trials = [(1.0 - step) * counts + step * corner for step in STEPS]
        reached = [values(trial)[0] for trial in trials]
        if gap < GAP_SHARE * nats or max(reached) <= nats:
            break
        counts = trials[int(np.argmax(reached))]
    return bound, values(counts)[1]


class Session:
    """One recording with a stated set of causes."""

    def __init__(self, solution: ConvergedFit, unit: UnitModel, proposed: MotionProgram) -> None:
        self._solution, self._unit, self._proposed = solution, unit, proposed
        self._settings = proposed.settings or PtuSettings()
        self._rng = np.random.default_rng(1)

    def motions(self, pair: CausePair, random_count: int) -> list[Motion]:
        """Return all motions that the unit can do."""
        space = MotionSpace.of(self._unit, FASTEST_DEG_S)
        alone_s = self._duration_s(MotionProgram("empty", (_static(), _static())))
        motions = []
        for block in (*motion_blocks(space), *other_blocks(space, random_count)):
            program = program_of_blocks((block,), space, self._settings, "block", BLOCK_STATIC_S)
            try:
                products = self._products(pair, program)
            except GyrorigError:  # the unit cannot do it
                continue
            motions.append(Motion(self._duration_s(program) - alone_s, products))
        return motions

    def judge(self, pair: CausePair, asked: argparse.Namespace) -> tuple[float, ...]:
        """Return nats and probability of one name: proposed, after changes, and the bounds."""
        first_order = FirstOrder(pair, self._solution)
        outlook = first_order.outlook(self._products(pair, self._proposed))
        changed = self._change_steps(pair, first_order, asked.trials)
        motions = self.motions(pair, asked.motions)
        limit = upper_bound(motions, first_order.outlook, MAX_PROGRAM_S)
        return tuple(
            value
            for nats in (outlook, changed, limit)
            for value in (nats[0], sole_name_probability(*nats))
        )

    def _change_steps(
        self, pair: CausePair, first_order: FirstOrder, trials: int
    ) -> tuple[float, float]:
        """Return the outlook of the best program after random changes of the proposed one."""
        blocks = [
            b for b in motion_blocks(MotionSpace.of(self._unit, FASTEST_DEG_S)) if not b.is_rest
        ]
        best = first_order.outlook(self._products(pair, self._proposed))
        chosen = self._split(self._proposed.steps[1:-1], blocks)
        for _ in range(trials):
            trial = list(chosen)
            place = int(self._rng.integers(len(trial)))
            kind = int(self._rng.integers(3))
            if kind != 0:
                trial.pop(place)
            if kind != 1 or not trial:
                trial.insert(place, blocks[int(self._rng.integers(len(blocks)))])
            space = MotionSpace.of(self._unit, FASTEST_DEG_S)
            program = program_of_blocks(trial, space, self._settings, "changed")
            if self._duration_s(program) > MAX_PROGRAM_S:
                continue
            outlook = first_order.outlook(self._products(pair, program))
            if outlook[0] > best[0]:
                best, chosen = outlook, trial
        return best

    @staticmethod
    def _split(steps: tuple[Step, ...], blocks: list[MotionBlock]) -> list[MotionBlock]:
        """Return a program as the blocks that it consists of; the rest of it as one block."""
        matches: list[MotionBlock] = []
        longest_first = sorted(blocks, key=lambda block: -len(block.steps))
        while steps:
            match = next((b for b in longest_first if steps[: len(b.steps)] == b.steps), None)
            if match is None:
                return [*matches, MotionBlock("others", steps)]
            matches.append(match)
            steps = steps[len(match.steps) :]
        return matches

    def _products(self, pair: CausePair, program: MotionProgram) -> PairProducts:
        (products,) = pair_products(simulate_recording(self._solution, program, self._unit), [pair])
        return products

    def _duration_s(self, program: MotionProgram) -> float:
        return simulate_program(program, self._unit).duration_s


def _static() -> Step:
    return Step(rest=Rest(BLOCK_STATIC_S, "static"))


def judge_session(name: str, number: int, asked: argparse.Namespace) -> list[tuple[float, ...]]:
    """Return the figures of each pair of a session that states a set of causes."""
    draw, _ = draw_of(name, number)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "first.mcap"
        record(draw, path)
        recording = read_recording(path)
        explanation = explain_recordings([recording], recording.board_ids[0])
        unit = recorded_unit(recording.metadata["gyrorig.ptu"])
        proposed = None if unit is None else propose_program(explanation, unit)
        if unit is None or proposed is None or proposed.program is None:
            return []
        solution = judged_by_typical_noise(explanation.solution_extended)
        session = Session(solution, unit, proposed.program)
        groups = ambiguous_groups(explanation, solution)
        return [session.judge(pair, asked) for group in groups for pair in group]


def main() -> None:
    """Print one line for each pair, and the means."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--motions", type=int, default=60, help="random motions of the bound")
    parser.add_argument("--trials", type=int, default=120, help="random changes of a program")
    asked = parser.parse_args()
    stop_s = time.monotonic() + 60.0 * asked.minutes
    rows: list[tuple[float, ...]] = []
    print(
        "| session | proposed, nats | probability | changed | probability | bound | probability |"
    )
    print("|---|---|---|---|---|---|---|")
    for number in range(1000):
        for name in [pair for pair in PAIRS if "warm_up" not in pair]:
            if time.monotonic() > stop_s:
                break
            for row in judge_session(name, number, asked):
                rows.append(row)
                cells = [f"{n:.1f} | {p:.3f}" for n, p in zip(row[::2], row[1::2], strict=True)]
                print(f"| {name} {number} | {' | '.join(cells)} |", flush=True)
    if rows:
        means = np.mean(np.array(rows)[:, 1::2], axis=0)
        print(
            f"{len(rows)} pairs: mean probability of one name {means[0]:.3f}, after changes "
            f"{means[1]:.3f}, bound {means[2]:.3f}"
        )


if __name__ == "__main__":
    main()
