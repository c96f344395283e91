"""Held-out likelihood of an extended model and of an oracle that knows the truth.

The oracle uses the true gain of the board, and the true hidden effect is subtracted from the
samples. As for every model, bias, time offset and the unknowns of the motion are fitted to the
second recording. All models use one noise model, that of the oracle's residual. The gap between a
model and the oracle is the cost of estimating its values from the first recording: half a nat per
value if both recordings contain the same information.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from tests.hidden.scoring.answers import SECOND_RATES, SECOND_RECORDING, open_answer
from tests.hidden.scoring.figures import Gap

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.samples import GyroSamples, load_samples
from gyrorig_solver.discover import FitExplanation
from gyrorig_solver.estimate import GAIN_PARAMETERS, ConvergedFit
from gyrorig_solver.model.catalogue import catalogue
from gyrorig_solver.pipeline.prepare_board import prepare_held_out

STEP = 7  # every seventh sample is enough to find the start of a recording


def compute_gap(case: Path, explanation: FitExplanation, seal: str) -> dict[str, Any] | None:
    """Open the answer of a case and compare the model of the solver with the oracle.

    Return None if a hidden cause is in one recording only: no model can predict it in another.

    Args:
        case: folder with a second recording.
        explanation: of the first recording; its line is already written.
        seal: of the answer.
    """
    answer = open_answer(case, seal)
    if not all(_is_persistent(name) for name in answer.names):
        return None
    recording = read_recording(case / SECOND_RECORDING)
    samples = load_samples(recording, explanation.board)
    effect = read_effect(samples, case / SECOND_RATES, explanation.board)
    clean = replace(samples, rate_rad_s=samples.rate_rad_s - effect)
    extended = explanation.solution_extended
    second = prepare_held_out(recording, explanation.board, extended, samples)
    known = tuple(
        fitted_term
        for fitted_term in explanation.solution_base.fitted_terms
        if not fitted_term.free_indices.size
    )
    truth = _replace_gain(
        replace(explanation.solution_base, fitted_terms=known), np.array(answer.gain)
    )
    oracle = prepare_held_out(recording, explanation.board, extended, clean).fit_model(truth)
    log_likelihoods = {}
    for name, model in (("base", explanation.solution_base), ("extended", extended)):
        own_fit = second.fit_model(model)
        log_likelihoods[name] = second.fit_model(
            model, replace(own_fit, noise=oracle.noise)
        ).log_likelihood
    values = GAIN_PARAMETERS + sum(
        int(fitted_term.free_indices.size) for fitted_term in extended.fitted_terms
    )
    short = oracle.log_likelihood - log_likelihoods["extended"]
    gap = Gap(answer.seed, oracle.log_likelihood - log_likelihoods["base"], short, values)
    return {"nats": round(gap.nats, 3), "short": round(gap.short, 3), "values": gap.values}


def _is_persistent(cause: str) -> bool:
    term = catalogue().get(cause)
    return term is not None and term.scope != "recording"


def read_effect(samples: GyroSamples, rates: Path, board: str) -> FloatArray:
    """Return the true hidden effect on each sample, (n, 3).

    The truth counts samples from power-up, the recording from its first sample. The best agreement
    of true and recorded rates gives the offset.
    """
    with np.load(rates) as file:
        hidden = np.asarray(file[f"{board}.hidden_rad_s"], dtype=np.float64)
        aligned = np.asarray(file[f"{board}.aligned_rad_s"], dtype=np.float64)
    number = np.asarray(samples.number, dtype=np.int64)
    begin = find_first_number(samples, hidden)
    return np.asarray((hidden - aligned)[number + begin], dtype=np.float64)


def find_first_number(samples: GyroSamples, hidden_rad_s: FloatArray) -> int:
    """Return the index, since power-up, of the first recorded sample.

    Args:
        samples: of a recording.
        hidden_rad_s: its rates without noise since power-up, (m, 3).
    """
    number = np.asarray(samples.number, dtype=np.int64)[::STEP]
    measured_rad_s = samples.rate_rad_s[::STEP]
    shifts = range(len(hidden_rad_s) - int(samples.number.max()))
    misfit = [float(np.sum(np.abs(hidden_rad_s[number + k] - measured_rad_s))) for k in shifts]
    return shifts[int(np.argmin(misfit))]


def _replace_gain(solution: ConvergedFit, gain: FloatArray) -> ConvergedFit:
    return replace(
        solution, estimate=np.concatenate([gain.ravel(), solution.estimate[GAIN_PARAMETERS:]])
    )
