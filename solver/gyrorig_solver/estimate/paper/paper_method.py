"""The calibration method of the paper, eq. 6 to 12 as printed, and its failures.

What to use when: `calibrate_as_printed` runs the method on arrays and returns a `PaperResult` that
names every step that is impossible or whose result contradicts the paper. `PaperReading` chooses
between readings if the text allows several; the default is the printed one, `READING_OF_TABLE_3`
the one whose result has the form of Table 3. The method is kept for comparison only: use the
rate-domain estimator to calibrate a board. docs/paper.md describes which parameters the method can
determine.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, Literal

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.estimate.paper import paper_angles as angles
from gyrorig_solver.estimate.paper import paper_matrices as matrices

VectorOrder = Literal["printed", "axes"]
"""`printed`: u = (phi, psi, theta) of eq. 6, which by eq. 11 are the angles about (z, x, y).

`axes`: u = angles about (x, y, z), in the order of y; Table 3 comes from this one.
"""

BiasSource = Literal["quasi_static", "static"]

StillThreshold = Literal["pinv", "step"]
"""When a direction of u counts as unexcited in eq. 7.

`pinv`: below Matlab's tolerance, which is rounding. `step`: below one step of the unit.
"""

ONE_STEP_RAD: Final = 185.1428 / 3600.0 * np.pi / 180.0
"""The position step of a PTU-D46-17, 185.1428 seconds of arc (command reference manual 3.00D)."""

ROTATION_TOLERANCE: Final = 1e-9  # far above rounding, far below any printed digit

FAILURES: Final[Mapping[str, str]] = MappingProxyType(
    {
        "no_static_test": "the recording has no rest of two or more samples; record a static phase",
        "eq6_order": "eq. 11 gives the angles about z, x, y, but y of eq. 6 has the "
        "order x, y, z, so M also exchanges the axes; use order 'axes' to "
        "compare with Table 3",
        "u_rank_deficient": "the rank of U is below 3, because the motion does not excite one "
        "direction; eq. 7 then returns the solution of least norm",
        "u_rank_by_rounding": "a direction of u moves by less than one step of the unit, and eq. "
        "7 divides by this motion, so its column of STM is noise; use still "
        "'step' to leave the direction out",
        "reference_not_the_attitude": "eq. 12 gives angles that the unit never had, because it "
        "applies "
        "tilt about a fixed axis although the tilt axis turns with pan",
        "integral_not_the_attitude": "on this path the integrated rates of a perfect gyro differ "
        "from "
        "the angles of the unit; bias and gain absorb the difference",
        "angles_wrap": "an angle of eq. 11 jumps by a whole turn, because the path leaves "
        "the range of that angle",
        "euler_singular": "eq. 11 divides by cos(theta) = 0 on this path",
        "cholesky_impossible": "STM STM^T is not positive definite, so eq. 8 has no result",
        "lu_exchanges_rows": "the LU decomposition with pivoting exchanges rows of ST, so its "
        "factors are not triangular; the result shown is without exchange",
        "lu_order": "the product of the LU factors of ST is T S, not S T as in eq. 1",
        "s_not_diagonal": "the first factor of eq. 9 is unit lower triangular, so S is not "
        "diagonal",
        "m_not_rotation": "M of eq. 10 is not orthogonal, because the factors of eq. 9 do not fit",
        "m_reflection": "M is a reflection: one axis has the wrong sign",
    }
)
"""The meaning of each name in `PaperResult.failures`, with a remedy if there is one."""


@dataclass(frozen=True, slots=True)
class PaperReading:
    """The interpretation of the paper where it is ambiguous; by default as printed."""

    order: VectorOrder = "printed"  # eq. 6
    composition: angles.Composition = "printed"  # eq. 12
    bias: BiasSource = "quasi_static"  # section IV; section V calls it the more accurate one
    slope: angles.SlopeEstimate = "line"  # section IV
    factors: matrices.Factors = "by_shape"  # eq. 9
    still: StillThreshold = "pinv"  # eq. 7


READING_OF_TABLE_3: Final = PaperReading(order="axes", factors="product", still="step")
"""The reading whose result has the form of Table 3: axes in order, S T M = STM, no rounding."""


@dataclass(frozen=True, slots=True, eq=False)
class PaperResult:
    """The result of the paper's method for one recording, and its failures.

    A matrix is None if the method, as printed, has no result.
    """

    reading: PaperReading
    bias_static_rad_s: FloatArray | None  # (3,), None without a static test
    bias_quasi_static_rad_s: FloatArray  # (3,)
    bias_rad_s: FloatArray  # (3,), the one subtracted before eq. 1
    time_s: FloatArray  # (n,), of the quasi-static test
    Y_rad: FloatArray  # (3, n), measured angles
    U_rad: FloatArray  # (3, n), reference angles, in the order of `reading`
    rank: int  # of U, by `reading.still`
    singular_values_rad: FloatArray  # (3,), of U
    unseen: FloatArray  # (3, 3 - rank), directions of u without motion
    STM: FloatArray  # eq. 7, of least norm if U is rank deficient
    ST: FloatArray | None  # eq. 8
    S: FloatArray | None  # eq. 9
    T: FloatArray | None  # eq. 9
    M: FloatArray | None  # eq. 10
    composition_error_rad: FloatArray  # (3,), largest error of eq. 12 in the unit's x, y, z angle
    integral_error_rad: FloatArray  # (3,), the same for the integral of a perfect gyro
    failures: tuple[str, ...]  # keys of FAILURES, in the order of the equations

    @property
    def complete(self) -> bool:
        """True if eq. 6 to 10 gave every matrix; `failures` states whether they are right."""
        return self.M is not None


def calibrate_as_printed(
    time_s: FloatArray,
    rate_rad_s: FloatArray,
    pan_rad: FloatArray,
    tilt_rad: FloatArray,
    static: BoolArray,
    *,
    reading: PaperReading | None = None,
) -> PaperResult:
    """Calibrate by eq. 6 to 12 of the paper.

    Args:
        time_s: increasing, shape (n,).
        rate_rad_s: counts times nominal scale, sensor frame, shape (n, 3).
        pan_rad: angle of the unit at the same times, shape (n,).
        tilt_rad: angle of the unit at the same times, shape (n,).
        static: True in the static test, shape (n,). The quasi-static test consists of all samples
            from the first to the last one outside the static test, including rests between moves.
        reading: of the text; by default as printed.

    Returns:
        The result, with the failures of the method by name; they are not raised.

    Raises:
        ValueError: shapes disagree, times do not increase, there is no sample outside `static`, or
            the static bias is requested without a static test.

    Source: Delgado et al., eq. 6 to 12 and section IV.
    """
    reading = reading or PaperReading()
    moving = _quasi_static_span(time_s, rate_rad_s, pan_rad, tilt_rad, static)
    failures: list[str] = []
    bias_static = _static_bias(time_s, rate_rad_s, static, reading.slope)
    if bias_static is None:
        failures.append("no_static_test")
    time_s, rate_rad_s = time_s[moving], rate_rad_s[moving]
    pan_rad, tilt_rad = pan_rad[moving], tilt_rad[moving]
    raw_rad = angles.integrated_rad(time_s, rate_rad_s)
    bias_quasi_static = angles.line_slope(time_s, raw_rad, reading.slope)
    bias = bias_quasi_static
    if reading.bias == "static":
        if bias_static is None:
            raise ValueError("no static test for the bias: use bias quasi_static")
        bias = bias_static
    U_rad, composition_error, integral_error = _reference_angles(
        pan_rad, tilt_rad, reading, failures
    )
    Y_rad = (raw_rad - bias * (time_s - time_s[0])[:, None]).T
    smallest_rad = ONE_STEP_RAD if reading.still == "step" else 0.0
    fit = matrices.gain_by_pseudoinverse(Y_rad, U_rad, smallest_rad)
    if fit.rank < 3:
        failures.append("u_rank_deficient")
    elif fit.singular_values_rad[-1] < ONE_STEP_RAD * np.sqrt(time_s.size):
        failures.append("u_rank_by_rounding")
    ST, S, T, M = _factorise(fit.gain, reading.factors, failures)
    return PaperResult(
        reading=reading,
        bias_static_rad_s=bias_static,
        bias_quasi_static_rad_s=bias_quasi_static,
        bias_rad_s=bias,
        time_s=time_s,
        Y_rad=Y_rad,
        U_rad=U_rad,
        rank=fit.rank,
        singular_values_rad=fit.singular_values_rad,
        unseen=fit.unseen_directions,
        STM=fit.gain,
        ST=ST,
        S=S,
        T=T,
        M=M,
        composition_error_rad=composition_error,
        integral_error_rad=integral_error,
        failures=tuple(failures),
    )


def _quasi_static_span(
    time_s: FloatArray,
    rate_rad_s: FloatArray,
    pan_rad: FloatArray,
    tilt_rad: FloatArray,
    static: BoolArray,
) -> slice:
    """Return the samples of the quasi-static test; reject inconsistent arrays."""
    count = time_s.size
    shapes = (pan_rad.shape, tilt_rad.shape, static.shape)
    if rate_rad_s.shape != (count, 3) or any(shape != (count,) for shape in shapes):
        raise ValueError("time, rates (n, 3), pan, tilt and static must have the same length")
    if not np.all(np.diff(time_s) > 0.0):
        raise ValueError("times must increase")
    outside = np.flatnonzero(~static)
    if outside.size == 0 or outside[-1] - outside[0] < 2:
        raise ValueError("no quasi-static test: fewer than three samples outside the static one")
    return slice(int(outside[0]), int(outside[-1]) + 1)


def _static_bias(
    time_s: FloatArray, rate_rad_s: FloatArray, static: BoolArray, slope: angles.SlopeEstimate
) -> FloatArray | None:
    """Return the bias of the longest uninterrupted piece of the static test."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], static, [False])).astype(np.int8)))
    if edges.size == 0:
        return None
    starts, stops = edges[0::2], edges[1::2]
    longest = int(np.argmax(stops - starts))
    piece = slice(int(starts[longest]), int(stops[longest]))
    if piece.stop - piece.start < 2:
        return None
    integral = angles.integrated_rad(time_s[piece], rate_rad_s[piece])
    return angles.line_slope(time_s[piece], integral, slope)


def _reference_angles(
    pan_rad: FloatArray, tilt_rad: FloatArray, reading: PaperReading, failures: list[str]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return U of eq. 6, and the errors of eq. 12 and of a perfect gyro's integral."""
    euler_rad = angles.euler_angles_rad(
        angles.composed_attitude(pan_rad, tilt_rad, reading.composition)
    )
    true_rad = angles.mechanism_angles_rad(pan_rad, tilt_rad)
    ideal_rad = angles.ideal_integral_rad(pan_rad, tilt_rad)
    composition_error = np.abs(euler_rad - true_rad).max(axis=0)
    integral_error = np.abs(ideal_rad - true_rad).max(axis=0)
    if reading.order == "printed":
        failures.append("eq6_order")
    if composition_error.max() > ONE_STEP_RAD:
        failures.append("reference_not_the_attitude")
    if integral_error.max() > ONE_STEP_RAD:
        failures.append("integral_not_the_attitude")
    if np.abs(np.diff(euler_rad, axis=0)).max() > np.pi:
        failures.append("angles_wrap")
    if angles.nearest_singularity(euler_rad) < ONE_STEP_RAD:
        failures.append("euler_singular")
    columns = [2, 0, 1] if reading.order == "printed" else [0, 1, 2]
    return euler_rad[:, columns].T, composition_error, integral_error


def _factorise(
    gain: FloatArray, factors: matrices.Factors, failures: list[str]
) -> tuple[FloatArray | None, FloatArray | None, FloatArray | None, FloatArray | None]:
    """Return ST, S, T and M of eq. 8 to 10, each None from the first impossible step on."""
    lower = matrices.lower_factor(gain)
    if lower is None:
        failures.append("cholesky_impossible")
        return None, None, None, None
    if matrices.exchanges_rows(lower):
        failures.append("lu_exchanges_rows")
    S, T = matrices.split_lower(lower, factors)
    if np.abs(S @ T - lower).max() > ROTATION_TOLERANCE * np.abs(lower).max():
        failures.append("lu_order")
    if np.abs(S - np.diag(np.diag(S))).max() > ROTATION_TOLERANCE:
        failures.append("s_not_diagonal")
    M = matrices.misalignment(S, T, gain)
    if matrices.orthogonality_error(M) > ROTATION_TOLERANCE:
        failures.append("m_not_rotation")
    if np.linalg.det(M) < 0.0:
        failures.append("m_reflection")
    return lower, S, T, M
