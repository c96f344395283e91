"""The joint covariance of a twin's values, from the covariances of its boards.

The fits of two boards have only the causes of their unit in common. Given these, their values are
independent: with K the regression of a board's values on the unit's, the covariance of two boards
is K1 U K2', and that of one board S + K U K'. U is the covariance of the unit's values.

The time offset of a board and the start delay of the unit share errors with opposite signs, because
the data show their sum better than each. The largest of these errors is constant: when the unit
reads its count within the time of an exchange. The covariance is without this error, because no
recording shows it. It contains the scatter of the start delays, so that a draw keeps the sum.

What to use when: `join_covariances`; `session_wander_rad_s` for the uncertainty of a bias.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.twin import Posterior, TwinLink, TwinUnit
from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate import BASE_PARAMETERS, ConvergedFit, GyroFit
from gyrorig_solver.model import FACTOR_NAMES, GAIN_NAMES, GainFactors, factor_jacobian
from gyrorig_solver.pipeline import CriticisedFit
from gyrorig_solver.twin.host_latency import median_derivatives
from gyrorig_solver.twin.twin_causes import CollectedCauses
from gyrorig_solver.twin.unit_measurement import MeasuredUnit

MAX_NAMES = 400  # of the posterior in a document
MIN_OFFSET_STD_S = 1e-7
START_DELAY = "unit.start_delay"  # its name in the posterior
LATENCIES = (
    "link.floor", "link.write_floor", "link.jitter", "link.write_jitter", "unit.answer_time"
)  # fmt: skip
DIGITS = 9  # of a number in the document
TIME_OFFSET = BASE_PARAMETERS - 1


@dataclass(frozen=True, slots=True, eq=False)
class NamedCovariance:
    """The covariance of some values of a twin."""

    names: tuple[str, ...]
    matrix: FloatArray  # (k, k)

    def part(self, names: tuple[str, ...], others: tuple[str, ...]) -> FloatArray:
        """Return the covariance of some names with others."""
        index = {name: k for k, name in enumerate(self.names)}
        return self.matrix[np.ix_([index[n] for n in names], [index[n] for n in others])]


def join_covariances(
    fits: Mapping[str, CriticisedFit],
    collected: CollectedCauses,
    unit: MeasuredUnit | None,
    link: TwinLink,
) -> Posterior | None:
    """Return the joint covariance of all boards, None if it is empty or too large."""
    boards = [board_covariance(name, criticised, collected) for name, criticised in fits.items()]
    shared = tuple(
        f"causes.{number}.{parameter}"
        for number, cause in enumerate(collected.causes)
        if cause.board is None
        for parameter in cause.parameters
    )
    joint = _join(boards, shared)
    if joint.names and unit is not None and unit.section.start_delay is not None:
        joint = _with_start_delay(joint, unit.start_scatter_s)
    latencies = latency_covariance(None if unit is None else unit.section, link)
    if joint.names and latencies is not None:
        matrix = _block_diagonal(joint.matrix, latencies.matrix)
        joint = NamedCovariance((*joint.names, *latencies.names), matrix)
    if not joint.names or len(joint.names) > MAX_NAMES:
        return None
    # Equal rounding of both triangles keeps the matrix symmetric.
    rows = tuple(tuple(float(f"{v:.{DIGITS}g}") for v in row) for row in joint.matrix)
    return Posterior(joint.names, rows)


def _with_start_delay(joint: NamedCovariance, scatter_s: float) -> NamedCovariance:
    """Return the covariance with the start delay. All boards are earlier if the unit is later."""
    size = len(joint.names)
    signs = np.zeros(size + 1)
    signs[:size] = [-1.0 if name.endswith(".time_offset") else 0.0 for name in joint.names]
    signs[size] = 1.0
    padded = _block_diagonal(joint.matrix, np.array([[MIN_OFFSET_STD_S**2]]))
    matrix = padded + scatter_s**2 * np.outer(signs, signs)
    return NamedCovariance((*joint.names, START_DELAY), matrix)


def latency_covariance(unit: TwinUnit | None, link: TwinLink) -> NamedCovariance | None:
    """Return the covariance of the latencies of an exchange with the unit, None if unknown.

    Pings show the sum of the latency floors of writing and reading, and the sum of both jitters.
    The replies of the unit show the sum of its answer time and the usual latency of the host. The
    sums are known better than their parts, therefore a draw keeps the sums.
    """
    answer_time = None if unit is None else unit.answer_time
    parts = (link.floor, link.write_floor, link.jitter, link.write_jitter, answer_time)
    known = [part for part in parts if part is not None and part.std is not None]
    if len(known) != len(parts):
        return None
    floor_s, write_floor_s, jitter_s, write_jitter_s, answer_s = (part.std or 0.0 for part in known)
    by_read, by_write = median_derivatives(known[2].value, known[3].value)
    # Independent errors: of the split of the floors, of the jitter of reading, of the sum of both
    # jitters, and of the usual time of a reply.
    sum_s2 = max(write_jitter_s**2 - jitter_s**2, 0.0)
    from_host_s2 = (by_read - by_write) ** 2 * jitter_s**2 + by_write**2 * sum_s2
    variances_s2 = [1.0, jitter_s**2, sum_s2, max(answer_s**2 - from_host_s2, 0.0)]
    errors = np.array(
        [
            [floor_s, 0.0, 0.0, 0.0],
            [-write_floor_s, 0.0, 0.0, 0.0],
            [0.0, 1.0, 0.0, 0.0],
            [0.0, -1.0, 1.0, 0.0],
            [0.0, by_write - by_read, -by_write, 1.0],
        ]
    )
    return NamedCovariance(LATENCIES, errors @ np.diag(variances_s2) @ errors.T)


def board_covariance(
    board: str, criticised: CriticisedFit, collected: CollectedCauses
) -> NamedCovariance:
    """Return the covariance of the values that one board's fit has, by their names in the twin."""
    fit = criticised.fit
    names, jacobian = _twin_names(board, fit, collected.places.get(board, {}))
    covariance = jacobian @ fit.covariance @ jacobian.T
    wander_rad_s = session_wander_rad_s(criticised)
    for k, name in enumerate(names):
        if name.startswith(f"boards.{board}.bias."):
            covariance[k, k] += wander_rad_s[int(name[-1])] ** 2
    offset = f"boards.{board}.time_offset"
    if offset in names and criticised.solution is not None:
        k = names.index(offset)
        variance_s2 = covariance[k, k] - _common_variance_s2(criticised.solution)
        covariance[k, k] = max(variance_s2, MIN_OFFSET_STD_S**2)
    return NamedCovariance(names, (covariance + covariance.T) / 2.0)


def session_wander_rad_s(criticised: CriticisedFit) -> FloatArray:
    """Return the scatter of a session's mean bias around the bias at power-up, shape (3,).

    The fit gives the mean bias of its recording, and the emulated rig starts each session with its
    bias at power-up. The difference from flicker is about its coefficient, and that from a random
    walk is its growth during the recording.
    """
    noise, solution = criticised.fit.noise, criticised.solution
    if noise is None or solution is None:
        return np.zeros(3)
    duration_s = 0.5 / float(solution.spectra[-1].frequency_hz.min())
    return np.hypot(noise.bias_instability, noise.rate_random_walk * math.sqrt(duration_s))


def _twin_names(
    board: str, fit: GyroFit, places: Mapping[str, tuple[int, str]]
) -> tuple[tuple[str, ...], FloatArray]:
    """Return the names of a fit's values in the twin, and their derivatives by the fit's values."""
    position = {name: k for k, name in enumerate(fit.order)}
    names: list[str] = []
    rows: list[FloatArray] = []
    if all(name in position for name in FACTOR_NAMES):
        factors = GainFactors(fit.scale, fit.nonorthogonality, fit.misalignment_rad)
        by_factor = np.linalg.inv(factor_jacobian(factors))
        columns = [position[name] for name in FACTOR_NAMES]
        for k in range(len(GAIN_NAMES)):
            row = np.zeros(len(fit.order))
            row[columns] = by_factor[k]
            names.append(f"boards.{board}.gain.{k // 3}.{k % 3}")
            rows.append(row)
    for name, k in position.items():
        twin_name = None
        group, _, component = name.partition(".")
        if group == "bias" and component in ("x", "y", "z"):
            twin_name = f"boards.{board}.bias.{'xyz'.index(component)}"
        elif name == "time_offset":
            twin_name = f"boards.{board}.time_offset"
        elif name in places:
            number, parameter = places[name]
            twin_name = f"causes.{number}.{parameter}"
        if twin_name is not None:
            names.append(twin_name)
            rows.append(np.eye(len(fit.order))[k])
    return tuple(names), np.array(rows).reshape(len(names), len(fit.order))


def _common_variance_s2(solution: ConvergedFit) -> float:
    """Return the variance that the time offset shares with the start delay."""
    shown = [
        session.common_std_s
        for session, analysis in zip(solution.sessions, solution.session_observability, strict=True)
        if analysis.is_observable(TIME_OFFSET)
    ]
    return shown[-1] ** 2 if shown else 0.0


def _join(boards: list[NamedCovariance], shared: tuple[str, ...]) -> NamedCovariance:
    """Return the covariance of all values, with the shared ones first."""
    unit_names: list[str] = []
    unit = np.zeros((0, 0))
    for board in boards:  # the variance comes from the first board that has a value of the unit
        new = tuple(name for name in shared if name in board.names and name not in unit_names)
        if new:
            unit = _block_diagonal(unit, board.part(new, new))
            unit_names += new
    total, names = unit, list(unit_names)
    regressions = [np.eye(len(unit_names))]
    for board in boards:
        board_names = tuple(name for name in board.names if name not in unit_names)
        common = tuple(name for name in board.names if name in unit_names)
        regression = np.zeros((len(board_names), len(unit_names)))
        conditional = board.part(board_names, board_names)
        if common:
            inner = np.linalg.pinv(board.part(common, common), hermitian=True)
            slope = board.part(board_names, common) @ inner
            conditional = conditional - slope @ board.part(common, board_names)
            regression[:, [unit_names.index(name) for name in common]] = slope
        names += board_names
        regressions.append(regression)
        total = _block_diagonal(total, conditional)
    stacked = np.vstack(regressions)
    joint = stacked @ unit @ stacked.T
    board_block = total.copy()
    board_block[: len(unit_names), : len(unit_names)] = 0.0  # already in `joint`
    return NamedCovariance(tuple(names), np.asarray(joint + board_block))


def _block_diagonal(first: FloatArray, second: FloatArray) -> FloatArray:
    size = first.shape[0] + second.shape[0]
    joined = np.zeros((size, size))
    joined[: first.shape[0], : first.shape[0]] = first
    joined[first.shape[0] :, first.shape[0] :] = second
    return joined
