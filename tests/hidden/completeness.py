"""How much of an effect its own term leaves in the residual where there is no noise.

A session is emulated without noise, once with a cause hidden and once without; both come
from one seed. The solver fits the base model, then the base model and the cause's term, the
term begun where the finder's exact refit puts it. With E(fit, session) the energy of the
residual,

    share = (E(base + term, hidden) - floor) / (E(base, hidden) - floor),
    floor = E(base, nothing hidden).

Energy is the sum of squares of the residual of all samples with a known motion, those that
were taken for spikes and those that a cause has left out among them, whitened by the noise of
an ordinary part (0.03 dps/sqrt(Hz) and what goes with it): so it is in units of what can be
seen, twice the nats. The fits weigh by that noise too, and judge spikes by its deviation:
levels found in a residual without noise would be those of what a model lacks. Rates are those
that the emulated sensor had before it rounded them, where a word is nothing but such a rate
rounded. The floor is then what the base model lacks of the emulated rig, above all the unit's
rounded answers; it is printed with the table, and may be a little less in one session than in
another.

This is a scorer's module: truth and finder meet here in files alone.

Run: python tests/hidden/completeness.py [--program survey-40] [CAUSE[@PLACE][:SIZE] ...]
"""

import argparse
import contextlib
import io
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from unittest.mock import patch

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import msgspec
import numpy as np
from numpy.typing import NDArray
from tests.hidden.scoring.complete import UNSEEN, Remainder
from tests.hidden.scoring.goals import COMPLETE_LEFT

from gyrorig_daemon.cli import run
from gyrorig_daemon.emulator.injection.cause_catalogue import CAUSES
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.data.samples import GyroSamples, load_samples
from gyrorig_solver.discover.candidate_fits import fit_best_place
from gyrorig_solver.discover.extended_fit import extend_fit
from gyrorig_solver.discover.motion_space import MotionFitSpace
from gyrorig_solver.discover.score_tests import scan_catalogue
from gyrorig_solver.discover.template_choice import all_templates
from gyrorig_solver.discover.testable_terms import count_tests, testable_terms
from gyrorig_solver.estimate import (
    ConvergedFit,
    NoiseModel,
    NuisanceProjector,
    SessionFit,
    Spectrum,
    nominal_levels,
)
from gyrorig_solver.estimate.linear.whitening import whiten_residual
from gyrorig_solver.estimate.motion_fit import solve_motion
from gyrorig_solver.estimate.noise.noise_model import Sampling
from gyrorig_solver.model.catalogue import catalogue
from gyrorig_solver.model.causes.base_compliance import BaseCompliance
from gyrorig_solver.pipeline.recording_contexts import read_contexts
from gyrorig_solver.pipeline.term_selection import select_terms
from gyrorig_solver.reference import read_pan_tilt_reference

ROOT = Path(__file__).resolve().parents[2]
SEED = 7
GOAL = COMPLETE_LEFT
# One function of the angle, and so a set of two names.
SAME: dict[tuple[str, str | None], str] = {("eccentricity", "tilt"): "tilt_sag"}
SOAKED = {"thermal_bias": 15.0, "thermal_scale": 15.0}  # kelvin; as little warms up by itself
DENSITY_RAD_S_RTHZ = np.radians(0.03)  # L3G4200D data sheet


@dataclass(frozen=True, slots=True)
class Energies:
    """What is left of a session's residual, whitened; see the module."""

    floor: float
    base: float
    term: float
    values: tuple[float, ...] = ()  # of the term

    @property
    def effect(self) -> float:
        """Energy of the effect beside the base model."""
        return self.base - self.floor

    @property
    def share(self) -> float:
        """Share of it that the term leaves."""
        return (self.term - self.floor) / self.effect


def left_share(
    cause: str,
    size: float | None = None,
    place: str | None = None,
    program: str = "survey-40",
    soak_k: float | None = None,
    seed: int = SEED,
) -> float:
    """Return the share of a cause's energy that its term leaves.

    Args:
        cause: id of the catalogue.
        size: in the emulator's unit; None: its typical size.
        place: axis; None: drawn from the seed.
        program: of config/programs.
        soak_k: by how much the room warms up and cools down.
        seed: of the rig and of what is drawn of the cause.
    """
    return energies(cause, size, place, program, soak_k, seed).share


def energies(
    cause: str,
    size: float | None = None,
    place: str | None = None,
    program: str = "survey-40",
    soak_k: float | None = None,
    seed: int = SEED,
) -> Energies:
    """Return the energies that `left_share` is made of; arguments as there."""
    size = CAUSES[cause].typical if size is None else size
    hide = cause + (f"@{place}" if place else "") + f":{size!r}"
    with noise_held():
        base = _solved(program, soak_k, seed, hide)
        extended_fit = extended(base, SAME.get((cause, place), cause))
    values = extended_fit.fitted_terms[-1].values if extended_fit.fitted_terms else np.zeros(0)
    floor = floor_of(program, soak_k, seed)
    return Energies(floor, energy(base), energy(extended_fit), tuple(values.tolist()))


@cache
def floor_of(program: str, soak_k: float | None, seed: int) -> float:
    """Return what the base model leaves of a session with nothing hidden."""
    with noise_held():
        return energy(_solved(program, soak_k, seed))


def extended(base: ConvergedFit, cause: str) -> ConvergedFit:
    """Fit a cause beside a base fit at all its places, from where the finder would begin."""
    projection = NuisanceProjector.at_fit(base)
    term = catalogue()[cause]
    tests = count_tests(testable_terms(projection))
    scores = scan_catalogue(projection, [term], tests, all_templates(projection, term))
    # A place left out because it shows too little to be worth it would count as left.
    best = fit_best_place(projection, [s for s in scores if s.place is None])
    if best is None:
        raise ValueError(f"{cause} could not be fitted")
    return extend_fit(MotionFitSpace(base), best[0].extension).solution


def energy(solution: ConvergedFit) -> float:
    """Return the whitened energy of a fit's residual, spikes and all."""
    total = 0.0
    for session in solution.sessions:
        every = session.copy()
        for stretch in every._series_states:
            stretch.good = stretch.series.good.copy()
        with patch.object(BaseCompliance, "timing_sensitive_mask", lambda *_: None):
            every.update_prediction(solution.gain, detect_outliers=False, new_derivatives=False)
        noise = _ordinary(session.sampling)
        for series, residual in zip(every.series, every.residuals(solution.gain), strict=True):
            white = whiten_residual([residual[part] for part in series.part_slices()], noise)
            total += float(np.sum(white**2))
    return total


def _ordinary(sampling: Sampling) -> NoiseModel:
    levels = np.tile(nominal_levels(DENSITY_RAD_S_RTHZ**2), (3, 1))
    levels[:, 3] = 0.0
    return NoiseModel(levels, replace(sampling, quantum_rad_s=0.0))


@contextlib.contextmanager
def noise_held() -> Iterator[None]:
    """Let fits weigh by an ordinary part's noise, at rest and in motion."""

    def held(_spectrum: Spectrum, sampling: Sampling, _before: object = None) -> NoiseModel:
        return _ordinary(sampling)

    with (
        patch("gyrorig_solver.estimate.session_noise.fit_noise_levels", held),
        patch("gyrorig_solver.estimate.session_noise.limit_to_rest", lambda noise, _: noise),
        patch.object(SessionFit, "update_motion_noise", lambda *_: False),
    ):
        yield


def _solved(program: str, soak_k: float | None, seed: int, *hidden: str) -> ConvergedFit:
    """Record a session in simulated time and fit the base model to it."""
    options = [word for cause in hidden for word in ("--hide", cause)]
    options += ["--soak", repr(soak_k)] if soak_k else []
    with tempfile.TemporaryDirectory() as folder:
        rates = Path(folder) / "rates.npz"
        with contextlib.redirect_stdout(io.StringIO()):
            code = run(
                ["record", "--config", str(ROOT / "config" / "rig.yaml"), "--program",
                 str(ROOT / "config" / "programs" / f"{program}.yaml"), "--out", folder,
                 "--simulated-time", "--noise-free", "--seed", str(seed), "--rates", str(rates),
                 *options]
            )  # fmt: skip
        if code:
            raise RuntimeError(f"recording {hidden} ended with {code}")
        with np.load(rates) as file:
            board = next(name for name in file if name.endswith(".number")).partition(".")[0]
            unrounded = file[f"{board}.hidden_rad_s"]
        return _fitted(read_recording(next(Path(folder).glob("*.mcap"))), board, unrounded)


def _fitted(recording: Recording, board: str, unrounded: NDArray[np.float64]) -> ConvergedFit:
    rounded = load_samples(recording, board)
    return fitted(recording, rounded, _exact(rounded, unrounded))


def fitted(
    recording: Recording, rounded: GyroSamples, rate_rad_s: NDArray[np.float64]
) -> ConvergedFit:
    """Fit the base model to rates without noise; inside `noise_held`.

    Args:
        recording: the unit's part of it is taken.
        rounded: samples of a board of it.
        rate_rad_s: what is put in the place of their rates, (n, 3).
    """
    bandwidth_hz = rounded.bandwidth_hz or 0.5 / rounded.period_s
    deviation = DENSITY_RAD_S_RTHZ * np.sqrt(1.11 * bandwidth_hz)  # Butterworth, second order
    samples = replace(rounded, rate_rad_s=rate_rad_s, quantum_rad_s=float(deviation))
    reference = read_pan_tilt_reference(recording, samples.origin_ns)
    recordings = [(recording, samples, reference)]
    chosen = select_terms(recordings, ())
    settings = [
        replace(context, quantum_rad_s=rounded.quantum_rad_s)
        for context in chosen.contexts or read_contexts(recordings)
    ]
    return solve_motion([(samples, reference)], chosen.extensions, settings)


def _exact(samples: GyroSamples, unrounded: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return rates before rounding, where the words are such rates rounded."""
    number, words = np.asarray(samples.number, dtype=np.int64), samples.rate_rad_s
    often = slice(None, None, 7)
    shifts = range(len(unrounded) - int(number.max()))
    misfit = [
        float(np.median(np.abs(unrounded[number[often] + k] - words[often]).max(axis=1)))
        for k in shifts
    ]
    exact = unrounded[number + shifts[int(np.argmin(misfit))]]
    return np.where(np.abs(exact - words) <= 0.51 * samples.quantum_rad_s, exact, words)


def main() -> None:
    """Print the table of all causes that have a term to fit."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--program", default="survey-40")
    parser.add_argument("--soak", type=float)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures here too")
    parser.add_argument("causes", nargs="*", metavar="CAUSE[@PLACE][:SIZE]")
    arguments = parser.parse_args()
    known = catalogue()
    wanted = arguments.causes or [
        f"{name}@{place}" if place else name
        for name, cause in CAUSES.items()
        if name in known and known[name].kind == "effect"
        for place in (cause.components if cause.part == "ptu" else ("",)) or ("",)
    ]
    sys.stdout.write(
        f"{'cause':32} {'floor':>6} {'effect':>11} {'left':>9} {'share':>8}  seconds  values\n"
    )
    lines = [_line(cause, arguments.program, arguments.soak, arguments.seed) for cause in wanted]
    if arguments.json is not None:
        remainders = [line for line in lines if line is not None]
        arguments.json.write_bytes(
            msgspec.json.format(msgspec.json.encode(remainders), indent=1) + b"\n"
        )


def _line(hidden_cause: str, program: str, soak_k: float | None, seed: int) -> Remainder | None:
    """Fit one cause, print its line and return it; None where it cannot be fitted."""
    name, _, size = hidden_cause.partition(":")
    cause, _, place = name.partition("@")
    soak_k = SOAKED.get(cause) if soak_k is None else soak_k
    begin = time.monotonic()
    try:
        e = energies(cause, float(size) if size else None, place or None, program, soak_k, seed)
    except (ValueError, RuntimeError) as fault:
        sys.stdout.write(f"{hidden_cause:32} {fault}\n")
        return None
    words = " ".join(f"{v:.5g}" for v in e.values)
    share = f"{e.share:8.3%}" if e.effect > UNSEEN else "  in base"
    mark = "*" if e.effect > UNSEEN and e.share > GOAL else ""
    sys.stdout.write(
        f"{hidden_cause:32} {e.floor:6.1f} {e.effect:11.1f} {e.term - e.floor:9.2f} {share:9}"
        f"{mark:1} {time.monotonic() - begin:6.1f}  {words}\n"
    )
    sys.stdout.flush()
    effect, left = round(e.effect, 2), round(e.term - e.floor, 4)
    return Remainder(cause, place, program, soak_k or 0.0, effect, left)


if __name__ == "__main__":
    main()
