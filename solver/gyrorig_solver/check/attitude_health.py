"""What the reference attitudes of a recording are worth.

What to use when: `examine_attitudes` for the figures, `attitude_lines` for the same as text.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.errors import InputError, sentence
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.data.stream.gain_checks import check_gain
from gyrorig_solver.estimate import judge_conventions, mirrored_gain
from gyrorig_solver.pipeline.references.attitudes import attitude_reference, has_attitudes
from gyrorig_solver.reference import MAX_BRIDGED_S, AttitudeReference


@dataclass(frozen=True, slots=True)
class ReadingHealth:
    """One reading of the quaternions, and how well it agrees with the gyro."""

    reading: str
    residual_rad_s: float
    mount_rad: float  # the rotation between the body frame of the reference and the sensor


@dataclass(frozen=True, slots=True)
class AttitudeHealth:
    """The reference attitudes, their stamps, and the proof of their convention."""

    attitudes: int
    lost: int  # not a quaternion of length 1
    repeated: int  # the attitude before them, although the board turns
    rate_hz: float  # of the frames
    missing: int  # frames without an attitude
    gaps: int  # stretches without attitudes that the fit does not bridge
    step_std_s: float  # of the recorded steps between neighbouring frames
    jitter_s: float
    is_late: bool
    turn_rate_rad_s: tuple[float, float]  # rms, and below it in 99 % of the time
    readings: tuple[ReadingHealth, ...]  # the best one first
    is_decided: bool  # the gyro shows which reading is right, and it is the one as recorded
    motion_rad_s: float
    mirror: str = ""  # which axes of the gyro are mirrored, and what to do


def examine_attitudes(recording: Recording, samples: GyroSamples) -> AttitudeHealth | None:
    """Return the health of the reference attitudes; None without usable ones."""
    if not has_attitudes(recording):
        return None
    try:
        reference = attitude_reference(recording, samples)
    except InputError:
        return None
    stamps = reference.stamps
    if stamps is None:
        return None
    is_neighbour = np.diff(stamps.frame) == 1
    steps_s = np.diff(stamps.stamp_s)[is_neighbour]
    speeds = [np.linalg.norm(part.rate_rad_s, axis=1) for part in reference.rate_segments()]
    speed = np.concatenate(speeds) if speeds else np.zeros(1)
    judgement = judge_conventions(samples, reference)
    is_known = np.all(np.isfinite(reference.orientation_xyzw), axis=1)
    known_s = reference.time_s[is_known]
    return AttitudeHealth(
        attitudes=int(is_known.sum()),
        lost=int(np.sum(~is_known)) - reference.repeated,
        repeated=reference.repeated,
        rate_hz=1.0 / stamps.period_s,
        missing=stamps.missing,
        gaps=int(np.sum(np.diff(known_s) > stamps.period_s + MAX_BRIDGED_S)),
        step_std_s=float(np.std(steps_s)) if steps_s.size else 0.0,
        jitter_s=stamps.jitter_s,
        is_late=stamps.is_late,
        turn_rate_rad_s=(
            float(np.sqrt(np.mean(speed**2))),
            float(np.percentile(speed, 99.0)),
        ),
        readings=()
        if judgement is None
        else tuple(
            ReadingHealth(each.reading, each.residual_rad_s, each.mount_rad)
            for each in judgement.residuals
        ),
        is_decided=judgement is not None and judgement.is_decided,
        motion_rad_s=0.0 if judgement is None else judgement.motion_rad_s,
        mirror=_mirror_text(samples, reference),
    )


def _mirror_text(samples: GyroSamples, reference: AttitudeReference) -> str:
    gain = mirrored_gain(samples, reference)
    if gain is None:
        return ""
    link = samples.link
    return " ".join(
        f"{finding.seen_as}. {sentence(finding.remedy)}"
        for finding in check_gain(gain, link=link)[0].findings
    )


def attitude_lines(health: AttitudeHealth) -> list[str]:
    """Return the figures as lines of text."""
    rms_rad_s, high_rad_s = health.turn_rate_rad_s
    late = "; late by a delay that changes" if health.is_late else ""
    lines = [
        f"{health.attitudes} reference attitudes, {health.rate_hz:.2f} frames per second; "
        f"lost {health.lost}, repeated {health.repeated}, missing frames {health.missing}, "
        f"gaps {health.gaps}",
        f"timestamps: spread of the steps {1e3 * health.step_std_s:.2f} ms, "
        f"jitter {1e3 * health.jitter_s:.2f} ms{late}",
        f"turn rate {np.degrees(rms_rad_s):.1f} deg/s rms, "
        f"99 % below {np.degrees(high_rad_s):.0f} deg/s",
    ]
    if health.readings:
        # The other orders of the components agree with one of these two.
        best = health.readings[0].reading
        shown = ", ".join(
            f"{each.reading} {np.degrees(each.residual_rad_s):.2g} deg/s "
            f"(mount {np.degrees(each.mount_rad):.0f} deg)"
            for each in health.readings
            if each.reading in ("as recorded", "conjugated", best)
        )
        lines.append(
            f"residual of the gyro's {np.degrees(health.motion_rad_s):.3g} deg/s by the reading "
            f"of the quaternions: {shown}"
        )
        if not health.is_decided:
            lines.append("the motion does not prove the convention of the quaternions as recorded")
    return lines
