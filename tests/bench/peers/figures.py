"""Make the tables of the bench: errors in units of the bound, and ratios of times.

What to use when: `run_methods` and `format_accuracy` for one program and one kind of reference,
`format_hidden_column` for a column that the program does not determine, `measure_turn_errors` for
a session of imucal, `measure_times` for the CPU times of 75 s at 800 Hz.
"""

import time
from collections.abc import Callable
from functools import partial

import numpy as np
from docs.markdown import number, table
from tests.bench.accuracy.profile import FloatArray
from tests.bench.peers import turns
from tests.bench.peers.methods import OURS, fit_ours, integrate_rates, list_peers
from tests.bench.peers.recording import (
    GROUPS,
    SWEEPS,
    Recording,
    Table,
    compute_bound,
    record,
    split_groups,
)

from gyrorig_solver.estimate.paper.paper_matrices import gain_by_pseudoinverse

RATE_HZ, BANDWIDTH_HZ = 100.0, 25.0  # of the runs for the errors
FAST_HZ, FAST_BANDWIDTH_HZ = 800.0, 110.0  # of the run for the times
MICRO = 1e6
LARGE = 1e3  # ratios from here have two significant digits
EQ_7 = "eq. 7 alone (pseudo-inverse of given angles)"

Estimates = dict[str, FloatArray]
"""By method: the errors and the stated standard deviations, shape (runs, 2, 13)."""


def run_methods(
    program: str, seeds: int, known: bool, columns: tuple[int, ...]
) -> tuple[Estimates, FloatArray]:
    """Return the errors of each method for all seeds, and the bounds, shape (runs, 13)."""
    errors_by_method: dict[str, list[FloatArray]] = {}
    bounds = []
    for seed in range(seeds):
        trial = record(program, seed, RATE_HZ, BANDWIDTH_HZ, known)
        bounds.append(compute_bound(trial, columns))
        for name, run in _list_methods():
            errors_by_method.setdefault(name, []).append(run(trial) - [trial.truth, np.zeros(13)])
    return {name: np.array(errors) for name, errors in errors_by_method.items()}, np.array(bounds)


def format_accuracy(errors: Estimates, bounds: FloatArray, known: bool) -> str:
    """Return the table of the rms errors of each group, in units of the bound.

    Position replies do not determine at which moment of an exchange the unit reads its count. No
    method can estimate this moment. With replies only, the table therefore gives the rms error of
    the time offset in us.
    """
    limitations = {peer.name: peer.limitation for peer in list_peers()}
    rows = []
    for name, method_errors in errors.items():
        error, stated_std = method_errors[:, 0], method_errors[:, 1]
        cells = []
        for at, (group_error, group_bound) in enumerate(
            zip(_split_runs(error), _split_runs(bounds), strict=True)
        ):
            if not np.all(np.isfinite(group_error)):
                cells.append("-")
            elif at == len(GROUPS) - 1 and not known:
                cells.append(f"{number(MICRO * _rms(group_error), 0)} us")
            elif not np.all(np.isfinite(group_bound)):
                cells.append("-")
            else:
                cells.append(format_ratio(_rms(group_error / group_bound)))
        normalised = (error / stated_std)[:, :9]
        is_known = np.isfinite(normalised) & np.isfinite(bounds[:, :9])
        cells.append(
            format_ratio(_rms(normalised[is_known])) if is_known.any() else "no std stated"
        )
        rows.append([name, *cells, limitations.get(name, "")])
    head = ["rms error / bound", *GROUPS, "gain: rms error / stated std", "limitation"]
    return table(head, rows)


def format_hidden_column(errors: Estimates) -> str:
    """Return the table of the roll column for a motion that does not determine it."""
    rows = []
    for name, method_errors in errors.items():
        column = _split_runs(method_errors[:, 0])[1]
        result = "no value"
        if np.all(np.isfinite(column)):
            result = f"a value; the rms error of its three entries is {number(_rms(column), 3)}"
        rows.append([name, result])
    return table(["method", "result for the roll column"], rows)


def measure_turn_errors(seeds: int) -> str:
    """Return the table of the rms errors of imucal and of our fit, in units of the bound."""
    errors_by_method: dict[str, list[FloatArray]] = {}
    for seed in range(seeds):
        turn_session = turns.session(seed, RATE_HZ, BANDWIDTH_HZ)
        bounds = turns.compute_bound(turn_session)
        for name, run in _list_turn_methods(turn_session).items():
            errors_by_method.setdefault(name, []).append((run() - turn_session.truth) / bounds)
    rows = []
    for name, run_errors in errors_by_method.items():
        normalised = np.array(run_errors)
        rows.append(
            [name, format_ratio(_rms(normalised[:, :9])), format_ratio(_rms(normalised[:, 9:]))]
        )
    return table(["rms error / bound", "gain", "bias"], rows)


def measure_times(repeat: int) -> str:
    """Return the table of CPU times for 75 s at 800 Hz, from arrays in memory to parameters.

    The times of the peers do not include their tables of the angles of the unit. The time of our
    fit includes its reference.
    """
    trial = record(SWEEPS, 0, FAST_HZ, FAST_BANDWIDTH_HZ, known=False)
    measured_rad, stage_rad = (
        np.ascontiguousarray(side.T) for side in integrate_rates(trial.table)
    )
    methods: dict[str, Callable[[], object]] = {
        EQ_7: lambda: gain_by_pseudoinverse(measured_rad, stage_rad),
        OURS: lambda: fit_ours(trial),
        f"{OURS}, its reference alone": trial.reference,
        **{peer.name: partial(peer.run, trial.table) for peer in list_peers()},
        **_list_turn_methods(turns.session(0, FAST_HZ, FAST_BANDWIDTH_HZ)),
    }
    measured_s = _measure_cpu_s(methods, repeat)
    rows = [
        [
            name,
            number(1e3 * time_s, 2),
            *(
                format_ratio(time_s / measured_s[reference]) if reference in measured_s else "-"
                for reference in (EQ_7, turns.IMUCAL, OURS)
            ),
        ]
        for name, time_s in measured_s.items()
    ]
    head = ["method", "processor time, ms"]
    head += [f"time / time of {reference}" for reference in ("eq. 7 alone", "imucal", OURS)]
    return table(head, rows)


def format_ratio(value: float) -> str:
    """Return a ratio with about three digits and without an exponent."""
    if value >= LARGE:
        return number(float(f"{value:.2g}"), 0)
    return number(value, 0 if value >= 100.0 else 2 if value >= 0.1 else 4)


def rms_uncertainty_percent(seeds: int) -> float:
    """Return the standard uncertainty of an rms over the runs and three entries."""
    return 100.0 / float(np.sqrt(2.0 * 3.0 * seeds))


def _list_methods() -> list[tuple[str, Callable[[Recording], FloatArray]]]:
    """Return our method and every installed peer."""
    return [(OURS, fit_ours), *((peer.name, _use_table(peer.run)) for peer in list_peers())]


def _use_table(run: Callable[[Table], FloatArray]) -> Callable[[Recording], FloatArray]:
    return lambda trial: run(trial.table)


def _list_turn_methods(turn_session: turns.Session) -> dict[str, Callable[[], FloatArray]]:
    """Return our fit of known turns and, if installed, imucal; both have their data."""
    samples, reference = turn_session.samples, turn_session.reference
    methods: dict[str, Callable[[], FloatArray]] = {
        turns.OURS: lambda: turns.fit_known_turns(samples, reference)
    }
    if turns.imucal_installed():
        methods[turns.IMUCAL] = turns.Imucal(turn_session).compute
    return methods


def _measure_cpu_s(methods: dict[str, Callable[[], object]], repeat: int) -> dict[str, float]:
    """Return the median CPU times; the methods alternate, so that other load affects all."""
    times_s: dict[str, list[float]] = {name: [] for name in methods}
    for _ in range(repeat + 1):
        for name, run in methods.items():
            start_s = time.process_time()
            run()
            times_s[name].append(time.process_time() - start_s)
    return {
        name: float(np.median(method_times_s[1:])) for name, method_times_s in times_s.items()
    }  # the first one is a warm-up


def _split_runs(values: FloatArray) -> list[FloatArray]:
    """Split runs of 13 values into the groups of parameters, each (runs, entries)."""
    parts = [split_groups(value) for value in values]
    return [np.array([part[k] for part in parts]) for k in range(len(GROUPS))]


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
