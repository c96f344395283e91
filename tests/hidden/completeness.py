"""Measure the share of an effect that its own term leaves in the residual, without noise.

The program emulates two noise-free sessions of one seed: with and without a hidden cause. The
solver fits the base model, and then the base model with the term of the cause. The start values of
the term are those of the solver's exact refit. With E(fit, session) the energy of the residual,

    share = (E(base + term, hidden) - floor) / (E(base, hidden) - floor),
    floor = E(base, nothing hidden).

The energy is the sum of squares of the whitened residual of all samples with a known motion. It
includes samples that the fit excludes as spikes, or because of a cause. The noise of an ordinary
part (0.03 dps/sqrt(Hz)) whitens the residual, so the unit of the energy is half a nat. The fits use
the same noise as weights, and its standard deviation as the limit of spikes. Noise levels from a
residual without noise would describe only the errors of the model. The rates are those of the
emulated sensor before rounding, if the recorded value is such a rate after rounding. The floor is
the error of the base model for the emulated rig, mostly from the rounded replies of the unit. The
table shows the floor; it differs a little between sessions.

This is a module of the scorer: truth and solver share only files here.

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
# Both causes have the same function of the angle, so the solver states a set of two names.
SAME_EFFECT: dict[tuple[str, str | None], str] = {("eccentricity", "tilt"): "tilt_sag"}
# A board alone warms up by a small part of this.
SOAK_K = {"thermal_bias": 15.0, "thermal_scale": 15.0}
DENSITY_RAD_S_RTHZ = np.radians(0.03)  # L3G4200D data sheet


@dataclass(frozen=True, slots=True)
class Energies:
    """Energies of the whitened residual of a session; see the module."""

    floor: float
    base: float
    term: float
    values: tuple[float, ...] = ()  # of the term

    @property
    def effect(self) -> float:
        """Energy of the effect after the base model."""
        return self.base - self.floor

    @property
    def share(self) -> float:
        """Share of this energy that the term leaves."""
        return (self.term - self.floor) / self.effect


def measure_residual_share(
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
        size: in the unit of the emulator; None: its typical size.
        place: axis; None: drawn from the seed.
        program: of config/programs.
        soak_k: temperature change of the room.
        seed: of the rig and of the cause.
    """
    return measure_energies(cause, size, place, program, soak_k, seed).share


def measure_energies(
    cause: str,
    size: float | None = None,
    place: str | None = None,
    program: str = "survey-40",
    soak_k: float | None = None,
    seed: int = SEED,
) -> Energies:
    """Return the energies for `measure_residual_share`; it has the same arguments."""
    size = CAUSES[cause].typical if size is None else size
    hide = cause + (f"@{place}" if place else "") + f":{size!r}"
    with fix_noise():
        base = record_and_fit(program, soak_k, seed, hide)
        extended_fit = fit_cause(base, SAME_EFFECT.get((cause, place), cause))
    values = extended_fit.fitted_terms[-1].values if extended_fit.fitted_terms else np.zeros(0)
    floor = measure_floor(program, soak_k, seed)
    return Energies(
        floor, compute_energy(base), compute_energy(extended_fit), tuple(values.tolist())
    )


@cache
def measure_floor(program: str, soak_k: float | None, seed: int) -> float:
    """Return the residual energy of the base model in a session without a hidden cause."""
    with fix_noise():
        return compute_energy(record_and_fit(program, soak_k, seed))


def fit_cause(base: ConvergedFit, cause: str) -> ConvergedFit:
    """Fit a cause at all its places after a base fit, from the start values of the solver."""
    projection = NuisanceProjector.at_fit(base)
    term = catalogue()[cause]
    tests = count_tests(testable_terms(projection))
    scores = scan_catalogue(projection, [term], tests, all_templates(projection, term))
    # The solver may omit a place with a small effect; that effect would count as residual.
    best = fit_best_place(projection, [s for s in scores if s.place is None])
    if best is None:
        raise ValueError(f"{cause} could not be fitted")
    return extend_fit(MotionFitSpace(base), best[0].extension).solution


def compute_energy(solution: ConvergedFit) -> float:
    """Return the whitened energy of the residual of a fit, with spikes."""
    total = 0.0
    for session in solution.sessions:
        copied_session = session.copy()
        for stretch in copied_session._series_states:
            stretch.good = stretch.series.good.copy()
        with patch.object(BaseCompliance, "timing_sensitive_mask", lambda *_: None):
            copied_session.update_prediction(
                solution.gain, detect_outliers=False, new_derivatives=False
            )
        noise = _make_ordinary_noise(session.sampling)
        for series, residual in zip(
            copied_session.series, copied_session.residuals(solution.gain), strict=True
        ):
            whitened = whiten_residual([residual[part] for part in series.part_slices()], noise)
            total += float(np.sum(whitened**2))
    return total


def _make_ordinary_noise(sampling: Sampling) -> NoiseModel:
    levels = np.tile(nominal_levels(DENSITY_RAD_S_RTHZ**2), (3, 1))
    levels[:, 3] = 0.0
    return NoiseModel(levels, replace(sampling, quantum_rad_s=0.0))


@contextlib.contextmanager
def fix_noise() -> Iterator[None]:
    """Use the noise of an ordinary part as the weights of all fits, at rest and in motion."""

    def make_fixed_noise(
        _spectrum: Spectrum, sampling: Sampling, _before: object = None
    ) -> NoiseModel:
        return _make_ordinary_noise(sampling)

    with (
        patch("gyrorig_solver.estimate.session_noise.fit_noise_levels", make_fixed_noise),
        patch("gyrorig_solver.estimate.session_noise.limit_to_rest", lambda noise, *_: noise),
        patch.object(SessionFit, "update_motion_noise", lambda *_: False),
    ):
        yield


def record_and_fit(program: str, soak_k: float | None, seed: int, *hidden: str) -> ConvergedFit:
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
        return _fit_recording(read_recording(next(Path(folder).glob("*.mcap"))), board, unrounded)


def _fit_recording(
    recording: Recording, board: str, unrounded: NDArray[np.float64]
) -> ConvergedFit:
    rounded = load_samples(recording, board)
    return fit_without_noise(recording, rounded, restore_unrounded(rounded, unrounded))


def fit_without_noise(
    recording: Recording, rounded: GyroSamples, rate_rad_s: NDArray[np.float64]
) -> ConvergedFit:
    """Fit the base model to rates without noise; call this inside `fix_noise`.

    Args:
        recording: provides the replies of the unit.
        rounded: samples of a board of the recording.
        rate_rad_s: rates that replace those of the samples, (n, 3).
    """
    bandwidth_hz = rounded.bandwidth_hz or 0.5 / rounded.period_s
    deviation = DENSITY_RAD_S_RTHZ * np.sqrt(1.11 * bandwidth_hz)  # Butterworth, second order
    samples = replace(rounded, rate_rad_s=rate_rad_s, quantum_rad_s=float(deviation))
    reference = read_pan_tilt_reference(recording, samples.origin_ns)
    recordings = [(recording, samples, reference)]
    selection = select_terms(recordings, ())
    settings = [
        replace(context, quantum_rad_s=rounded.quantum_rad_s)
        for context in selection.contexts or read_contexts(recordings)
    ]
    return solve_motion([(samples, reference)], selection.extensions, settings)


def restore_unrounded(samples: GyroSamples, unrounded: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rates before rounding, if the recorded rates are their rounded values."""
    number, measured_rad_s = np.asarray(samples.number, dtype=np.int64), samples.rate_rad_s
    seventh = slice(None, None, 7)
    shifts = range(len(unrounded) - int(number.max()))
    misfit = [
        float(
            np.median(np.abs(unrounded[number[seventh] + k] - measured_rad_s[seventh]).max(axis=1))
        )
        for k in shifts
    ]
    exact = unrounded[number + shifts[int(np.argmin(misfit))]]
    return np.where(
        np.abs(exact - measured_rad_s) <= 0.51 * samples.quantum_rad_s, exact, measured_rad_s
    )


def main() -> None:
    """Print the table of all causes that have a term to fit."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--program", default="survey-40")
    parser.add_argument("--soak", type=float)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument(
        "--json", type=Path, metavar="FILE", help="also write the results to this file"
    )
    parser.add_argument("causes", nargs="*", metavar="CAUSE[@PLACE][:SIZE]")
    arguments = parser.parse_args()
    known = catalogue()
    causes = arguments.causes or [
        f"{name}@{place}" if place else name
        for name, cause in CAUSES.items()
        if name in known and known[name].kind == "effect"
        for place in (cause.components if cause.part == "ptu" else ("",)) or ("",)
    ]
    sys.stdout.write(
        f"{'cause':32} {'floor':>6} {'effect':>11} {'left':>9} {'share':>8}  seconds  values\n"
    )
    measured_causes = [
        _measure_cause(cause, arguments.program, arguments.soak, arguments.seed) for cause in causes
    ]
    if arguments.json is not None:
        remainders = [line for line in measured_causes if line is not None]
        arguments.json.write_bytes(
            msgspec.json.format(msgspec.json.encode(remainders), indent=1) + b"\n"
        )


def _measure_cause(
    hidden_cause: str, program: str, soak_k: float | None, seed: int
) -> Remainder | None:
    """Fit one cause and print its line; return the energies, None if the fit fails."""
    name, _, size = hidden_cause.partition(":")
    cause, _, place = name.partition("@")
    soak_k = SOAK_K.get(cause) if soak_k is None else soak_k
    start_s = time.monotonic()
    try:
        energies = measure_energies(
            cause, float(size) if size else None, place or None, program, soak_k, seed
        )
    except (ValueError, RuntimeError) as fault:
        sys.stdout.write(f"{hidden_cause:32} {fault}\n")
        return None
    values_text = " ".join(f"{v:.5g}" for v in energies.values)
    share = f"{energies.share:8.3%}" if energies.effect > UNSEEN else "  in base"
    missed_mark = "*" if energies.effect > UNSEEN and energies.share > GOAL else ""
    sys.stdout.write(
        f"{hidden_cause:32} {energies.floor:6.1f} {energies.effect:11.1f} "
        f"{energies.term - energies.floor:9.2f} {share:9}"
        f"{missed_mark:1} {time.monotonic() - start_s:6.1f}  {values_text}\n"
    )
    sys.stdout.flush()
    effect, left = round(energies.effect, 2), round(energies.term - energies.floor, 4)
    return Remainder(cause, place, program, soak_k or 0.0, effect, left)


if __name__ == "__main__":
    main()
