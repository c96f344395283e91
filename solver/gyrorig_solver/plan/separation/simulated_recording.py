"""Noise-free recording of a program on the rig of a fit, as the rig would make it.

It has the gain, noise, output rate, low-pass, time offset and temperatures of the fit's last
recording, and the unit's resolution, limits and reply times.

What to use when: `recorded_unit` for the unit of a recording, `simulate_recording` for a program.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from gyrorig_protocol.program import MotionProgram
from gyrorig_protocol.ptu import Dialect
from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate import ConvergedFit, Series, SessionFit
from gyrorig_solver.model import BoardTemperature, RecordingContext
from gyrorig_solver.plan.prediction import simulate_reference
from gyrorig_solver.plan.program_timeline import simulate_program
from gyrorig_solver.plan.separation.motion_blocks import MIN_SPEED_DEG_S
from gyrorig_solver.plan.unit_model import ARCSEC_PER_DEG, AxisModel, UnitModel, build_unit_model
from gyrorig_solver.reference import PanTiltReference

SIMULATED_NAME = "next-program"
MAX_STEPS = 1e6  # per second or second squared; larger values are not of a unit
MAX_ANGLE_DEG = 360.0


def recorded_unit(metadata: Mapping[str, str]) -> UnitModel | None:
    """Return the model of a recording's unit; None if the recording lacks the data for it.

    `metadata`: the record `gyrorig.ptu` of the recording.
    """
    try:
        dialect = Dialect(metadata["dialect"])
        model = build_unit_model(dialect, int(metadata["baud"]))
        pan, tilt = (
            _recorded_axis(metadata, name, axis)
            for name, axis in zip(("pan", "tilt"), model.axes, strict=True)
        )
        base_speed, acceleration = (
            float(metadata[f"pan_{name}"]) for name in ("base_speed", "acceleration")
        )
    except (KeyError, ValueError, ZeroDivisionError):
        return None
    if not 0.0 <= base_speed < MAX_STEPS or not 0.0 < acceleration < MAX_STEPS:
        return None
    for axis in (pan, tilt):
        if not -MAX_ANGLE_DEG <= axis.low_deg < axis.high_deg <= MAX_ANGLE_DEG:
            return None
        if axis.fastest_deg_s <= MIN_SPEED_DEG_S:
            return None
    return replace(
        model,
        pan=pan,
        tilt=tilt,
        base_speed_steps_s=base_speed,
        acceleration_steps_s2=acceleration,
    )


def _recorded_axis(metadata: Mapping[str, str], name: str, model: AxisModel) -> AxisModel:
    resolution = float(metadata[f"{name}_resolution_arcsec"])
    if not 0.0 < resolution < np.inf:
        raise ValueError(resolution)
    deg_per_step = resolution / ARCSEC_PER_DEG
    return AxisModel(
        resolution,
        int(metadata[f"{name}_min_steps"]) * deg_per_step,
        int(metadata[f"{name}_max_steps"]) * deg_per_step,
        model.slowest_deg_s,
        min(model.fastest_deg_s, int(metadata[f"{name}_upper_speed"]) * deg_per_step),
    )


def simulate_recording(
    solution: ConvergedFit, program: MotionProgram, unit: UnitModel
) -> ConvergedFit:
    """Return the fit of a program's recording with the values of another fit, without noise.

    Raises:
        UsageError: a step leaves the unit's limits or speeds.
    """
    last = solution.sessions[solution.offset_recording]  # a rest has no noise in motion
    timeline = simulate_program(program, unit)
    reference = simulate_reference(timeline, unit)
    if isinstance(last.reference, PanTiltReference):
        reference = replace(reference, rad_per_step=last.reference.rad_per_step)
    series = _series_like(last.series[-1], timeline.duration_s)
    context = _context_like(last.context, reference, series.time_s, len(solution.sessions))
    session = SessionFit([series], last.sampling, reference, context=context)
    session.bias_rad_s, session.lag_s = last.bias_rad_s.copy(), last.lag_s
    session.fitted_terms = solution.fitted_terms
    session.update_prediction(solution.gain, detect_outliers=False, new_derivatives=True)
    session.take_motion_noise(last)
    return replace(
        solution, sessions=(session,), noises=(solution.noises[solution.offset_recording],)
    )


def _series_like(series: Series, duration_s: float) -> Series:
    count = int(duration_s / series.period_s)
    return replace(
        series,
        time_s=np.asarray((np.arange(count) + 0.5) * series.period_s, dtype=np.float64),
        raw=np.zeros((count, 3)),
        good=np.ones(count, dtype=np.bool_),
    )


def _context_like(
    context: RecordingContext | None,
    reference: PanTiltReference,
    time_s: FloatArray,
    recording_index: int,
) -> RecordingContext:
    before = context or RecordingContext()
    temperature = before.temperature
    if temperature is not None:  # the warm-up of the board repeats
        shifted_s = temperature.time_s - before.begin_s + time_s[0]
        temperature = BoardTemperature(
            shifted_s, temperature.degc, temperature.mean_degc, temperature.gradient_width_s
        )
    return replace(
        before,
        temperature=temperature,
        rad_per_step=reference.rad_per_step,
        motion_profiles=reference.profiles,
        begin_s=float(time_s[0]),
        end_s=float(time_s[-1]),
        recording_name=SIMULATED_NAME,
        recording_index=recording_index,
    )
