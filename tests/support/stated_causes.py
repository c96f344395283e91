"""What a fit would state of an emulated rig with one cause, as the section `twin` of a rig file.

Names, signs and units follow the files of the causes in the solver's model, and are written here
independently of `Cause.from_findings`. What the base model absorbs of a cause is in the base
parameters.

What to use when: `stated_twin` for the section.
"""

import math
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.injection import InjectedCause
from gyrorig_daemon.emulator.physics.imu import ImuTruth
from gyrorig_daemon.emulator.physics.temperature import BoardTemperature
from gyrorig_protocol.twin import Twin, check_twin

FloatArray = NDArray[np.float64]

XYZ = ("x", "y", "z")
BEGIN_S, END_S = 1.5, 26.0  # of the recording, since power-up
ZERO_S = 1.2  # of its times, since power-up
# Half of the difference between the wire times of a reply and a request of time, 34 and 18 bytes at
# 460 800 baud, and of the floors of the host, 60 and 50 us.
LINK_DELAY_S = 0.5 * (16 * 10.0 / 460_800.0 + 60e-6 - 50e-6)
UNIT_LAG_S = 0.5 * (50e-6 - 60e-6)  # the exchanges with the unit have the same latencies
MIDDLE_S = 0.5 * (BEGIN_S + END_S)


class _Base:
    """The base parameters of the fit, and the parameters of its only cause."""

    def __init__(self, imu: ImuTruth, rig: EmulatedRig) -> None:
        self.imu, self.rig = imu, rig
        self.gain, self.bias = imu.gain.copy(), imu.bias_rad_s.copy()
        lag_s = math.sqrt(2.0) / (2.0 * math.pi * imu.bandwidth_hz)
        self.time_offset_s = imu.tau_s + lag_s + LINK_DELAY_S + UNIT_LAG_S
        self.walk = imu.rate_random_walk
        self.values: dict[str, tuple[float, str]] = {}
        self.temperature = BoardTemperature(
            imu.ambient_degc, imu.self_heating_k, imu.warm_up_s, 0.0
        )
        knots_s = np.arange(0.0, END_S + 1.0, 0.5)
        self.degc = self.temperature.degc(knots_s)
        self.knots_s = knots_s
        self.reference_degc = float(self.temperature.degc(np.linspace(BEGIN_S, END_S, 300)).mean())

    @property
    def lag_s(self) -> float:
        """How long after the motion a sample shows it: findings give times of the motion."""
        return self.imu.tau_s

    @property
    def reference_rise_k(self) -> float:
        return self.reference_degc - self.imu.ambient_degc

    def put(self, name: str, value: float, unit: str = "1") -> None:
        self.values[name] = float(value), unit

    def put_axes(self, name: str, values: FloatArray, unit: str = "1") -> None:
        for axis, value in zip(XYZ, values, strict=True):
            self.put(f"{name}.{axis}", value, unit)


def _tilt_turn(angle_rad: float) -> FloatArray:
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _per_unit_axis(name: str, parameter: str) -> Callable[[InjectedCause, _Base], None]:
    def state(cause: InjectedCause, base: _Base) -> None:
        for axis in cause.components:
            base.put(f"{name}.{axis}", cause.number(parameter))

    return state


def _per_sensor_axis(name: str, parameter: str) -> Callable[[InjectedCause, _Base], None]:
    def state(cause: InjectedCause, base: _Base) -> None:
        base.put_axes(name, cause.array(parameter))

    return state


def _single(name: str, parameter: str) -> Callable[[InjectedCause, _Base], None]:
    def state(cause: InjectedCause, base: _Base) -> None:
        base.put(name, cause.number(parameter))

    return state


def _step_resolution(cause: InjectedCause, base: _Base) -> None:
    error = cause.number("relative_error")
    if cause.component == "pan":  # the gain absorbs it
        base.gain = base.gain @ np.diag([1.0, 1.0 + error, 1.0 + error])
    else:
        base.put("share.tilt", error)


def _backlash(cause: InjectedCause, base: _Base) -> None:
    gap = cause.number("gap")
    for axis in cause.components:
        # At power-up the motor has pushed the wheel down, by its own count.
        direction = -math.copysign(1.0, getattr(base.rig.stage, axis).step_rad)
        base.put(f"gap.{axis}", gap, "rad")
        base.put(f"begin.{axis}", direction)
        if axis == "tilt":  # the wheel is half a gap away from the middle
            base.gain = base.gain @ _tilt_turn(-0.5 * direction * gap)


def _harmonic(amplitude: str, phase: str) -> Callable[[InjectedCause, _Base], None]:
    def state(cause: InjectedCause, base: _Base) -> None:
        size, angle = cause.number(amplitude), cause.number(phase)
        for axis in cause.components:
            base.put(f"cosine.{axis}", size * math.sin(angle), "rad")
            base.put(f"sine.{axis}", size * math.cos(angle), "rad")

    return state


def _worm(cause: InjectedCause, base: _Base) -> None:
    _harmonic("amplitude", "phase")(cause, base)
    base.put("period", 2.0 * math.pi / 17.5, "rad")


def _eccentricity(cause: InjectedCause, base: _Base) -> None:
    _harmonic("first", "first_phase")(cause, base)
    # In complex numbers: first e^(i a) becomes first e^(i a) (1 + w e^(i a)), see the solver.
    c, s = base.values["cosine.pan"][0], base.values["sine.pan"][0]
    second, phase = cause.number("second"), cause.number("second_phase")
    matrix = np.array([[c, -s], [s, c]])
    share = np.linalg.solve(matrix, [second * math.sin(phase), second * math.cos(phase)])
    base.put("oval", share[0])
    base.put("oval_across", share[1])


def _ringing(cause: InjectedCause, base: _Base) -> None:
    _per_unit_axis("share", "share")(cause, base)
    base.put("frequency", cause.number("frequency"), "Hz")
    base.put("damping", cause.number("damping"))


def _lost_steps(cause: InjectedCause, base: _Base) -> None:
    axis = getattr(base.rig.stage, cause.component)
    ((time_s, shift_steps),) = axis._slips
    base.put(f"angle.{cause.component}", -shift_steps * axis.step_rad, "rad")
    base.put("time", time_s - ZERO_S, "s")


def _tilt_zero(cause: InjectedCause, base: _Base) -> None:
    angle = cause.number("angle")
    base.put("angle", angle, "rad")
    base.gain = base.gain @ _tilt_turn(angle).T


def _g_sensitivity(cause: InjectedCause, base: _Base) -> None:
    sensor = np.array([[cause.number(row + column) for column in XYZ] for row in XYZ])
    stage = sensor @ base.imu.mounting
    for k, row in enumerate(XYZ):
        for m, column in enumerate(XYZ):
            base.put(f"sensitivity.{row}{column}", stage[k, m])


def _board_slip(cause: InjectedCause, base: _Base) -> None:
    base.put_axes("turn", -base.imu.mounting.T @ cause.array("turn"), "rad")
    base.put("time", cause.number("at") - base.lag_s - ZERO_S, "s")


def _saturation(cause: InjectedCause, base: _Base) -> None:
    base.put("shortfall", 1.0 - cause.number("limit") / base.imu.gyro_limit_rad_s)


def _dead_zone(cause: InjectedCause, base: _Base) -> None:
    for axis in cause.components:
        base.put(f"threshold.{axis}", cause.number("width"), "rad/s")


def _motor_coupling(cause: InjectedCause, base: _Base) -> None:
    for motor in ("pan", "tilt"):
        base.put_axes(motor, cause.array("bias"), "rad/s")


def _bias_ramp(cause: InjectedCause, base: _Base) -> None:
    slope = cause.array("slope")
    base.put_axes("slope", slope, "rad/s^2")
    base.bias += slope * (MIDDLE_S + base.lag_s)


def _bias_step(cause: InjectedCause, base: _Base) -> None:
    base.put_axes("step", cause.array("step"), "rad/s")
    base.put("time", cause.number("at") - base.lag_s - ZERO_S, "s")


def _warm_up(cause: InjectedCause, base: _Base) -> None:
    constant_s = cause.number("time_constant")
    remaining = math.exp(-(BEGIN_S + base.lag_s) / constant_s)
    base.put_axes("begin", cause.array("at_power_up") * remaining, "rad/s")
    base.put("time_constant", constant_s, "s")


def _thermal_bias(cause: InjectedCause, base: _Base) -> None:
    slope = cause.array("slope")
    base.put_axes("slope", slope, "rad/s/K")
    base.put("lag", -cause.number("lag"), "s")
    base.bias += slope * base.reference_rise_k


def _thermal_scale(cause: InjectedCause, base: _Base) -> None:
    slope = cause.array("share_per_k")
    factor = 1.0 + slope * base.reference_rise_k
    base.put_axes("slope", slope / factor, "1/K")
    base.gain = factor[:, None] * base.gain


def _supply_hum(cause: InjectedCause, base: _Base) -> None:
    frequency = cause.number("frequency")
    phase = cause.number("phase") + 2.0 * math.pi * frequency * (BEGIN_S + base.lag_s)
    base.put_axes("cosine", cause.array("amplitude") * math.sin(phase), "rad/s")
    base.put_axes("sine", cause.array("amplitude") * math.cos(phase), "rad/s")
    base.put("frequency", frequency, "Hz")


def _clock_step(cause: InjectedCause, base: _Base) -> None:
    step = cause.number("step")
    base.put("step", step, "s")
    added_s = max(-step, 0.0)  # the lag before the step
    base.put("time", cause.number("at") - base.lag_s - added_s - ZERO_S, "s")
    base.time_offset_s += added_s


def _clock_skew(cause: InjectedCause, base: _Base) -> None:
    base.put("rate", cause.number("lag_growth"))
    base.time_offset_s += cause.number("lag_at_power_up") + cause.number("lag_growth") * MIDDLE_S


def _clock_sawtooth(cause: InjectedCause, base: _Base) -> None:
    growth, period = cause.number("lag_growth"), cause.number("period")
    base.put("rate", growth)
    base.put("period", period, "s")
    added_s = 0.5 * abs(growth * period)  # the mean
    base.put("time", cause.number("at") - base.lag_s - added_s - ZERO_S, "s")
    base.time_offset_s += added_s


def _clock_offset(cause: InjectedCause, base: _Base) -> None:
    base.put("offset", cause.number("lag"), "s")  # the truth of the board contains it


def _low_pass_lag(cause: InjectedCause, base: _Base) -> None:
    base.put("log_cutoff", math.log1p(cause.number("cutoff_change")))


def _sample_jitter(cause: InjectedCause, base: _Base) -> None:
    base.put("deviation", cause.number("rms"), "s")
    base.time_offset_s += math.sqrt(3.0) * cause.number("rms")


def _random_walk(cause: InjectedCause, base: _Base) -> None:
    base.put_axes("level", cause.array("walk"), "rad/s/sqrt(s)")
    base.walk = np.hypot(base.walk, cause.array("walk"))


def _sign_flip(cause: InjectedCause, base: _Base) -> None:
    _in_output(base, np.diag([-1.0 if axis == cause.component else 1.0 for axis in XYZ]))
    base.put(f"flipped.{cause.component}", 1.0)


def _axis_swap(cause: InjectedCause, base: _Base) -> None:
    order = [0, 1, 2]
    first, second = (XYZ.index(axis) for axis in cause.component)
    order[first], order[second] = second, first
    _in_output(base, np.eye(3)[order])
    names = {"xy": "xy", "xz": "zx", "yz": "yz"}
    base.put(f"exchanged.{names[cause.component]}", 1.0)


def _wrong_full_scale(cause: InjectedCause, base: _Base) -> None:
    ratio = cause.number("full_scale_ratio")
    _in_output(base, np.eye(3) / ratio)
    base.put("doublings", -math.log2(ratio))


def _in_output(base: _Base, matrix: FloatArray) -> None:
    base.gain, base.bias = matrix @ base.gain, matrix @ base.bias


STATEMENTS: dict[str, Callable[[InjectedCause, _Base], None]] = {
    "acceleration_error": _per_unit_axis("share", "relative_error"),
    "axis_nonorthogonality": lambda cause, base: base.put("angle", -cause.number("angle"), "rad"),
    "axis_swap": _axis_swap,
    "backlash": _backlash,
    "base_compliance": _per_unit_axis("coefficient", "compliance"),
    "base_speed_jump": _per_unit_axis("speed", "added"),
    "bias_ramp": _bias_ramp,
    "bias_random_walk": _random_walk,
    "bias_step": _bias_step,
    "board_slip": _board_slip,
    "clock_offset": _clock_offset,
    "clock_sawtooth": _clock_sawtooth,
    "clock_skew": _clock_skew,
    "clock_step": _clock_step,
    "corrupt_samples": _single("share", "share"),
    "dead_zone": _dead_zone,
    "earth_rotation": _single("rate", "rate"),
    "eccentricity": _eccentricity,
    "g_sensitivity": _g_sensitivity,
    "lost_samples": _single("share", "share"),
    "lost_steps": _lost_steps,
    "low_pass_lag": _low_pass_lag,
    "motor_coupling": _motor_coupling,
    "repeated_samples": _single("share", "share"),
    "ringing": _ringing,
    "s_curve": _per_unit_axis("length", "window"),
    "sample_jitter": _sample_jitter,
    "saturation": _saturation,
    "scale_asymmetry": _per_sensor_axis("share", "share"),
    "scale_cubic": _per_sensor_axis("coefficient", "coefficient"),
    "scale_quadratic": _per_sensor_axis("coefficient", "coefficient"),
    "sign_flip": _sign_flip,
    "step_resolution": _step_resolution,
    "supply_hum": _supply_hum,
    "thermal_bias": _thermal_bias,
    "thermal_scale": _thermal_scale,
    "tilt_sag": _harmonic("amplitude", "phase"),
    "tilt_zero": _tilt_zero,
    "vibration_rectification": _per_sensor_axis("coefficient", "coefficient"),
    "warm_up": _warm_up,
    "worm_error": _worm,
    "wrong_full_scale": _wrong_full_scale,
}


def stated_twin(rig: EmulatedRig) -> Twin:
    """Return what a fit would state of a rig with at most one cause, after its motion."""
    ((name, truth),) = rig.truth.boards.items()
    base = _Base(truth.imu, rig)
    for cause in rig.truth.injected:
        STATEMENTS[cause.cause](cause, base)
    configured_hz = rig.settings.boards[0].bandwidth_hz
    plain: dict[str, Any] = {
        "schema": "gyrorig/twin/1",
        "created": "2026-11-24T00:00:00Z",
        "software": "test",
        "recordings": [
            {
                "name": "a.mcap",
                "sha256": "0" * 64,
                "begin_s": BEGIN_S - ZERO_S,
                "end_s": END_S - ZERO_S,
                "first_move_s": 1.0,
            }
        ],
        "boards": {
            name: {
                "gain": _quantity(base.gain),
                "bias": _quantity(base.bias, "rad/s"),
                "time_offset": _quantity(base.time_offset_s, "s"),
                "noise_density": _quantity(truth.imu.noise_density_rad_s_rthz, "rad/s/sqrt(Hz)"),
                "bias_instability": _quantity(truth.imu.bias_instability_rad_s, "rad/s"),
                "rate_random_walk": _quantity(base.walk, "rad/s/sqrt(s)"),
                "odr": _quantity(truth.imu.odr_hz, "Hz"),
                "bandwidth": _quantity(configured_hz, "Hz"),
                "clock": {"skew": _quantity(truth.clock.skew)},
                "temperature": {
                    "time_s": (base.knots_s - ZERO_S).tolist(),
                    "degc": base.degc.tolist(),
                    "reference_degc": base.reference_degc,
                },
            }
        },
        "causes": [
            {
                "cause": cause.cause,
                "where": cause.component.replace(",", ", "),
                "board": cause.board,
                "parameters": {
                    key: {"value": value, "std": None, "unit": unit}
                    for key, (value, unit) in base.values.items()
                },
            }
            for cause in rig.truth.injected
            if base.values
        ],
    }
    twin = msgspec.convert(plain, Twin)
    check_twin(twin, "twin")
    return twin


def _quantity(value: float | FloatArray, unit: str = "1") -> dict[str, Any]:
    plain = value.tolist() if isinstance(value, np.ndarray) else value
    return {"value": plain, "std": None, "unit": unit}
