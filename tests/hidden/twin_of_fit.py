"""Compare the noise-free rates of the twin of a fit with those of the truth, for each cause.

The program emulates a session without noise and with one hidden cause. The solver fits the base
model and the term of the cause, as in `completeness`. The program makes a twin from the values of
this fit. It compares the noise-free rates of twin and truth under the same commands:

    share = rms(truth - twin - rest) / rms(truth - truth without the cause),

The rest is truth minus twin of the same session without a hidden cause. It is the error of a fit in
any session, mostly from the rounded replies of the unit. The program tests the conventions between
findings and emulator: names, signs, units, and the part that the base model absorbs. The column
`rest` is the rms of the rest relative to that of the effect.

This is a module of the scorer: only here do truth and solver meet.

Run: python tests/hidden/twin_of_fit.py [--program survey-40] [CAUSE[@PLACE][:SIZE] ...]
"""

import argparse
import os
import sys
import tempfile
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import msgspec
import numpy as np
from numpy.typing import NDArray
from tests.hidden.completeness import (
    SAME_EFFECT,
    SOAK_K,
    fit_cause,
    fit_without_noise,
    fix_noise,
    restore_unrounded,
)
from tests.hidden.truth.session import (
    BOARD,
    ORIGIN_NS,
    RecordedSession,
    RigDraw,
    make_settings,
    record,
)

from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.injection import CAUSES, parse_injection
from gyrorig_daemon.emulator.noise_free_rates import RigTwin, compare_noise_free
from gyrorig_daemon.emulator.physics.temperature import BoardTemperature
from gyrorig_daemon.emulator.twin import make_twin_rig
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.twin import Twin
from gyrorig_solver.data.samples import GyroSamples, load_samples
from gyrorig_solver.estimate import ConvergedFit
from gyrorig_solver.model.catalogue import catalogue
from gyrorig_solver.model.term import value_names

SEED = 7
BASE_VALUES = 13  # gain, bias, time offset

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class TwinShare:
    """Difference between a twin and the truth, relative to the effect of the cause."""

    share: float
    rest: float  # without a hidden cause
    values: dict[str, float]


def measure_share(hidden: str, program: str = "survey-40", seed: int = SEED) -> TwinShare:
    """Return the share of a cause's effect that the twin of its fit misses.

    Args:
        hidden: CAUSE[@PLACE][:SIZE].
        program: of config/programs.
        seed: of the rig.

    Raises:
        ValueError: the solver could not fit the cause.
    """
    name = hidden.partition(":")[0].partition("@")[0]
    if ":" not in hidden:
        hidden = f"{hidden}:{CAUSES[name].typical!r}"
    soak_k = SOAK_K.get(name, 0.0)
    difference, effect, values = _measure_difference(hidden, program, soak_k, seed)
    rest, _, _ = _measure_rest(program, soak_k, seed)
    count = min(len(difference), len(rest))
    effect_rms, error_rms, rest_rms = (
        float(np.sqrt((part**2).mean()))
        for part in (effect, difference[:count] - rest[:count], rest)
    )
    return TwinShare(error_rms / effect_rms, rest_rms / effect_rms, values)


@cache
def _measure_rest(
    program: str, soak_k: float, seed: int
) -> tuple[FloatArray, FloatArray, dict[str, float]]:
    return _measure_difference("", program, soak_k, seed)


def _measure_difference(
    hidden: str, program: str, soak_k: float, seed: int
) -> tuple[FloatArray, FloatArray, dict[str, float]]:
    """Return truth minus twin, truth minus truth without the cause, (n, 3), and fitted values."""
    hide = (parse_injection(hidden),) if hidden else ()
    draw = RigDraw(seed, program, soak_k, hide=hide, noise_free=True)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "session.mcap"
        session = record(draw, path)
        recording = read_recording(path)
        rates = compare_noise_free(session.rig, session.course.end_ns)[BOARD]
        samples = load_samples(recording, BOARD)
        with fix_noise():
            fit = fit_without_noise(
                recording, samples, restore_unrounded(samples, rates.hidden_rad_s)
            )
            if hidden:
                name, _, place = hidden.partition(":")[0].partition("@")
                fit = fit_cause(fit, SAME_EFFECT.get((name, place or None), name))
        anchor_ns = int(recording.metadata["gyrorig"]["anchor_utc_ns"])
        zero_s = (samples.origin_ns - anchor_ns) * 1e-9
    twin, values = _make_twin(fit, samples, session, zero_s)
    settings = replace(
        make_settings(draw), injections=(), session_s=(zero_s + float(samples.time_s[0]), 0.0)
    )
    twin_rig = make_twin_rig(twin, settings)
    course = session.course
    twin_simulator = RigTwin(
        twin_rig.settings, ORIGIN_NS, course.commands, course.end_ns, twin_rig.plain
    )
    rig = EmulatedRig(twin_rig.settings, ORIGIN_NS, twin_rig.truth)
    twin_rates = twin_simulator.rates(rig)[BOARD]
    first_s, last_s = course.span_s
    inside = (rates.time_s > first_s) & (rates.time_s < last_s)
    count = min(len(twin_rates.hidden_rad_s), len(rates.hidden_rad_s))
    inside = inside[:count]
    hidden_rad_s = rates.hidden_rad_s[:count][inside]
    return (
        hidden_rad_s - twin_rates.hidden_rad_s[:count][inside],
        hidden_rad_s - rates.plain_rad_s[:count][inside],
        values,
    )


def _make_twin(
    fit: ConvergedFit, samples: GyroSamples, session: RecordedSession, zero_s: float
) -> tuple[Twin, dict[str, float]]:
    """Return the twin of a fit, with the other data of the board from the truth, and its values."""
    truth = session.rig.board_truth(BOARD).imu
    base = fit.estimate[:BASE_VALUES]
    times_s = np.arange(0.0, float(samples.time_s[-1]) + zero_s + 1.0, 1.0)
    temperature = BoardTemperature(
        truth.ambient_degc, truth.self_heating_k, truth.warm_up_s, 0.0, truth.soak_k, truth.soak_s
    )
    recorded_s = np.linspace(float(samples.time_s[0]), float(samples.time_s[-1]), 500) + zero_s
    values: dict[str, float] = {}
    cause_entries: list[dict[str, Any]] = []
    for term in fit.fitted_terms:
        values = dict(zip(value_names(term.term), map(float, term.values), strict=True))
        is_on_board = CAUSES[term.term.cause].is_on_board()
        parameters = {name: _make_quantity(value) for name, value in values.items()}
        cause_entries.append(
            {
                "cause": term.term.cause,
                "where": "all",
                "board": BOARD if is_on_board else None,
                "parameters": parameters,
            }
        )
    plain = {
        "schema": "gyrorig/twin/1",
        "created": "",
        "software": "",
        "recordings": [
            {
                "name": "session",
                "sha256": "0" * 64,
                "begin_s": float(samples.time_s[0]),
                "end_s": float(samples.time_s[-1]),
            }
        ],
        "boards": {
            BOARD: {
                "gain": _make_quantity(base[:9].reshape(3, 3).tolist()),
                "bias": _make_quantity(base[9:12].tolist()),
                "time_offset": _make_quantity(float(base[12])),
                "odr": _make_quantity(truth.odr_hz),
                "bandwidth": _make_quantity(session.rig.settings.boards[0].bandwidth_hz),
                "temperature": {
                    "time_s": (times_s - zero_s).tolist(),
                    "degc": temperature.degc(times_s).tolist(),
                    "reference_degc": float(temperature.degc(recorded_s).mean()),
                },
            }
        },
        "causes": cause_entries,
    }
    return msgspec.convert(plain, Twin), values


def _make_quantity(value: object) -> dict[str, Any]:
    return {"value": value, "std": None, "unit": "1"}


def main() -> None:
    """Print the table of all causes that have a term to fit."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--program", default="survey-40")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("causes", nargs="*", metavar="CAUSE[@PLACE][:SIZE]")
    arguments = parser.parse_args()
    known = catalogue()
    causes = arguments.causes or [
        f"{name}@{place}" if place else name
        for name, cause in CAUSES.items()
        if name in known and known[name].kind == "effect"
        for place in (cause.components if cause.part == "ptu" else ("",)) or ("",)
    ]
    sys.stdout.write(f"{'cause':32} {'share':>9} {'rest':>9}  values\n")
    for hidden in causes:
        try:
            result = measure_share(hidden, arguments.program, arguments.seed)
        except (ValueError, RuntimeError) as fault:
            sys.stdout.write(f"{hidden:32} {fault}\n")
            continue
        values_text = " ".join(f"{name}={value:.4g}" for name, value in result.values.items())
        sys.stdout.write(f"{hidden:32} {result.share:9.3%} {result.rest:9.3%}  {values_text}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
