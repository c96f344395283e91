"""The tables of the bench: errors in units of the bound, and times as ratios.

What to use when: `accuracy` for one program and one kind of knowledge over many seeds,
`hidden_column` for what is said of a column that the program does not show, `turned` for
imucal's kind of session, `times` for how long each takes on 75 s at 800 Hz.
"""

import time
from collections.abc import Callable
from functools import partial

import numpy as np
from docs.markdown import number, table
from tests.bench.accuracy.profile import FloatArray
from tests.bench.peers import turns
from tests.bench.peers.methods import OURS, integrated, ours, peers
from tests.bench.peers.recording import GROUPS, SWEEPS, Recording, Table, bound, groups, record

from gyrorig_solver.estimate.paper.paper_matrices import gain_by_pseudoinverse

RATE_HZ, BANDWIDTH_HZ = 100.0, 25.0  # of the runs whose errors are judged
FAST_HZ, FAST_BANDWIDTH_HZ = 800.0, 110.0  # of the one that is timed
MICRO = 1e6
LARGE = 1e3  # a ratio from here on has two digits that count
EQ_7 = "eq. 7 alone (pseudo-inverse of given angles)"

Estimates = dict[str, FloatArray]
"""By method: what was found less what is true, and what it states, shape (runs, 2, 13)."""


def runs(
    program: str, seeds: int, known: bool, columns: tuple[int, ...]
) -> tuple[Estimates, FloatArray]:
    """Return each method's errors over the seeds, and the bounds, shape (runs, 13)."""
    errors_by_method: dict[str, list[FloatArray]] = {}
    bounds = []
    for seed in range(seeds):
        trial = record(program, seed, RATE_HZ, BANDWIDTH_HZ, known)
        bounds.append(bound(trial, columns))
        for name, run in _ways():
            errors_by_method.setdefault(name, []).append(run(trial) - [trial.truth, np.zeros(13)])
    return {name: np.array(errors) for name, errors in errors_by_method.items()}, np.array(bounds)


def accuracy(errors: Estimates, bounds: FloatArray, known: bool) -> str:
    """The rms error of each group in units of the bound; the offset in us where it is hidden.

    With answers only, when in an exchange the unit looked at its count is known to nobody: that
    shift is no method's fault, so the offset is then given as it is.
    """
    limitations = {peer.name: peer.limitation for peer in peers()}
    rows = []
    for name, method_errors in errors.items():
        error, stated = method_errors[:, 0], method_errors[:, 1]
        cells = []
        for at, (off, least) in enumerate(zip(_by_group(error), _by_group(bounds), strict=True)):
            if not np.all(np.isfinite(off)):
                cells.append("-")
            elif at == len(GROUPS) - 1 and not known:
                cells.append(f"{number(MICRO * _rms(off), 0)} us")
            elif not np.all(np.isfinite(least)):
                cells.append("-")
            else:
                cells.append(ratio(_rms(off / least)))
        units = (error / stated)[:, :9]
        is_known = np.isfinite(units) & np.isfinite(bounds[:, :9])
        cells.append(ratio(_rms(units[is_known])) if is_known.any() else "no std stated")
        rows.append([name, *cells, limitations.get(name, "")])
    head = ["rms error / bound", *GROUPS, "gain: rms error / stated std", "limitation"]
    return table(head, rows)


def hidden_column(errors: Estimates) -> str:
    """What each method says of the roll column where nothing turned about roll."""
    rows = []
    for name, method_errors in errors.items():
        column = _by_group(method_errors[:, 0])[1]
        words = "no value"
        if np.all(np.isfinite(column)):
            words = f"a value; the rms error of its three entries is {number(_rms(column), 3)}"
        rows.append([name, words])
    return table(["method", "result for the roll column"], rows)


def turned(seeds: int) -> str:
    """imucal and our turns on its own kind of session, in units of the bound."""
    errors_by_method: dict[str, list[FloatArray]] = {}
    for seed in range(seeds):
        turn_session = turns.session(seed, RATE_HZ, BANDWIDTH_HZ)
        least = turns.bound(turn_session)
        for name, run in _turn_ways(turn_session).items():
            errors_by_method.setdefault(name, []).append((run() - turn_session.truth) / least)
    rows = []
    for name, units in errors_by_method.items():
        all_of = np.array(units)
        rows.append([name, ratio(_rms(all_of[:, :9])), ratio(_rms(all_of[:, 9:]))])
    return table(["rms error / bound", "gain", "bias"], rows)


def times(repeat: int) -> str:
    """CPU time of each method on 75 s at 800 Hz, from arrays in memory to parameters.

    The peers' table of the unit's angles is ready beforehand; ours is made within its time.
    """
    trial = record(SWEEPS, 0, FAST_HZ, FAST_BANDWIDTH_HZ, known=False)
    measured_rad, stage_rad = (np.ascontiguousarray(side.T) for side in integrated(trial.table))
    ways: dict[str, Callable[[], object]] = {
        EQ_7: lambda: gain_by_pseudoinverse(measured_rad, stage_rad),
        OURS: lambda: ours(trial),
        f"{OURS}, its reference alone": trial.reference,
        **{peer.name: partial(peer.run, trial.table) for peer in peers()},
        **_turn_ways(turns.session(0, FAST_HZ, FAST_BANDWIDTH_HZ)),
    }
    measured = _cpu_s(ways, repeat)
    rows = [
        [
            name,
            number(1e3 * taken, 2),
            *(
                ratio(taken / measured[reference]) if reference in measured else "-"
                for reference in (EQ_7, turns.IMUCAL, OURS)
            ),
        ]
        for name, taken in measured.items()
    ]
    head = ["method", "processor time, ms"]
    head += [f"time / time of {reference}" for reference in ("eq. 7 alone", "imucal", OURS)]
    return table(head, rows)


def ratio(value: float) -> str:
    """Three digits or so, without an exponent."""
    if value >= LARGE:
        return number(float(f"{value:.2g}"), 0)
    return number(value, 0 if value >= 100.0 else 2 if value >= 0.1 else 4)


def spread_percent(seeds: int) -> float:
    """How far an rms over so many runs and three entries is from the true one, one sigma."""
    return 100.0 / float(np.sqrt(2.0 * 3.0 * seeds))


def _ways() -> list[tuple[str, Callable[[Recording], FloatArray]]]:
    """Ours, then every peer that runs here."""
    return [(OURS, ours), *((peer.name, _on_table(peer.run)) for peer in peers())]


def _on_table(run: Callable[[Table], FloatArray]) -> Callable[[Recording], FloatArray]:
    return lambda trial: run(trial.table)


def _turn_ways(turn_session: turns.Session) -> dict[str, Callable[[], FloatArray]]:
    """Ours by known turns and, where it is installed, imucal; both made ready."""
    samples, reference = turn_session.samples, turn_session.reference
    ways: dict[str, Callable[[], FloatArray]] = {
        turns.OURS: lambda: turns.by_turns(samples, reference)
    }
    if turns.imucal_installed():
        ways[turns.IMUCAL] = turns.Imucal(turn_session).compute
    return ways


def _cpu_s(ways: dict[str, Callable[[], object]], repeat: int) -> dict[str, float]:
    """Return median CPU times, in turns, so that a busy machine spoils all alike."""
    taken: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(repeat + 1):
        for name, run in ways.items():
            begun = time.process_time()
            run()
            taken[name].append(time.process_time() - begun)
    return {
        name: float(np.median(times_s[1:])) for name, times_s in taken.items()
    }  # the first warms up


def _by_group(values: FloatArray) -> list[FloatArray]:
    """Split runs of 13 values into the groups, each (runs, entries)."""
    parts = [groups(value) for value in values]
    return [np.array([part[k] for part in parts]) for k in range(len(GROUPS))]


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
