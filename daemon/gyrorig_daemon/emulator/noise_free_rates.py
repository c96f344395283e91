"""Noise-free rates of an emulated rig, with and without the injected causes.

`simulate_session_rates` returns the rates of a session, and `compare_noise_free` also those without
the injected causes. For both, rigs without noise replay the commands of the axes at the same times,
and only the physics runs. The difference of both rates is the effect of the injected causes alone.
The difference of two recordings is not, because a cause that delays a move also delays every later
command.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.emulator_settings import BoardSettings, RigSettings
from gyrorig_daemon.emulator.physics.imu import ImuModel
from gyrorig_daemon.emulator.physics.stepper_axis import AxisCommand
from gyrorig_daemon.emulator.rig_truth import RigTruth
from gyrorig_protocol.errors import MachineError

FloatArray = NDArray[np.float64]

_DELAY_GRID_S = 0.5e-3  # short compared with the low-pass
_DELAY_TOLERANCE_S = 20e-6  # below this the linear term is exact enough
_MAX_ITERATIONS = 8
_LARGE_BLOCK = 40  # samples; the block size changes no rate, and large blocks save time
_MARGIN_S = 0.1  # after the end, for a block that has begun


@dataclass(frozen=True, slots=True, eq=False)
class SessionRates:
    """Rates of one board, sample by sample, before rounding to counts."""

    number: NDArray[np.int64]  # of the sample since power-up; 16 bits are transmitted, (n,)
    time_s: FloatArray  # of data-ready since power-up, on the host's clock, (n,)
    hidden_rad_s: FloatArray  # with the injected causes, (n, 3)
    between_rad_s: FloatArray | None  # the same, half a sample before `time_s`; None: not computed


@dataclass(frozen=True, slots=True, eq=False)
class NoiseFreeRates(SessionRates):
    """Rates of one board with and without the injected causes."""

    plain_rad_s: FloatArray  # without them, (n, 3)
    aligned_rad_s: FloatArray  # without them, at the delay with the best fit, (n, 3)
    slope_rad_s2: FloatArray  # time derivative of the aligned rates, (n, 3)


def simulate_session_rates(
    rig: EmulatedRig, until_ns: int, with_between: bool = True
) -> dict[str, SessionRates]:
    """Return the rates of each board by name, with the injected causes.

    Corrupted, swapped and lost counts are not included, because they occur after the rate.

    Args:
        rig: after its session.
        until_ns: end, on the rig's clock.
        with_between: compute `between_rad_s` as well.
    """
    return _replay_session(rig, rig.origin_ns, _axis_commands(rig), until_ns, with_between)


def compare_noise_free(
    rig: EmulatedRig, until_ns: int, plain: RigTruth | None = None
) -> dict[str, NoiseFreeRates]:
    """Return the rates of each board by name, with and without the injected causes.

    Args:
        rig: after its session.
        until_ns: end, on the rig's clock.
        plain: the truth without causes; sampled from the seed by default.
    """
    twin = RigTwin(rig.settings, rig.origin_ns, _axis_commands(rig), until_ns, plain)
    return twin.rates(rig, with_between=True)


class RigTwin:
    """Twin of a rig without causes, to compare with many variants of one session.

    The rates of the twin are computed once.
    """

    def __init__(
        self,
        settings: RigSettings,
        origin_ns: int,
        commands: Mapping[str, Sequence[AxisCommand]],
        until_ns: int,
        truth: RigTruth | None = None,
    ) -> None:
        """Replay the commands on the twin.

        Args:
            settings: of the rig; its injections are ignored.
            origin_ns: time of power-up.
            commands: commands of the axes `pan` and `tilt`.
            until_ns: end, on the rig's clock.
            truth: truth without causes; sampled from the seed by default.
        """
        self._settings = replace(settings, noise_free=True, injections=())
        self._origin_ns, self._until_ns, self._commands = origin_ns, until_ns, commands
        self._until_s = (until_ns - origin_ns) * 1e-9
        self._plain = EmulatedRig(self._settings, origin_ns, truth)
        _replay_commands(self._plain, commands)
        self._cached_rates: dict[tuple[str, int], FloatArray] = {}

    def rates(self, rig: EmulatedRig, with_between: bool = False) -> dict[str, NoiseFreeRates]:
        """Return the rates of each board by name, with the causes of a rig of the same seed.

        Args:
            rig: with the causes.
            with_between: compute `between_rad_s` as well.
        """
        session = _replay_session(
            rig, self._origin_ns, self._commands, self._until_ns, with_between
        )
        rates = {}
        for board in rig.settings.boards:
            board_rates = session[board.name]
            aligned, slope = self._aligned(board, board_rates.hidden_rad_s)
            rates[board.name] = NoiseFreeRates(
                board_rates.number,
                board_rates.time_s,
                board_rates.hidden_rad_s,
                board_rates.between_rad_s,
                plain_rad_s=self._delayed_by_steps(board, 0),
                aligned_rad_s=aligned,
                slope_rad_s2=slope,
            )
        return rates

    def _delayed_by_steps(self, board: BoardSettings, delay_steps: int) -> FloatArray:
        """Return the plain rates, delayed by a number of grid steps; computed once."""
        key = (board.name, delay_steps)
        if key not in self._cached_rates:
            self._cached_rates[key] = _simulate_rates(
                self._plain, board, self._until_s, delay_steps * _DELAY_GRID_S
            )[1]
        return self._cached_rates[key]

    def _interpolated(self, board: BoardSettings, delay_s: float) -> tuple[FloatArray, FloatArray]:
        """Return the delayed plain rates and their time derivative.

        Parabolic interpolation over three grid steps, which resolves the low-pass.
        """
        delay_steps = round(delay_s / _DELAY_GRID_S)
        x = delay_s / _DELAY_GRID_S - delay_steps
        earlier, center, later = (
            self._delayed_by_steps(board, delay_steps + k) for k in (-1, 0, 1)
        )
        half_difference, second_difference = 0.5 * (later - earlier), later - 2.0 * center + earlier
        delayed = (
            center if x == 0.0 else center + x * (half_difference + 0.5 * x * second_difference)
        )
        return delayed, -(half_difference + x * second_difference) / _DELAY_GRID_S

    def _aligned(self, board: BoardSettings, injected: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the plain rates at the delay with the best fit, and their derivative.

        Gauss-Newton iteration over the delay, because the rates are not linear in it.
        """
        delay_s = 0.0
        for _ in range(_MAX_ITERATIONS):
            aligned, slope = self._interpolated(board, delay_s)
            power = float((slope**2).sum())
            correction_s = (
                -float((slope * (injected - aligned)).sum()) / power if power > 0.0 else 0.0
            )
            if abs(correction_s) < _DELAY_TOLERANCE_S:
                break
            delay_s += correction_s
        return aligned, slope


def move_starts_s(rig: EmulatedRig) -> list[tuple[str, float]]:
    """Return axis and start of each move of a session, since power-up."""
    axes = (("pan", rig.stage.pan), ("tilt", rig.stage.tilt))
    return [
        (name, command[1])
        for name, axis in axes
        for command in axis.commands
        if command[0] == "move"
    ]


def write_rates(
    path: Path, rates: Mapping[str, SessionRates], moves_s: Sequence[tuple[str, float]]
) -> None:
    """Write rates as an npz file: BOARD.number, BOARD.time_s and so on; pan_s, tilt_s of moves.

    Raises:
        MachineError: the file cannot be written.
    """
    arrays = {
        f"{name}.{key}": getattr(board_rates, key)
        for name, board_rates in rates.items()
        for key in (field.name for field in fields(board_rates))
        if getattr(board_rates, key) is not None
    }
    for axis in ("pan", "tilt"):
        arrays[f"{axis}_s"] = np.array([begin_s for name, begin_s in moves_s if name == axis])
    try:
        with path.open("wb") as file:
            np.savez_compressed(file, **arrays)
    except OSError as error:
        raise MachineError(
            f"the output file {path} of --rates cannot be written ({error.strerror})",
            "choose another file with --rates",
        ) from error


def _axis_commands(rig: EmulatedRig) -> dict[str, Sequence[AxisCommand]]:
    return {"pan": rig.stage.pan.commands, "tilt": rig.stage.tilt.commands}


def _replay_commands(rig: EmulatedRig, commands: Mapping[str, Sequence[AxisCommand]]) -> None:
    for axis, name in ((rig.stage.pan, "pan"), (rig.stage.tilt, "tilt")):
        # The axis has executed the commands of the power-up.
        axis.replay(commands[name][len(axis.commands) :])


def _replay_session(
    rig: EmulatedRig,
    origin_ns: int,
    commands: Mapping[str, Sequence[AxisCommand]],
    until_ns: int,
    with_between: bool,
) -> dict[str, SessionRates]:
    """Return the rates of a rig without noise that replays the commands, by board."""
    settings = replace(rig.settings, noise_free=True)
    silent_rig = EmulatedRig(settings, origin_ns, rig.truth, rig.extra_effects)
    _replay_commands(silent_rig, commands)
    until_s = (until_ns - origin_ns) * 1e-9
    rates = {}
    for board in settings.boards:
        time_s, hidden_rad_s = _simulate_rates(silent_rig, board, until_s)
        between = None
        if with_between:
            half_s = 0.5 / rig.board_truth(board.name).imu.odr_hz
            between = _simulate_rates(silent_rig, board, until_s, half_s)[1]
        rates[board.name] = SessionRates(np.arange(len(time_s)), time_s, hidden_rad_s, between)
    return rates


def _simulate_rates(
    rig: EmulatedRig, board: BoardSettings, until_s: float, delay_s: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Return times and rates of a board from power-up on, with delayed motion."""
    imu = rig.board_truth(board.name).imu
    hooks = rig.fresh_hooks().board(board.name)
    model = ImuModel(
        replace(imu, tau_s=imu.tau_s + delay_s),
        rig.stage,
        0.0,
        np.random.default_rng(0),  # all noise amplitudes are zero
        _LARGE_BLOCK,
        hooks,
    )
    times: list[FloatArray] = []
    rates: list[FloatArray] = []
    end_s = until_s + _MARGIN_S
    while not times or times[-1][-1] < end_s:
        block = model.next_block()
        times.append(block.time_s)
        rates.append(block.rate_rad_s)
    time_s, rate_rad_s = np.concatenate(times), np.vstack(rates)
    count = int(np.searchsorted(time_s, end_s))
    return time_s[:count], rate_rad_s[:count]
