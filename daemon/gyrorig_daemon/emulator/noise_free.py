"""What the gyros of an emulated rig would show without noise: with what is hidden, and without.

Two twins of a rig obey the orders that its axes were given, at the same times; only the
physics runs. The difference is the effect of the hidden causes alone, which no difference of
two recordings is: a cause that delays a move delays every command after it too.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.physics.axis import Order
from gyrorig_daemon.emulator.physics.imu import ImuModel
from gyrorig_daemon.emulator.rig import EmulatedRig
from gyrorig_daemon.emulator.settings import BoardSettings, RigSettings
from gyrorig_daemon.emulator.truth import RigTruth
from gyrorig_protocol.errors import MachineError

FloatArray = NDArray[np.float64]

_KNOT_S = 0.5e-3  # of delays: short against the low-pass
_NEAR_S = 20e-6  # a delay that the slope alone accounts for
_ROUNDS = 8
_LONG_BLOCK = 40  # samples: their number a block changes no rate, and saves time
_MORE_S = 0.1  # behind the end: a block that had begun


@dataclass(frozen=True, slots=True, eq=False)
class NoiseFreeRates:
    """One board, sample by sample, before rounding to counts."""

    number: NDArray[np.int64]  # of the sample since power-up; 16 bits of it are on the wire, (n,)
    time_s: FloatArray  # of data-ready, since power-up, on the host's clock, (n,)
    hidden_rad_s: FloatArray  # with the hidden causes, (n, 3)
    plain_rad_s: FloatArray  # without them, (n, 3)
    aligned_rad_s: FloatArray  # without them, as late as fits the hidden ones best, (n, 3)
    slope_rad_s2: FloatArray  # how the aligned ones change in time, (n, 3)


def noise_free_rates(rig: EmulatedRig, until_ns: int) -> dict[str, NoiseFreeRates]:
    """Return the rates of each board by name.

    Spoiled, swapped and lost words are not in them: these come after the rate.

    Args:
        rig: after its session.
        until_ns: how far, on the rig's clock.
    """
    orders = {"pan": rig.stage.pan.orders, "tilt": rig.stage.tilt.orders}
    twins = Twins(rig.settings, rig.origin_ns, orders, until_ns)
    return twins.rates(rig)


class Twins:
    """The plain twin of a rig, and what differs from it: many hidden things, one session.

    What the plain one shows is computed once.
    """

    def __init__(
        self,
        settings: RigSettings,
        origin_ns: int,
        orders: Mapping[str, Sequence[Order]],
        until_ns: int,
        truth: RigTruth | None = None,
    ) -> None:
        """Move the plain twin.

        Args:
            settings: of the rig; what they hide is left out.
            origin_ns: its power-up.
            orders: what its axes `pan` and `tilt` were told.
            until_ns: how far, on the rig's clock.
            truth: the plain one; drawn from the seed where it is not given.
        """
        self._settings = replace(settings, noise_free=True, hide=())
        self._origin_ns, self._orders = origin_ns, orders
        self._until_s = (until_ns - origin_ns) * 1e-9
        self._plain = EmulatedRig(self._settings, origin_ns, truth)
        self._obey(self._plain)
        self._known: dict[tuple[str, int], FloatArray] = {}

    def rates(self, like: EmulatedRig) -> dict[str, NoiseFreeRates]:
        """Return the rates of each board by name, hidden as in a rig of the same seed."""
        settings = replace(like.settings, noise_free=True)
        hiding = EmulatedRig(settings, self._origin_ns, like.truth, like.more)
        self._obey(hiding)
        rates = {}
        for board in settings.boards:
            time_s, hidden = _run(hiding, board, self._until_s)
            aligned, slope = self._aligned(board, hidden)
            bare = self._at(board, 0)
            rates[board.name] = NoiseFreeRates(
                np.arange(len(time_s)), time_s, hidden, bare, aligned, slope
            )
        return rates

    def _obey(self, twin: EmulatedRig) -> None:
        for axis, told in (
            (twin.stage.pan, self._orders["pan"]),
            (twin.stage.tilt, self._orders["tilt"]),
        ):
            axis.obey(told[len(axis.orders) :])  # what comes by itself has come already

    def _at(self, board: BoardSettings, knot: int) -> FloatArray:
        """Return the plain rates, later by a number of knots; run once."""
        key = (board.name, knot)
        if key not in self._known:
            self._known[key] = _run(self._plain, board, self._until_s, knot * _KNOT_S)[1]
        return self._known[key]

    def _delayed(self, board: BoardSettings, later_s: float) -> tuple[FloatArray, FloatArray]:
        """Return the plain rates somewhat later, and how they change in time.

        A parabola through three knots: the low-passed rates have nothing finer.
        """
        knot = round(later_s / _KNOT_S)
        x = later_s / _KNOT_S - knot
        before, here, after = (self._at(board, knot + k) for k in (-1, 0, 1))
        rise, bend = 0.5 * (after - before), after - 2.0 * here + before
        late = here if x == 0.0 else here + x * (rise + 0.5 * x * bend)
        return late, -(rise + x * bend) / _KNOT_S

    def _aligned(self, board: BoardSettings, hidden: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the plain rates at the delay that fits the hidden ones best, and their slope.

        A delay is no straight line of the rates; after it is taken off, the rest nearly is.
        """
        delay_s = 0.0
        for _ in range(_ROUNDS):
            aligned, slope = self._delayed(board, delay_s)
            power = float((slope**2).sum())
            more_s = -float((slope * (hidden - aligned)).sum()) / power if power > 0.0 else 0.0
            if abs(more_s) < _NEAR_S:
                break
            delay_s += more_s
        return aligned, slope


def begun_moves_s(rig: EmulatedRig) -> list[tuple[str, float]]:
    """Return axis and begin of each move of a session, since power-up."""
    axes = (("pan", rig.stage.pan), ("tilt", rig.stage.tilt))
    return [(name, told[1]) for name, axis in axes for told in axis.orders if told[0] == "move"]


def write_rates(
    path: Path, rates: Mapping[str, NoiseFreeRates], moves_s: Sequence[tuple[str, float]]
) -> None:
    """Write rates as an npz file: BOARD.number, BOARD.time_s and so on; pan_s, tilt_s of moves.

    Raises:
        MachineError: the file cannot be written.
    """
    arrays = {
        f"{name}.{key}": getattr(told, key)
        for name, told in rates.items()
        for key in (field.name for field in fields(told))
    }
    for axis in ("pan", "tilt"):
        arrays[f"{axis}_s"] = np.array([begin_s for name, begin_s in moves_s if name == axis])
    try:
        with path.open("wb") as file:
            np.savez_compressed(file, **arrays)
    except OSError as fault:
        raise MachineError(
            f"{path} cannot be written: {fault.strerror}", "name another file with --rates"
        ) from fault


def _run(
    rig: EmulatedRig, board: BoardSettings, until_s: float, later_s: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Return times and rates of a board from power-up on, with the motion somewhat later."""
    imu = rig.board_truth(board.name).imu
    hooks = rig.fresh_hooks().board(board.name)
    together = board.batch if board.format == "gcb1" else 1
    model = ImuModel(
        replace(imu, tau_s=imu.tau_s + later_s),
        rig.stage,
        0.0,
        np.random.default_rng(0),  # what it draws is multiplied by nothing
        together if hooks.lags else max(together, _LONG_BLOCK),  # a lag changes by blocks
        hooks,
    )
    times: list[FloatArray] = []
    rates: list[FloatArray] = []
    end_s = until_s + _MORE_S
    while not times or times[-1][-1] < end_s:
        block = model.next_block()
        times.append(block.time_s)
        rates.append(block.rate_rad_s)
    time_s, rate_rad_s = np.concatenate(times), np.vstack(rates)
    kept = int(np.searchsorted(time_s, end_s))
    return time_s[:kept], rate_rad_s[:kept]
