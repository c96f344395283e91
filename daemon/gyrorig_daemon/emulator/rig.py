"""The emulated rig: a unit, boards on it, and the truth behind both.

What to use when: `EmulatedRig` from settings, then a `VirtualHub` over it for simulated
time, or `serve` for ptys in real time. `truth_document` is what a judge compares with.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from gyrorig_daemon.emulator.board import EmulatedBoard, EmulatedCanBoard
from gyrorig_daemon.emulator.can_bus import EmulatedCanBus
from gyrorig_daemon.emulator.causes import hang
from gyrorig_daemon.emulator.device import EmulatedDevice
from gyrorig_daemon.emulator.physics.axis import ARCSEC_RAD, AxisTruth, StepperAxis
from gyrorig_daemon.emulator.physics.clock import DeviceClock
from gyrorig_daemon.emulator.physics.effects.hooks import AxisHooks, RigHooks
from gyrorig_daemon.emulator.physics.effects.play import Play
from gyrorig_daemon.emulator.physics.latency import HostLatency
from gyrorig_daemon.emulator.physics.motion_law import MotionLaw
from gyrorig_daemon.emulator.physics.stage import Stage
from gyrorig_daemon.emulator.ptu import EmulatedPtu
from gyrorig_daemon.emulator.settings import PtuSettings, RigSettings
from gyrorig_daemon.emulator.truth import BoardTruth, RigTruth, draw_rig_truth

PTU_PORT = "ptu"

# Apart from the streams that `draw_rig_truth` spawns from the same seed.
_RUN_STREAM = 0x52494731


def board_port(name: str) -> str:
    """Return the name of a board's port in a hub."""
    return f"board:{name}"


def bus_port(name: str) -> str:
    """Return the name of a bus's port in a hub."""
    return f"bus:{name}"


class EmulatedRig:
    """Devices by port name, sharing one stage, powered up together at `origin_ns`."""

    def __init__(
        self,
        settings: RigSettings,
        origin_ns: int,
        truth: RigTruth | None = None,
        more: Callable[[RigHooks], None] | None = None,
    ) -> None:
        """Build the rig.

        Args:
            settings: unit, boards and seed.
            origin_ns: power-up, on the clock of the hub or server that will drive it.
            truth: what to hide; drawn from the seed where it is not given.
            more: hangs what is none of the causes on hooks as they are at power-up.
        """
        self.settings = settings
        self.more = more
        self.origin_ns = origin_ns
        self.truth = truth or draw_rig_truth(settings)
        self.hooks = self.fresh_hooks()
        root = np.random.default_rng([settings.seed, _RUN_STREAM])
        latency_rng, ptu_rng, counter_rng, *board_rngs = root.spawn(3 + len(settings.boards))
        unit = settings.ptu or PtuSettings()
        self.stage = Stage(
            pan=StepperAxis(
                _axis_truth(unit, unit.pan_sign, self.truth.pan_scale_error, self.hooks.pan),
                _law(unit),
                float(unit.power_up_pan_steps),
            ),
            tilt=StepperAxis(
                _axis_truth(unit, unit.tilt_sign, self.truth.tilt_scale_error, self.hooks.tilt),
                _law(unit),
                float(unit.power_up_tilt_steps),
            ),
            tilt_axis_error_rad=self.truth.tilt_axis_error_rad,
            ground_rate_rad_s=self.hooks.ground_rate_rad_s,
        )
        self.ptu: EmulatedPtu | None = None
        if settings.ptu is not None:
            counter = DeviceClock(self.truth.controller_clock, origin_ns, counter_rng)
            self.ptu = EmulatedPtu(unit, self.stage, counter, origin_ns, ptu_rng)
        self.boards = {
            board.name: (EmulatedCanBoard if board.bus else EmulatedBoard)(
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
        self.latency = HostLatency(self.truth.latency, origin_ns, latency_rng)

    @property
    def devices(self) -> dict[str, EmulatedDevice]:
        """Every device by the name of its port."""
        named: dict[str, EmulatedDevice] = {} if self.ptu is None else {PTU_PORT: self.ptu}
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
            start_ns: begin of a recording, on the rig's clock.
            end_ns: its end. With both, each board also has `mean_bias_rad_s`: the bias with
                its wander and whatever hidden cause moves it, as it was on the average of
                that time.

        Where something is hidden, `power_up_raw_ns` is what its times count from, and
        `happened` says when steps were lost.
        """
        document = self.truth.to_document()
        if self.truth.hidden:
            document["power_up_raw_ns"] = self.origin_ns
            slips = {"pan": self.hooks.pan.slip, "tilt": self.hooks.tilt.slip}
            document["happened"] = {
                f"lost_steps.{axis}": {"value": slip.happened_s, "unit": "s"}
                for axis, slip in slips.items()
                if slip is not None and slip.happened_s is not None
            }
        if start_ns is not None and end_ns is not None:
            for name, board in self.boards.items():
                mean = board.mean_bias_rad_s(start_ns, end_ns)
                document["boards"][name]["mean_bias_rad_s"] = mean.tolist()
        return document

    def fresh_hooks(self) -> RigHooks:
        """Return the hidden causes as they are at power-up: nothing has happened yet."""
        hooks = hang(self.truth.hidden, self.truth.seed)
        if self.more is not None:
            self.more(hooks)
        return hooks

    def board_truth(self, name: str) -> BoardTruth:
        """Return a board's truth as the physics takes it: quiet, or in a room that swings."""
        truth, settings = self.truth.boards[name], self.settings
        imu = replace(truth.imu, soak_k=settings.soak_k, soak_s=settings.session_s)
        return replace(truth, imu=imu.without_noise() if settings.noise_free else imu)


def _law(unit: PtuSettings) -> MotionLaw:
    return MotionLaw(unit.base_speed_steps_s, unit.speed_steps_s, unit.acceleration_steps_s2)


def _axis_truth(unit: PtuSettings, sign: int, scale_error: float, hooks: AxisHooks) -> AxisTruth:
    step_rad = unit.resolution_arcsec * ARCSEC_RAD
    gap = (Play(hooks.gap_rad / step_rad),) if hooks.gap_rad > 0.0 else ()
    return AxisTruth(
        resolution_arcsec=unit.resolution_arcsec,
        scale_error=scale_error,
        sign=sign,
        acceleration_error=hooks.acceleration_error,
        base_speed_added_steps_s=hooks.base_speed_added_rad_s / step_rad,
        s_curve_s=hooks.s_curve_s,
        slip=hooks.slip,
        play=(*gap, *hooks.steps),
        effects=tuple(hooks.angles),
    )
