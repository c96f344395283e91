"""Compare the peers on recordings that others measured: motion capture, gravity, turns by hand.

What to use when: `import_sets` once, then `compare_motion_capture`, `compare_gravity` and
`compare_hand_turns`. The comparison omits peers that need a pan-tilt unit. It tests each method on
data that are not in the fit.
"""

from collections.abc import Callable
from itertools import permutations
from pathlib import Path

import numpy as np
from docs.markdown import number, table
from docs.measured import held_out_moves, turn_sets
from docs.measured.attitude_sets import SAME_UNIT, compute_rest_bias
from docs.measured.sessions import COMMANDS, LoadedRecording, MeasuredSets, run_all
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation
from tests.bench.accuracy.profile import FloatArray
from tests.bench.peers.methods import OURS, list_peers
from tests.bench.peers.recording import Table
from tests.support.rotation_error import window_rotation_error

from gyrorig_solver.estimate import fit_attitude, fit_turns
from gyrorig_solver.reference import TurnReference

SETS = ("broad", "imu-tk-xsens", "imucal-ferraris")
WINDOW_S = 1.0
# One low-pass of about 8 Hz for both sides; above it, differentiated motion capture is noise.
SMOOTH_S = 0.02
UNCALIBRATED = np.concatenate([np.eye(3).ravel(), np.zeros(4)])


def import_sets(data: Path, folder: Path) -> MeasuredSets:
    """Import the sets into an empty folder, without solving them."""
    lines = {name: tuple(line for line in COMMANDS[name] if " import " in line) for name in SETS}
    return run_all(data, folder, lines)


def compare_motion_capture(measured: MeasuredSets) -> str:
    """Return the held-out rotation errors of all ordered pairs of trials of one unit."""
    loaded = {name: measured.load_recording(name) for unit in SAME_UNIT for name in unit}
    pairs = [pair for unit in SAME_UNIT for pair in permutations(unit, 2)]
    methods: dict[str, Callable[[LoadedRecording], FloatArray]] = {
        "raw gyro": lambda _: UNCALIBRATED,
        **{peer.name: _use_table(peer.run) for peer in list_peers() if peer.any_reference},
        OURS: _fit_ours,
    }
    errors = {}
    for name, fit in methods.items():
        gains = {trial: fit(trial_data) for trial, trial_data in loaded.items()}
        errors[name] = [_rotation_error_deg(loaded[test], gains[train]) for train, test in pairs]
    rows = []
    for name, errors_deg in errors.items():
        ratio = float(np.exp(np.mean(np.log(np.array(errors_deg) / np.array(errors[OURS])))))
        rows.append([name, *(number(error_deg, 3) for error_deg in errors_deg), number(ratio, 2)])
    ratio_title = f"geometric mean of error / error of {OURS}"
    head = ["rms error, °", *(f"{a} → {b}" for a, b in pairs), ratio_title]
    return table(head, rows)


def compare_gravity(measured: MeasuredSets) -> str:
    """Return the errors of held-out moves, with the published result and the method of imu_tk."""
    return held_out_moves.move_errors(measured)


def compare_hand_turns(measured: MeasuredSets) -> str:
    """Return the difference between the gains of imucal and of our fit on a session of imucal."""
    loaded = measured.load_recording("ferraris")
    ours = fit_turns([(loaded.samples, TurnReference(loaded.turns, loaded.rests))])
    imucal_gain, _ = turn_sets.compute_imucal_result(measured)
    difference = float(np.abs(ours.gain - imucal_gain).max())
    std = float(ours.gain_std.max())
    return (
        f"The largest difference between the gain entries of our solver and of imucal is "
        f"{difference:.1e}. The largest standard deviation that our solver states for a gain "
        f"entry is {std:.1e}."
    )


def _fit_ours(loaded: LoadedRecording) -> FloatArray:
    if loaded.attitude is None:
        raise ValueError(f"{loaded.samples.board} has no reference attitude")
    fit = fit_attitude([(loaded.samples, loaded.attitude)])
    return np.concatenate([fit.gain.ravel(), fit.bias_rad_s, [fit.time_offset_s]])


def _use_table(run: Callable[[Table], FloatArray]) -> Callable[[LoadedRecording], FloatArray]:
    return lambda loaded: run(_make_table(loaded))[0]


def _rotation_error_deg(loaded: LoadedRecording, gain: FloatArray) -> float:
    """Return the rms rotation error with a gain, a time offset and the bias of the rests."""
    if loaded.attitude is None:
        raise ValueError(f"{loaded.samples.board} has no reference attitude")
    rate = (loaded.samples.rate_rad_s - compute_rest_bias(loaded)) @ np.linalg.inv(
        gain[:9].reshape(3, 3)
    ).T
    time_s = loaded.samples.time_s - np.nan_to_num(gain[12])
    moving = ~loaded.make_rest_mask(loaded.attitude.time_s)
    error = window_rotation_error(time_s, rate, loaded.attitude, WINDOW_S, moving)
    return float(np.degrees(error.rms_rad))


def _make_table(loaded: LoadedRecording) -> Table:
    """Differentiate the reference, interpolate it to the samples, and smooth both sides."""
    samples, attitude = loaded.samples, loaded.attitude
    if attitude is None:
        raise ValueError(f"{samples.board} has no reference attitude")
    is_known = np.all(np.isfinite(attitude.orientation_xyzw), axis=1)
    orientation = Rotation.from_quat(attitude.orientation_xyzw[is_known])
    attitude_s = attitude.time_s[is_known]
    step_s = np.diff(attitude_s)
    rate = (orientation[:-1].inv() * orientation[1:]).as_rotvec() / step_s[:, None]
    middle_s, time_s = (attitude_s[1:] + attitude_s[:-1]) / 2.0, samples.time_s
    stage = np.column_stack([np.interp(time_s, middle_s, rate[:, k]) for k in range(3)])
    width = SMOOTH_S / samples.period_s
    # The mask excludes gaps and their neighbourhood in the filter.
    in_gap = (
        np.interp(time_s, middle_s, (step_s > 2.0 * np.median(step_s)).astype(np.float64)) > 0.0
    )
    neighbourhood = np.ones(2 * int(np.ceil(4.0 * width)) + 1)
    return Table(
        time_s=time_s,
        rate_hz=1.0 / samples.period_s,
        raw_rad_s=samples.rate_rad_s,
        measured_rad_s=gaussian_filter1d(samples.rate_rad_s, width, axis=0),
        stage_rad_s=gaussian_filter1d(stage, width, axis=0),
        static=np.asarray(loaded.make_rest_mask(time_s)),
        use=np.asarray(samples.usable & (np.convolve(in_gap, neighbourhood, "same") < 0.5)),
        pan_rad=np.zeros(time_s.size),
        tilt_rad=np.zeros(time_s.size),
    )
