"""Texts of a twin check for a manager: the error before and after, and the gain on new recordings.

What to use when: `manager_text` for the first paragraph; `gain_text` for the gain alone.
"""

import math
from collections.abc import Sequence

import numpy as np

from gyrorig_protocol.twin import Twin
from gyrorig_solver.twin_check.recording_check import StageCheck
from gyrorig_solver.twin_check.twin_folder_check import TwinCheck


def manager_text(check: TwinCheck) -> str:
    """Return the error, its reason, its consequence, and the improvement."""
    chosen = check.held_out or check.boards
    before = _mean([residual_rms(board.before) for board in chosen])
    after = _mean([residual_rms(board.after) for board in chosen])
    noise = _mean([noise_rms(board.after) for board in chosen])
    causes = cause_texts(check.twin)
    reason = (
        f"The twin contains the calibration of the board and the named causes: {', '.join(causes)}."
        if causes
        else "The twin contains the calibration of the board. The fit named no further cause."
    )
    meaning = (
        " Calibration and causes come from one fit. A calibration without these "
        "causes is biased by them."
        if causes
        else ""
    )
    return (
        "Without the bias, the default simulation predicts the measured rates with an error of "
        f"{number_text(before)} deg/s rms. {reason}{meaning} With the twin the error is "
        f"{number_text(after)} deg/s; the noise of the simulated sensor alone gives "
        f"{number_text(noise)} deg/s. {gain_text(check)}"
    )


def gain_text(check: TwinCheck) -> str:
    """Return the gain on recordings that the fit did not use."""
    if not check.held_out:
        return (
            "All recordings of this check were used for the fit, so the check states no gain. "
            "Check a new recording to measure it."
        )
    gains = [board.gain_nats_per_s for board in check.held_out]
    shares = [board.recovered_share for board in check.held_out]
    mean = float(np.mean(gains))
    return (
        f"For data that the fit did not use ({len(gains)} x one board in one recording), the log "
        f"predictive density {'improves' if mean >= 0.0 else 'falls'} by "
        f"{number_text(abs(mean))} nats per second"
        f"{_share_text([share for share in shares if share is not None])}. {_parts_text(check)}"
    )


def _share_text(shares: Sequence[float]) -> str:
    """Return the part of the possible gain that the twin reaches; empty if it is unknown."""
    if not shares:
        return ""
    whole = "the difference between the default simulation and noise alone"
    if len(shares) == 1:
        return f", which is {100.0 * shares[0]:.2f} % of {whole}"
    low, high = 100.0 * min(shares), 100.0 * max(shares)
    return f"; of {whole}, the twin recovers {low:.2f} % to {high:.2f} %"


def _parts_text(check: TwinCheck) -> str:
    """Return the parts of the gain on new recordings from the calibration and from the causes."""
    if not check.twin.causes:
        if _mean([board.gain_nats_per_s for board in check.held_out]) < 0.0:
            return "The twin has no causes, so its calibration does not describe these data."
        return "All of this gain comes from the calibration, because the twin has no causes."
    calibration = _mean([board.calibration_gain_nats_per_s for board in check.held_out])
    causes = _mean([board.cause_gain_nats_per_s for board in check.held_out])
    parts = f"({number_text(calibration)} and {number_text(causes)} nats per second)"
    if min(calibration, causes) < 0.0:
        return f"The calibration and the causes have these parts of the gain {parts}."
    share = 100.0 * calibration / (calibration + causes) if calibration + causes > 0.0 else 0.0
    return (
        f"{share:.2f} % of this gain is due to the calibration and {100.0 - share:.2f} % to the "
        f"causes {parts}. {_cause_share_text(check)}"
    )


def _cause_share_text(check: TwinCheck) -> str:
    """Return the share of the error after calibration alone that the causes recover."""
    known = [board.cause_share for board in check.held_out if board.cause_share is not None]
    if not known:
        return (
            "What the twin without its causes gets wrong is too small in these recordings for a "
            "share that the causes recover."
        )
    share, std = min(known)
    value = f"{100.0 * share:.1f} ± {100.0 * std:.1f} %"
    text = "Of what the twin without its causes gets wrong, the causes recover"
    if share < 1.0:
        return f"{text} {value}."
    return (
        f"{text} {value}. More than 100 % means that the noise of this recording is less than the "
        "mean noise of the twin."
    )


def cause_texts(twin: Twin) -> list[str]:
    """Return the causes of the twin, with their places."""
    return [f"{cause.cause.replace('_', ' ')} ({cause.where})" for cause in twin.causes]


def residual_rms(stage: StageCheck) -> float:
    """Return the rms of measured minus predicted rate, without each axis' mean, deg/s."""
    return float(np.degrees(np.sqrt((stage.residual_rad_s**2).sum(axis=1).mean())))


def noise_rms(stage: StageCheck) -> float:
    """Return the same for a simulated session."""
    return float(np.degrees(np.sqrt((stage.draw_residual_rad_s**2).sum(axis=1).mean())))


def number_text(value: float) -> str:
    """Return a number with three digits, or `unknown`."""
    return "unknown" if not math.isfinite(value) else f"{value:.3g}"


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))
