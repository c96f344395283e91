"""What is tested with reference attitudes only: causes of the reference, and smooth functions.

An attitude that a camera gives is often a mean over time: frames last, markers are filtered,
attitudes are interpolated to the gyro's rate. A mean over a time of variance v makes of a body
rate w, to second order, w + v/2 (w'' + w x w'): R(t + s) averaged over s and made a rotation
again is R (1 + v/2 [w']x), and a rotation that is off by d = v/2 w' turns by w + d' + w x d
(derived here; the first is a low-pass, the second is what no low-pass of each axis can be).

What to use when: `attitude_terms` for all causes, `attitude_families` for smooth functions in
addition to `smooth_families`.

Source of the turning axis: the mean rate that a rotation vector gives over a step lacks
w x dw/dt dt^2/12 of the mean of the rate (Bortz 1971, "A new mathematical formulation for
strapdown inertial navigation", IEEE Trans. AES-7, eq. 38 to second order).
"""

from collections.abc import Callable

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.discover.checks.smooth_alternatives import BasisFamily
from gyrorig_solver.estimate.attitude.attitude_projector import MIN_BOARD_RATE_RAD_S
from gyrorig_solver.estimate.attitude.block_segments import AttitudeState
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
from gyrorig_solver.model.term import Scope, size_parameter


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
            typical_size=2.5e-5,  # of 5 ms, half a frame of an ordinary camera
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
        # Of block means: their differences hold less of what is faster than the band.
        slow = state.sample_output(rate)
        bend = np.gradient(np.gradient(slow, axis=0), axis=0) / block_s**2
        signal = -0.5 * (bend + state.sample_output(across)) @ state.gain.T
        return np.asarray(signal[None], dtype=np.float64)

    def reason_not_testable(self, state: SignalState) -> str | None:
        """Explain that a unit's motion is not a mean."""
        return (
            None if isinstance(state, AttitudeState) else "the recording has no reference attitudes"
        )

    def describe(self, values: FloatArray) -> str:
        """Describe the duration."""
        width_s = float(np.sqrt(max(float(values[0]), 0.0)))
        return f"each reference attitude is a mean over {width_s * 1e3:.3g} ms (rms)"


class MovingBias(LinearTerm):
    """A bias of the moving board minus that at rest, per axis: tested like a cause, never named.

    It is compared like a cause, so that no cause is named in its place.
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
        """Return where the board moves on each axis, (3, blocks, 3)."""
        del values
        is_moving = np.linalg.norm(state.rate_rad_s, axis=1) > MIN_BOARD_RATE_RAD_S
        return split_axes(
            state.sample_output(np.repeat(is_moving[:, None].astype(np.float64), 3, axis=1))
        )

    def describe(self, values: FloatArray) -> str:
        """Describe the shifts."""
        shifts = format_list(values / DEG, XYZ, "deg/s")
        return f"the bias in motion differs from the bias at rest: {shifts}"


def attitude_terms() -> dict[str, Term]:
    """Return all causes by id: the catalogue, some in another form, and those of the reference."""
    forms = {cause: term.attitude_form or term for cause, term in catalogue().items()}
    return forms | {term.cause: term for term in (ReferenceSmoothing(), MovingBias())}


def attitude_families() -> list[BasisFamily]:
    """Return the families in addition to those of any reference."""
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
    """Return each axis' second and third derivative: gain and delay by the frequency squared.

    Of block means, whose differences hold less of what is faster than the band.
    """
    step_s = state.step_s * state.instants_per_block
    second = np.gradient(np.gradient(state.sample_output(state.sensor_rate_rad_s), axis=0), axis=0)
    third = np.gradient(second, axis=0)
    return np.concatenate([split_axes(second / step_s**2), split_axes(third / step_s**3)])


def _turning_axis(state: SignalState) -> FloatArray:
    rate = state.rate_rad_s
    across = np.cross(rate, np.gradient(rate, state.step_s, axis=0))
    return split_axes(state.sample_output(np.asarray(across @ state.gain.T, dtype=np.float64)))
