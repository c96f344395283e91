"""Noise-free rates of the twin of a fit, beside those of the truth, for each cause.

A session is emulated without noise and with one cause hidden. The solver fits the base model and
the cause's term to it, as in `completeness`. The values of this fit become a twin, and the twin's
noise-free rates under the same commands are compared with those of the truth:

    share = rms(truth - twin - rest) / rms(truth - truth without the cause),

where the rest is truth minus twin of the same session with nothing hidden: what a fit misses of any
session, above all by the rounded answers of the unit. It is the test of the conventions between
findings and emulator: names, signs, units, and what the base model absorbs. `rest` in the table is
the rms of the rest over that of the effect.

This is a scorer's module: truth and finder meet here alone.

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
from tests.hidden.completeness import SAME, SOAKED, _exact, extended, fitted, noise_held
from tests.hidden.truth.session import (
    BOARD,
    ORIGIN_NS,
    RecordedSession,
    RigDraw,
    record,
    settings_of,
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
    """How far a twin is from the truth, over the effect of the cause."""

    share: float
    rest: float  # with nothing hidden
    values: dict[str, float]


def share_of(hidden: str, program: str = "survey-40", seed: int = SEED) -> TwinShare:
    """Return the share of a cause's effect that the twin of its fit misses.

    Args:
        hidden: CAUSE[@PLACE][:SIZE].
        program: of config/programs.
        seed: of the rig.

    Raises:
        ValueError: the cause could not be fitted.
    """
    name = hidden.partition(":")[0].partition("@")[0]
    if ":" not in hidden:
        hidden = f"{hidden}:{CAUSES[name].typical!r}"
    soak_k = SOAKED.get(name, 0.0)
    difference, effect, values = _difference(hidden, program, soak_k, seed)
    rest, _, _ = _rest(program, soak_k, seed)
    count = min(len(difference), len(rest))
    size, missed, rest_size = (
        float(np.sqrt((part**2).mean()))
        for part in (effect, difference[:count] - rest[:count], rest)
    )
    return TwinShare(missed / size, rest_size / size, values)


@cache
def _rest(
    program: str, soak_k: float, seed: int
) -> tuple[FloatArray, FloatArray, dict[str, float]]:
    return _difference("", program, soak_k, seed)


def _difference(
    hidden: str, program: str, soak_k: float, seed: int
) -> tuple[FloatArray, FloatArray, dict[str, float]]:
    """Return truth minus twin, truth minus truth without the cause, (n, 3), and fitted values."""
    hide = (parse_injection(hidden),) if hidden else ()
    draw = RigDraw(seed, program, soak_k, hide=hide, noise_free=True)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "session.mcap"
        session = record(draw, path)
        recording = read_recording(path)
        rates = compare_noise_free(session.rig, session.course.until_ns)[BOARD]
        samples = load_samples(recording, BOARD)
        with noise_held():
            fit = fitted(recording, samples, _exact(samples, rates.hidden_rad_s))
            if hidden:
                name, _, place = hidden.partition(":")[0].partition("@")
                fit = extended(fit, SAME.get((name, place or None), name))
        anchor_ns = int(recording.metadata["gyrorig"]["anchor_utc_ns"])
        zero_s = (samples.origin_ns - anchor_ns) * 1e-9
    twin, values = _twin(fit, samples, session, zero_s)
    settings = replace(
        settings_of(draw), injections=(), session_s=(zero_s + float(samples.time_s[0]), 0.0)
    )
    made = make_twin_rig(twin, settings)
    course = session.course
    replayed = RigTwin(made.settings, ORIGIN_NS, course.orders, course.until_ns, made.plain)
    rig = EmulatedRig(made.settings, ORIGIN_NS, made.truth)
    twin_rates = replayed.rates(rig)[BOARD]
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


def _twin(
    fit: ConvergedFit, samples: GyroSamples, session: RecordedSession, zero_s: float
) -> tuple[Twin, dict[str, float]]:
    """Return the section of a fit, with the rest of the board from the truth."""
    truth = session.rig.board_truth(BOARD).imu
    base = fit.estimate[:BASE_VALUES]
    times_s = np.arange(0.0, float(samples.time_s[-1]) + zero_s + 1.0, 1.0)
    temperature = BoardTemperature(
        truth.ambient_degc, truth.self_heating_k, truth.warm_up_s, 0.0, truth.soak_k, truth.soak_s
    )
    recorded_s = np.linspace(float(samples.time_s[0]), float(samples.time_s[-1]), 500) + zero_s
    values: dict[str, float] = {}
    causes: list[dict[str, Any]] = []
    for term in fit.fitted_terms:
        values = dict(zip(value_names(term.term), map(float, term.values), strict=True))
        is_on_board = CAUSES[term.term.cause].is_on_board()
        parameters = {name: _quantity(value) for name, value in values.items()}
        causes.append(
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
                "gain": _quantity(base[:9].reshape(3, 3).tolist()),
                "bias": _quantity(base[9:12].tolist()),
                "time_offset": _quantity(float(base[12])),
                "odr": _quantity(truth.odr_hz),
                "bandwidth": _quantity(session.rig.settings.boards[0].bandwidth_hz),
                "temperature": {
                    "time_s": (times_s - zero_s).tolist(),
                    "degc": temperature.degc(times_s).tolist(),
                    "reference_degc": float(temperature.degc(recorded_s).mean()),
                },
            }
        },
        "causes": causes,
    }
    return msgspec.convert(plain, Twin), values


def _quantity(value: object) -> dict[str, Any]:
    return {"value": value, "std": None, "unit": "1"}


def main() -> None:
    """Print the table of all causes that have a term to fit."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--program", default="survey-40")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("causes", nargs="*", metavar="CAUSE[@PLACE][:SIZE]")
    arguments = parser.parse_args()
    known = catalogue()
    wanted = arguments.causes or [
        f"{name}@{place}" if place else name
        for name, cause in CAUSES.items()
        if name in known and known[name].kind == "effect"
        for place in (cause.components if cause.part == "ptu" else ("",)) or ("",)
    ]
    sys.stdout.write(f"{'cause':32} {'share':>9} {'rest':>9}  values\n")
    for hidden in wanted:
        try:
            result = share_of(hidden, arguments.program, arguments.seed)
        except (ValueError, RuntimeError) as fault:
            sys.stdout.write(f"{hidden:32} {fault}\n")
            continue
        words = " ".join(f"{name}={value:.4g}" for name, value in result.values.items())
        sys.stdout.write(f"{hidden:32} {result.share:9.3%} {result.rest:9.3%}  {words}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
