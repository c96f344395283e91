"""What is tested with reference attitudes only: causes of the reference, and smooth functions.

An attitude from a camera is often a mean over time: frames have an exposure time, markers are
filtered, and attitudes are interpolated to the rate of the gyro. If the averaging time has the
variance v, the body rate w becomes w + v/2 (w'' + w x w') to second order. Derivation: the mean of
R(t + s) over s, made a rotation again, is R (1 + v/2 [w']x). A rotation with the error d = v/2 w'
has the rate w + d' + w x d. The term w'' is a low-pass. No low-pass of the single axes has the
effect of w x w'.

What to use when: `attitude_terms` for all causes, `attitude_families` for smooth functions in
addition to `smooth_families`.

Source of the turning axis: the mean rate from the rotation vector of a step lacks the term
w x dw/dt dt^2/12 of the mean of the rate (Bortz 1971, "A new mathematical formulation for strapdown
inertial navigation", IEEE Trans. AES-7, eq. 38 to second order).
"""

from collections.abc import Callable

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.discover.checks.basis_family import BasisFamily
from gyrorig_solver.estimate.attitude.attitude_projector import MIN_BOARD_RATE_RAD_S
from gyrorig_solver.model import (
    DEG,
    XYZ,
    LinearTerm,
    Part,
    SignalState,
    Term,
    TermParameter,
    format_list,
    split_axes,
    start_values,
)
from gyrorig_solver.model.catalogue import catalogue
from gyrorig_solver.model.cause_categories import Scope
from gyrorig_solver.model.term import size_parameter


class ReferenceSmoothing(LinearTerm):
    """The variance of the time over which the reference's attitudes are means."""

    cause = "reference_smoothing"
    title = "The reference attitudes are smoothed"
    equation = "reference rate = omega + variance/2 x (d2 omega/dt2 + omega x d omega/dt)"
    part: Part = "environment"
    scope: Scope = "unit"  # the reference replaces a unit
    parameters = (
        TermParameter(
            name="variance",
            unit="s^2",
            typical_size=2.5e-5,  # square of 5 ms, half a frame of an ordinary camera
            lower=0.0,
            upper=2.5e-3,
            prior_std=1e-3,
        ),
    )
    confused_with = ("low_pass_lag", "clock_offset")
    remedy = (
        "export the attitudes without filtering, at the camera's rate with short exposures, or "
        "record slow turns only"
    )
    covariates = None
    picture = None
    excitation = "fast changes of the rate and of the axis of rotation"
    effect_if_ignored = (
        "the entries of the gain are too large, with an error that grows with the speed of the "
        "turns"
    )

    def basis_signals(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return -1/2 G (w'' + w x w'), (1, blocks, 3)."""
        del values
        rate, block_s = state.rate_rad_s, state.step_s * state.instants_per_block
        across = np.cross(rate, np.gradient(rate, state.step_s, axis=0))
        # Use block means, because their differences contain less of the rates above the band.
        slow = state.sample_output(rate)
        bend = np.gradient(np.gradient(slow, axis=0), axis=0) / block_s**2
        signal = -0.5 * (bend + state.sample_output(across)) @ state.gain.T
        return np.asarray(signal[None], dtype=np.float64)

    def describe(self, values: FloatArray) -> str:
        """Describe the duration."""
        width_s = float(np.sqrt(max(float(values[0]), 0.0)))
        return f"each reference attitude is a mean over {width_s * 1e3:.3g} ms (rms)"


class MovingBias(LinearTerm):
    """The bias of the moving board minus that at rest, per axis; tested like a cause, never named.

    The search compares it like a cause, so that no cause is named in its place.
    """

    cause = "moving_bias"
    part: Part = "sensor"
    parameters = (
        size_parameter("bias", "rad/s", XYZ, typical=0.1, limit=5.0, prior_std=1.0, factor=DEG),
    )
    confused_with = ("scale_asymmetry", "scale_quadratic", "g_sensitivity", "dead_zone")
    nameless_description = "on whether the board moves (the bias changes)"
    title = "The bias depends on motion"
    equation = "y = y + step while the board moves"
    remedy = ""
    covariates = None
    picture = None
    excitation = "rests in several poses between motions of several speeds"
    effect_if_ignored = "the bias in motion differs from the bias at rest"

    def basis_signals(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the share of each block in which the board moves, on each axis, (3, blocks, 3)."""
        del values
        is_moving = np.linalg.norm(state.rate_rad_s, axis=1) > MIN_BOARD_RATE_RAD_S
        return split_axes(
            state.sample_output(np.repeat(is_moving[:, None].astype(np.float64), 3, axis=1))
        )

    def describe(self, values: FloatArray) -> str:
        """Describe the change of the bias."""
        shifts = format_list(values / DEG, XYZ, "deg/s")
        return f"the bias in motion differs from the bias at rest: {shifts}"


def attitude_terms() -> dict[str, Term]:
    """Return all causes by id: the catalogue in its form for attitudes, and two more causes."""
    forms = {cause: term.attitude_form or term for cause, term in catalogue().items()}
    return forms | {term.cause: term for term in (ReferenceSmoothing(), MovingBias())}


def attitude_families() -> list[BasisFamily]:
    """Return the families in addition to those of all references."""
    return [
        _family("moving_bias", MovingBias.nameless_description, _moving_bias, 3),
        _family(
            "frequency", "on how quickly the rates change (effect of a filter)", _derivatives, 6
        ),
        _family("turning_axis", "on how the axis turns between attitudes", _turning_axis, 3),
    ]


def _family(
    covariate: str, description: str, signal: Callable[[SignalState], FloatArray], count: int
) -> BasisFamily:
    return BasisFamily(covariate, description, (signal,), np.ones(count))


def _moving_bias(state: SignalState) -> FloatArray:
    term = MovingBias()
    return term.basis_signals(state, start_values(term))


def _derivatives(state: SignalState) -> FloatArray:
    """Return the second and third derivative of each axis' rate, from block means.

    They are a gain and a delay that change with the square of the frequency. Differences of block
    means contain less of the rates above the band.
    """
    step_s = state.step_s * state.instants_per_block
    second = np.gradient(np.gradient(state.sample_output(state.sensor_rate_rad_s), axis=0), axis=0)
    third = np.gradient(second, axis=0)
    return np.concatenate([split_axes(second / step_s**2), split_axes(third / step_s**3)])


def _turning_axis(state: SignalState) -> FloatArray:
    rate = state.rate_rad_s
    across = np.cross(rate, np.gradient(rate, state.step_s, axis=0))
    return split_axes(state.sample_output(np.asarray(across @ state.gain.T, dtype=np.float64)))
