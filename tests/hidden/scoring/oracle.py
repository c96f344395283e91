"""What a second recording says of an extended model, and of an oracle that knows the truth.

The oracle's gain is the board's true one, and the true effect of what is hidden is taken off
the samples; like every model on a second recording it has bias, time offset and the motion's
own unknowns fitted there. All are weighed by one noise, that of the oracle's residual. What a
model is short of it is what its values, estimated on the first recording, cost: half a nat
each, where both recordings tell as much.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from tests.hidden.scoring.answers import HELD, HELD_RATES, opened
from tests.hidden.scoring.figures import Gap

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.discover.result import Explained
from gyrorig_solver.discover.second import Other
from gyrorig_solver.estimate.likelihood import GAINS, Solution
from gyrorig_solver.model.terms.catalogue import catalogue
from gyrorig_solver.samples import GyroSamples, load_samples

EVERY = 7  # a sample in so many tells where a recording begins


def gap_of(case: Path, found: Explained, seal: str) -> dict[str, Any] | None:
    """Open a case's answer and compare its finder's model with the oracle.

    None where something is hidden that belongs to one recording: no model carries it over.

    Args:
        case: folder with a second recording.
        found: what was found in the first; already written down.
        seal: of the answer.
    """
    answer = opened(case, seal)
    if not all(_persists(name) for name in answer.names):
        return None
    recording = read_recording(case / HELD)
    samples = load_samples(recording, found.board)
    effect = effect_on(samples, case / HELD_RATES, found.board)
    clean = replace(samples, rate_rad_s=samples.rate_rad_s - effect)
    extended = found.solution_extended
    other = Other.of(recording, found.board, extended, samples)
    known = tuple(one for one in found.solution_base.extensions if not one.free.size)
    truth = _with_gain(replace(found.solution_base, extensions=known), np.array(answer.gain))
    oracle = Other.of(recording, found.board, extended, clean).judged(truth)
    each = {}
    for name, model in (("base", found.solution_base), ("extended", extended)):
        own = other.judged(model)
        each[name] = other.judged(model, replace(own, noise=oracle.noise)).log_likelihood
    values = GAINS + sum(int(one.free.size) for one in extended.extensions)
    short = oracle.log_likelihood - each["extended"]
    gap = Gap(answer.seed, oracle.log_likelihood - each["base"], short, values)
    return {"nats": round(gap.nats, 3), "short": round(gap.short, 3), "values": gap.values}


def _persists(cause: str) -> bool:
    term = catalogue().get(cause)
    return term is not None and term.scope != "recording"


def effect_on(samples: GyroSamples, rates: Path, board: str) -> FloatArray:
    """Return the true effect of all that is hidden on each sample, (n, 3).

    Samples are counted from power-up in one and from the first one kept in the other; where
    the recording begins is where rates and words agree best.
    """
    with np.load(rates) as file:
        hidden = np.asarray(file[f"{board}.hidden_rad_s"], dtype=np.float64)
        aligned = np.asarray(file[f"{board}.aligned_rad_s"], dtype=np.float64)
    number = np.asarray(samples.number, dtype=np.int64)
    begin = number_of_first(samples, hidden)
    return np.asarray((hidden - aligned)[number + begin], dtype=np.float64)


def number_of_first(samples: GyroSamples, hidden_rad_s: FloatArray) -> int:
    """Return which of a board's rates since power-up the first sample kept is.

    Args:
        samples: of a recording.
        hidden_rad_s: its rates without noise since power-up, (m, 3).
    """
    number = np.asarray(samples.number, dtype=np.int64)[::EVERY]
    words = samples.rate_rad_s[::EVERY]
    shifts = range(len(hidden_rad_s) - int(samples.number.max()))
    misfit = [float(np.sum(np.abs(hidden_rad_s[number + k] - words))) for k in shifts]
    return shifts[int(np.argmin(misfit))]


def _with_gain(solution: Solution, gain: FloatArray) -> Solution:
    return replace(solution, estimate=np.concatenate([gain.ravel(), solution.estimate[GAINS:]]))
