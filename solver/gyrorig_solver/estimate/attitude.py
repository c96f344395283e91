"""Gain, bias and time offset against a reference attitude: the rate-domain fit.

What to use when: `fit_attitude` for one board in one or more recordings that carry
`/reference/attitude`.

Theory of operation. Over each step of the reference, y(t + tau) = G w(t) + b + noise.
Motion capture differentiated is far noisier than the gyro above a few Hz, and a noisy w
as a regressor pulls G towards zero (least squares on `broad` runs to G = 0). So w is
replaced by the best estimate of the true rate that both sides give together,
w + S_w G' (G S_w G' + S_y)^-1 (y - G w - b), whose error is uncorrelated with the
residual (Deming's regression, by frequency). All of it happens in the DCT domain, where
the residual's density, found in bins, weighs each frequency. Only frequencies up to
`BAND_HZ` count: a gain and a delay are what a sensor is at low frequency; above, its
low-pass and the reference's own smoothing differ (measured on `broad` 07: +1 to +2 % at
5 Hz, +3 to +4 % at 8 Hz, -4 to +6 % at 14 Hz).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.estimate.attitude_blocks import Stretch, match
from gyrorig_solver.estimate.attitude_rounds import AttitudeWork, Linearised
from gyrorig_solver.estimate.conclusion import NAMES, Evidence, gyro_fit
from gyrorig_solver.estimate.observability import decide
from gyrorig_solver.estimate.result import FitDiagnostics, GyroFit
from gyrorig_solver.reference.attitude import LONG_TURN_RAD, AttitudeReference
from gyrorig_solver.samples import GyroSamples

BAND_HZ = 5.0
# A fit on this share of the band must agree within this many of its standard deviations.
LOWER_BAND = 0.2
BAND_SIGMA = 4.0
MOVING_RAD_S = 0.05  # for pictures
HELD_OUT_WINDOW_S = 10.0
_UNSETTLED = (
    "the fit did not settle: look whether gyro and attitudes were recorded at once and share a "
    "clock, and record again"
)
WORDS = {
    "x": "the stage hardly turned about its x axis; turn it about all three",
    "y": "the stage hardly turned about its y axis; turn it about all three",
    "z": "the stage hardly turned about its z axis; turn it about all three",
    "bias": "there are too few samples; record at rest for a minute",
    "time_offset": "the turning never changed; start and stop a few times",
}


@dataclass(frozen=True, slots=True)
class _Bands:
    """Whether a lower band tells the same gain."""

    widening: float  # of the standard deviations, 1 where the bands agree
    distrust: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Settled:
    """Where the rounds ended, before anything is concluded."""

    work: AttitudeWork
    last: Linearised
    bands: _Bands
    band_hz: float  # lower than asked for where the bands disagree
    recording: tuple[int, ...]  # which recording each of the work's stretches is of


def settle(
    recordings: Sequence[tuple[GyroSamples, AttitudeReference]], band_hz: float = BAND_HZ
) -> Settled:
    """Run the rounds of the fit; see `fit_attitude`.

    Raises:
        InputError: gyro and reference hardly overlap.
    """
    matched = [(k, s) for k, one in enumerate(recordings) for s in match(*one)]
    if not matched:
        raise InputError(
            "gyro and reference attitude have no stretch in common",
            "record both for at least a few seconds at once",
        )
    stretches = [s for _, s in matched]
    work = AttitudeWork(stretches, band_hz)
    last = work.run()
    bands = _by_frequency(stretches, work, band_hz)
    if bands.distrust:
        # What a reference was smoothed by, or shares with the gyro, grows with frequency.
        band_hz *= LOWER_BAND
        work = AttitudeWork(stretches, band_hz)
        last = work.run()
    return Settled(work, last, bands, band_hz, tuple(k for k, _ in matched))


def fit_attitude(
    recordings: Sequence[tuple[GyroSamples, AttitudeReference]], band_hz: float = BAND_HZ
) -> GyroFit:
    """Calibrate one board against reference attitudes.

    Args:
        recordings: samples and attitudes on one time axis each.
        band_hz: frequencies above it are not used.

    Returns:
        The fit; G maps body rate (the reference's body frame) to sensor rate.

    Raises:
        InputError: gyro and reference hardly overlap.
    """
    settled = settle(recordings, band_hz)
    return conclude(settled, recordings)


def conclude(
    settled: Settled, recordings: Sequence[tuple[GyroSamples, AttitudeReference]]
) -> GyroFit:
    """Return the fit that the rounds ended at, judged; see `fit_attitude`."""
    work, last, bands, band_hz = settled.work, settled.last, settled.bands, settled.band_hz
    information = last.information()
    inflation = work.score_inflation(last)
    decision = decide(information / (max(1.0, inflation) * bands.widening**2), NAMES)
    before, after = _held_out(work)
    evidence = Evidence(
        estimate=work.estimate,
        decision=decision,
        reduced_chi2=inflation,
        outliers=last.glitches,
        rms_before_rad_s=before,
        rms_after_rad_s=after,
        reference=(
            f"mean body rate between reference attitudes, frequencies up to {band_hz:g} Hz; "
            "G relates to the reference's body frame"
        ),
        words=WORDS,
        terms=("bias", "scale", "nonorthogonality", "misalignment", "time_offset"),
        warnings=_warnings([reference for _, reference in recordings]),
        distrust=(
            *(() if work.converged else (_UNSETTLED,)),
            *bands.distrust,
        ),
        diagnostics=_diagnostics(work),
        extra={"band_hz": band_hz, "reference_angle_noise_rad": _reference_noise_rad(work)},
    )
    return gyro_fit(evidence, [samples for samples, _ in recordings])


def _warnings(references: Sequence[AttitudeReference]) -> tuple[str, ...]:
    largest = max(reference.largest_turn_rad() for reference in references)
    if largest < LONG_TURN_RAD:
        return ()
    return (
        f"up to {np.degrees(largest):.0f} deg between two attitudes: a faster reference would "
        "follow the path between them",
    )


def _by_frequency(stretches: list[Stretch], work: AttitudeWork, band_hz: float) -> _Bands:
    """Compare with a fit on a lower band: if they differ, neither is sure to be the gain.

    A reference that was smoothed, or that shares errors with the gyro, shows here (the
    car's pose: gain.xx 0.4 % at 1 Hz, 4.5 % at 5 Hz, each good to 0.5 % by its own residual).
    """
    lower = AttitudeWork(stretches, LOWER_BAND * band_hz)
    decision = decide(lower.run().information(), NAMES)
    std = np.sqrt(np.diag(decision.covariance)[:9] + np.diag(decision.hidden)[:9])
    change = (lower.estimate - work.estimate)[:9]
    worst = int(np.argmax(np.abs(change) / std))
    off = float(abs(change[worst]) / std[worst])
    if off < BAND_SIGMA:
        return _Bands(1.0, ())
    return _Bands(
        off,
        (
            f"up to {LOWER_BAND * band_hz:g} Hz, which is what stands here, {NAMES[worst]} is "
            f"{1e3 * change[worst]:+.1f}e-3 away from that up to {band_hz:g} Hz, {off:.1f} "
            "standard deviations, and all are widened by that: the reference is smoothed or not "
            "independent of the gyro; use another reference for gains",
        ),
    )


def _reference_noise_rad(work: AttitudeWork) -> float:
    """Return the white angle noise per axis that the reference's steps show at most.

    White angle noise of variance v makes the third difference of the angle, which is the
    second difference of the steps' turns, one of 20 v; motion hardly passes it.
    """
    found = []
    for k, stretch in enumerate(work.stretches):
        turn = work.cleaned(k).residual * stretch.track.step_s
        third = turn[2:] - 2.0 * turn[1:-1] + turn[:-2]
        found.append(float(np.median(np.abs(third))) / 0.6745 / np.sqrt(20.0))
    return float(np.median(found))


def _held_out(work: AttitudeWork) -> tuple[float, float]:
    """Return rms residual on windows not fitted, in the band: nominal, and calibrated.

    Windows of 10 s in turn fit and judge; the lag is known in both, the bias is fitted.
    """
    designs, targets, folds = [], [], []
    for k, stretch in enumerate(work.stretches):
        n = stretch.track.begin_s.size
        clean = work.cleaned(k)
        targets.append(work.band(k, clean.measured))
        designs.append(np.column_stack([work.band(k, clean.rate), np.ones(n)]))
        window = max(1, round(HELD_OUT_WINDOW_S / stretch.track.step_s))
        folds.append(np.arange(n) // window % 2)
    X, y, fold = np.concatenate(designs), np.concatenate(targets), np.concatenate(folds)
    nominal = np.vstack([np.eye(3), np.zeros(3)])
    ridge = np.diag([1e-6, 1e-6, 1e-6, 0.0])
    before, after = [], []
    for part in (0, 1):
        train, test = fold != part, fold == part
        if not train.any() or not test.any():
            return float("nan"), float("nan")
        gram = X[train].T @ X[train] + ridge
        found = np.linalg.solve(gram, X[train].T @ y[train] + ridge @ nominal)
        plain = nominal.copy()
        plain[3] = np.mean(y[train] - X[train, :3], axis=0)
        before.append(y[test] - X[test] @ plain)
        after.append(y[test] - X[test] @ found)
    return (
        float(np.sqrt(np.mean(np.concatenate(before) ** 2))),
        float(np.sqrt(np.mean(np.concatenate(after) ** 2))),
    )


def _diagnostics(work: AttitudeWork) -> FitDiagnostics:
    """Return the band-limited series for pictures; the noise model is the binned density."""
    time_s, measured, reference, residual = [], [], [], []
    for k, stretch in enumerate(work.stretches):
        skip = max(1, int(1.0 / (4.0 * work.band_hz * stretch.track.step_s)))
        time_s.append((0.5 * (stretch.track.begin_s + stretch.track.end_s))[::skip])
        clean = work.cleaned(k)
        measured.append(work.band(k, clean.measured)[::skip])
        reference.append(work.band(k, clean.rate)[::skip])
        residual.append(work.band(k, clean.residual)[::skip])
    rate, left = np.concatenate(reference), np.concatenate(residual)
    spectrum = work.spectrum()
    return FitDiagnostics(
        time_s=np.concatenate(time_s),
        rate_rad_s=np.concatenate(measured),
        reference_rad_s=rate,
        residual_rad_s=left,
        whitened=left / (1.4826 * np.median(np.abs(left), axis=0) + 1e-30),
        moving=np.linalg.norm(rate, axis=1) > MOVING_RAD_S,
        frequency_hz=spectrum.frequency_hz,
        spectrum=spectrum.density,
        spectrum_model=spectrum.density,
    )
