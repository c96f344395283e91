"""The peers on recordings that others measured: motion capture, gravity, turns by hand.

What to use when: `imported` once, then `motion_capture`, `gravity` and `hand_turns`. A peer that
wants a pan-tilt unit is left out. All are judged on data that they have not seen.
"""

from collections.abc import Callable
from itertools import permutations
from pathlib import Path

import numpy as np
from docs.markdown import number, table
from docs.measured import held_out_moves, turn_sets
from docs.measured.attitude_sets import SAME_UNIT, rest_bias
from docs.measured.sessions import COMMANDS, LoadedRecording, MeasuredSets, run_all
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation
from tests.bench.accuracy.profile import FloatArray
from tests.bench.peers.methods import OURS, peers
from tests.bench.peers.recording import Table
from tests.support.rotation_error import window_rotation_error

from gyrorig_solver.estimate import fit_attitude, fit_turns
from gyrorig_solver.reference import TurnReference

SETS = ("broad", "imu-tk-xsens", "imucal-ferraris")
WINDOW_S = 1.0
# Both sides through one low-pass of about 8 Hz: differentiated motion capture is noise above.
SMOOTH_S = 0.02
NOTHING = np.concatenate([np.eye(3).ravel(), np.zeros(4)])


def imported(data: Path, folder: Path) -> MeasuredSets:
    """Import the sets into an empty folder; nothing is solved."""
    lines = {name: tuple(line for line in COMMANDS[name] if " import " in line) for name in SETS}
    return run_all(data, folder, lines)


def motion_capture(measured: MeasuredSets) -> str:
    """Held-out rotation error of every ordered pair of one unit's trials, for each method."""
    loaded = {name: measured.load(name) for unit in SAME_UNIT for name in unit}
    pairs = [pair for unit in SAME_UNIT for pair in permutations(unit, 2)]
    ways: dict[str, Callable[[LoadedRecording], FloatArray]] = {
        "raw gyro": lambda _: NOTHING,
        **{peer.name: _of_table(peer.run) for peer in peers() if peer.any_reference},
        OURS: _ours,
    }
    errors = {}
    for name, way in ways.items():
        gains = {trial: way(trial_data) for trial, trial_data in loaded.items()}
        errors[name] = [_judged(loaded[test], gains[train]) for train, test in pairs]
    rows = []
    for name, found_deg in errors.items():
        ratio = float(np.exp(np.mean(np.log(np.array(found_deg) / np.array(errors[OURS])))))
        rows.append([name, *(number(error_deg, 3) for error_deg in found_deg), number(ratio, 2)])
    ratio_title = f"geometric mean of error / error of {OURS}"
    head = ["rms error, °", *(f"{a} → {b}" for a, b in pairs), ratio_title]
    return table(head, rows)


def gravity(measured: MeasuredSets) -> str:
    """Held-out moves beside imu_tk's own result and its method."""
    return held_out_moves.held_out(measured)


def hand_turns(measured: MeasuredSets) -> str:
    """How far imucal's gain and ours are apart on imucal's own session."""
    loaded = measured.load("ferraris")
    ours = fit_turns([(loaded.samples, TurnReference(loaded.turns, loaded.rests))])
    theirs, _ = turn_sets.imucal_result(measured)
    apart = float(np.abs(ours.gain - theirs).max())
    std = float(ours.gain_std.max())
    return (
        f"The largest difference between the gain entries of our solver and of imucal is "
        f"{apart:.1e}. The largest standard deviation that our solver states for a gain entry is "
        f"{std:.1e}."
    )


def _ours(loaded: LoadedRecording) -> FloatArray:
    if loaded.attitude is None:
        raise ValueError(f"{loaded.samples.board} has no reference attitude")
    fit = fit_attitude([(loaded.samples, loaded.attitude)])
    return np.concatenate([fit.gain.ravel(), fit.bias_rad_s, [fit.time_offset_s]])


def _of_table(run: Callable[[Table], FloatArray]) -> Callable[[LoadedRecording], FloatArray]:
    return lambda loaded: run(_table(loaded))[0]


def _judged(loaded: LoadedRecording, gain: FloatArray) -> float:
    """Rotation error in degrees with gain and offset as found; the bias is the rests' own."""
    if loaded.attitude is None:
        raise ValueError(f"{loaded.samples.board} has no reference attitude")
    rate = (loaded.samples.rate_rad_s - rest_bias(loaded)) @ np.linalg.inv(gain[:9].reshape(3, 3)).T
    time_s = loaded.samples.time_s - np.nan_to_num(gain[12])
    moving = ~loaded.at_rest(loaded.attitude.time_s)
    error = window_rotation_error(time_s, rate, loaded.attitude, WINDOW_S, moving)
    return float(np.degrees(error.rms_rad))


def _table(loaded: LoadedRecording) -> Table:
    """The reference differentiated, interpolated to the samples and smoothed as they are."""
    samples, attitude = loaded.samples, loaded.attitude
    if attitude is None:
        raise ValueError(f"{samples.board} has no reference attitude")
    is_known = np.all(np.isfinite(attitude.orientation_xyzw), axis=1)
    turned = Rotation.from_quat(attitude.orientation_xyzw[is_known])
    at_s = attitude.time_s[is_known]
    step_s = np.diff(at_s)
    rate = (turned[:-1].inv() * turned[1:]).as_rotvec() / step_s[:, None]
    middle_s, time_s = (at_s[1:] + at_s[:-1]) / 2.0, samples.time_s
    stage = np.column_stack([np.interp(time_s, middle_s, rate[:, k]) for k in range(3)])
    width = SMOOTH_S / samples.period_s
    # A gap, with what the filter carries out of it, is not used.
    lost = np.interp(time_s, middle_s, (step_s > 2.0 * np.median(step_s)).astype(np.float64)) > 0.0
    reach = np.ones(2 * int(np.ceil(4.0 * width)) + 1)
    return Table(
        time_s=time_s,
        rate_hz=1.0 / samples.period_s,
        raw_rad_s=samples.rate_rad_s,
        measured_rad_s=gaussian_filter1d(samples.rate_rad_s, width, axis=0),
        stage_rad_s=gaussian_filter1d(stage, width, axis=0),
        static=np.asarray(loaded.at_rest(time_s)),
        use=np.asarray(samples.usable & (np.convolve(lost, reach, "same") < 0.5)),
        pan_rad=np.zeros(time_s.size),
        tilt_rad=np.zeros(time_s.size),
    )
