"""Emulated rig: a unit, boards on its stage, and the true parameters of both.

What to use when: `EmulatedRig` from settings, then a `VirtualHub` for simulated time, or
`pty_server.serve_rig` for ptys in real time. `truth_document` is what results are compared with.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from gyrorig_daemon.emulator.board import EmulatedBoard, EmulatedCanBoard
from gyrorig_daemon.emulator.board.emulated_protocol import find_emulated_can_board
from gyrorig_daemon.emulator.emulated_can_bus import EmulatedCanBus
from gyrorig_daemon.emulator.emulated_person import EmulatedPerson
from gyrorig_daemon.emulator.emulator_settings import PtuSettings, RigSettings
from gyrorig_daemon.emulator.injection import apply_causes
from gyrorig_daemon.emulator.physics.device_clock import DeviceClock
from gyrorig_daemon.emulator.physics.effects.rig_hooks import AxisHooks, RigHooks
from gyrorig_daemon.emulator.physics.hand_stage import HandStage
from gyrorig_daemon.emulator.physics.host_latency import HostLatency
from gyrorig_daemon.emulator.physics.motion_law import MotionLaw
from gyrorig_daemon.emulator.physics.stage_motion import Stage
from gyrorig_daemon.emulator.physics.stepper_axis import ARCSEC_RAD, AxisTruth, StepperAxis
from gyrorig_daemon.emulator.rig_truth import BoardTruth, RigTruth, sample_rig_truth
from gyrorig_daemon.emulator.units import find_front_end
from gyrorig_daemon.emulator.units.front_end import EmulatedUnit

PTU_PORT = "ptu"

# Different from the streams that `sample_rig_truth` spawns from the same seed.
_RUNTIME_STREAM = 0x52494731


class EmulatedDevice(Protocol):
    """A device on the far end of a serial line. Times are ns on one monotonic clock.

    It never reads a clock. A pty server drives it in real time, and the virtual hub in simulated
    time. Both see the same bytes at the same device times.
    """

    def receive(self, data: bytes, at_ns: int) -> None:
        """Accept bytes that arrive from `at_ns` on, at the baud rate."""
        ...

    def next_output_ns(self) -> int | None:
        """Return when the next bytes have left the line, None if there are none."""
        ...

    def take_output(self, until_ns: int) -> list[tuple[int, bytes]]:
        """Return the bytes that have left the line up to `until_ns`, in order, with their times."""
        ...


def board_port(name: str) -> str:
    """Return the name of a board's port in a hub."""
    return f"board:{name}"


def bus_port(name: str) -> str:
    """Return the name of a bus's port in a hub."""
    return f"bus:{name}"


class EmulatedRig:
    """Devices by port name with one common stage, powered up together at `origin_ns`."""

    def __init__(
        self,
        settings: RigSettings,
        origin_ns: int,
        truth: RigTruth | None = None,
        extra_effects: Callable[[RigHooks], None] | None = None,
    ) -> None:
        """Build the rig.

        Args:
            settings: unit, boards and seed.
            origin_ns: power-up, on the clock of the hub or server that drives the rig.
            truth: the true parameters; sampled from the seed by default.
            extra_effects: adds further effects to the hooks at power-up.
        """
        self.settings = settings
        self.extra_effects = extra_effects
        self.origin_ns = origin_ns
        self.truth = truth or sample_rig_truth(settings)
        self.hooks = self.fresh_hooks()
        session = () if settings.session_seed is None else (settings.session_seed,)
        root = np.random.default_rng([settings.seed, _RUNTIME_STREAM, *session])
        latency_rng, ptu_rng, counter_rng, *board_rngs = root.spawn(3 + len(settings.boards))
        unit_settings = settings.ptu or PtuSettings()
        make_stage = Stage if settings.hand is None else HandStage
        self.stage = make_stage(
            pan=StepperAxis(
                _axis_truth(
                    unit_settings,
                    unit_settings.pan_sign,
                    self.truth.pan_scale_error,
                    self.hooks.pan,
                ),
                _motion_law(unit_settings),
                float(unit_settings.power_up_pan_steps),
            ),
            tilt=StepperAxis(
                _axis_truth(
                    unit_settings,
                    unit_settings.tilt_sign,
                    self.truth.tilt_scale_error,
                    self.hooks.tilt,
                ),
                _motion_law(unit_settings),
                float(unit_settings.power_up_tilt_steps),
            ),
            tilt_axis_error_rad=self.truth.tilt_axis_error_rad,
            ground_rate_rad_s=self.hooks.ground_rate_rad_s,
        )
        self.person: EmulatedPerson | None = None
        if settings.hand is not None and isinstance(self.stage, HandStage):
            self.person = EmulatedPerson(settings.hand, self.stage, origin_ns, ptu_rng)
        self.ptu: EmulatedUnit | None = None
        if settings.ptu is not None:
            counter = DeviceClock(self.truth.controller_clock, origin_ns, counter_rng)
            make = find_front_end(unit_settings.driver).make
            self.ptu = make(unit_settings, self.stage, counter, origin_ns, ptu_rng)
        self.boards = {
            board.name: (find_emulated_can_board(board.format) if board.bus else EmulatedBoard)(
                board,
                self.board_truth(board.name),
                self.stage,
                origin_ns,
                rng,
                self.hooks.board(board.name),
            )
            for board, rng in zip(settings.boards, board_rngs, strict=True)
        }
        self.buses = {
            bus.name: EmulatedCanBus(
                bus,
                [
                    board
                    for board in self.boards.values()
                    if isinstance(board, EmulatedCanBoard) and board.settings.bus == bus.name
                ],
                origin_ns,
            )
            for bus in settings.buses
        }
        prompt_ports = (PTU_PORT,) if settings.prompt_unit else ()
        bus_ports = tuple(map(bus_port, self.buses))
        self.latency = HostLatency(
            self.truth.latency, origin_ns, latency_rng, prompt_ports, bus_ports
        )

    @property
    def devices(self) -> dict[str, EmulatedDevice]:
        """All devices by port name."""
        unit = self.ptu or self.person
        named: dict[str, EmulatedDevice] = {} if unit is None else {PTU_PORT: unit}
        named.update(
            {
                board_port(name): board
                for name, board in self.boards.items()
                if not board.settings.bus
            }
        )
        named.update({bus_port(name): bus for name, bus in self.buses.items()})
        return named

    def truth_document(
        self, start_ns: int | None = None, end_ns: int | None = None
    ) -> dict[str, Any]:
        """Return the truth as plain values.

        Args:
            start_ns: start of a recording, on the rig's clock.
            end_ns: its end. With both, each board also has `mean_bias_rad_s`: the mean bias over
                that time, with its wander and the effects of injected causes.

        With injected causes, `power_up_raw_ns` is the origin of their times, and `happened`
        contains the time at which steps were lost.
        """
        document = self.truth.to_document()
        if self.truth.injected:
            document["power_up_raw_ns"] = self.origin_ns
            slips = {"pan": self.hooks.pan.slips, "tilt": self.hooks.tilt.slips}
            document["happened"] = {
                f"lost_steps.{axis}{f'.{number}' if number > 1 else ''}": {
                    "value": slip.happened_s,
                    "unit": "s",
                }
                for axis, of_axis in slips.items()
                for number, slip in enumerate(of_axis, start=1)
                if slip.happened_s is not None
            }
        if start_ns is not None and end_ns is not None:
            for name, board in self.boards.items():
                mean = board.mean_bias_rad_s(start_ns, end_ns)
                document["boards"][name]["mean_bias_rad_s"] = mean.tolist()
        return document

    def fresh_hooks(self) -> RigHooks:
        """Return the hooks of the injected causes in their state at power-up."""
        hooks = apply_causes(self.truth.injected, self.truth.seed, self.settings.session_seed)
        if self.extra_effects is not None:
            self.extra_effects(hooks)
        return hooks

    def board_truth(self, name: str) -> BoardTruth:
        """Return a board's truth for the physics, with the settings of noise and soak."""
        truth, settings = self.truth.boards[name], self.settings
        imu = replace(truth.imu, soak_k=settings.soak_k, soak_s=settings.session_s)
        return replace(truth, imu=imu.without_noise() if settings.noise_free else imu)


def _motion_law(unit: PtuSettings) -> MotionLaw:
    return MotionLaw(unit.base_speed_steps_s, unit.speed_steps_s, unit.acceleration_steps_s2)


def _axis_truth(unit: PtuSettings, sign: int, scale_error: float, hooks: AxisHooks) -> AxisTruth:
    step_rad = unit.resolution_arcsec * ARCSEC_RAD
    made_effects = tuple(make(step_rad) for make in hooks.step_effect_makers)
    return AxisTruth(
        resolution_arcsec=unit.resolution_arcsec,
        scale_error=scale_error,
        sign=sign,
        acceleration_error=hooks.acceleration_error,
        base_speed_added_steps_s=hooks.base_speed_added_rad_s / step_rad,
        s_curve_s=hooks.s_curve_s,
        start_delay_s=unit.start_delay_ms * 1e-3,
        slips=tuple(hooks.slips),
        step_effects=(*made_effects, *hooks.step_effects),
        angle_effects=tuple(hooks.angle_effects),
    )
