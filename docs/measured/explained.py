"""Tables of the findings of `gyrorig explain` on the measured sets."""

from functools import cache
from pathlib import Path

import numpy as np
from docs.markdown import number, table
from docs.measured.sessions import EXPLAINED, MeasuredSets

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.data import FloatArray
from gyrorig_solver.discover.attitude.attitude_space import fit_attitude_space
from gyrorig_solver.discover.attitude.attitude_terms import MovingBias, ReferenceSmoothing
from gyrorig_solver.estimate import free_term
from gyrorig_solver.findings import CauseEntry, FindingsDocument
from gyrorig_solver.findings.findings_document import GainEntry, parse_findings
from gyrorig_solver.findings.findings_wording import size_text, verdict_words
from gyrorig_solver.model import start_values
from gyrorig_solver.pipeline.board_data import load_board
from gyrorig_solver.pipeline.references.attitudes import load_attitude_recordings

TRIALS = ("02", "05", "07", "24", "03", "33")
MOST_SIZES = 3  # sizes of one cause in the table


def read_findings(measured: MeasuredSets, name: str) -> FindingsDocument:
    """Return the findings that one explain command wrote."""
    (path,) = (measured.folder / EXPLAINED / name).glob("*/findings.yaml")
    return parse_findings(path.read_bytes(), path.name)


def list_names(measured: MeasuredSets) -> list[str]:
    """Return the folders of all explain commands, in the order of the page."""
    return [command.line.rpartition("/")[2] for command in measured.runs[EXPLAINED]]


def causes(measured: MeasuredSets) -> str:
    """Return verdict, causes and unexplained dependence, one row per command."""
    rows = []
    for name in list_names(measured):
        findings = read_findings(measured, name)
        rest = findings.unexplained
        covariates = (
            [] if rest is None else [rest.best_covariate, *(o.covariate for o in rest.others)]
        )
        rows.append(
            [
                name,
                verdict_words(findings)[0].lower(),
                "; ".join(_format_cause(cause) for cause in findings.causes) or "none",
                "; ".join(dict.fromkeys(covariates)) or "nothing",
            ]
        )
    return table(["recordings", "verdict", "causes", "residual depends"], rows)


def gains(measured: MeasuredSets) -> str:
    """Return the gain of the named causes on held-out data."""
    rows = []
    for name in list_names(measured):
        findings = read_findings(measured, name)
        if findings.gain is None:
            continue
        before, after = findings.gain.residual_rms_before, findings.gain.residual_rms_after
        rows.append(
            [
                name,
                _format_nats(findings.gain),
                f"{_format_mdps(before)} → {_format_mdps(after)}",
                "-" if findings.elsewhere is None else _format_source(findings.elsewhere),
                "-" if findings.elsewhere is None else _format_nats(findings.elsewhere),
            ]
        )
    head = [
        "recordings",
        "held-out windows, nats",
        "rms, mdeg/s",
        "other recording",
        "its gain, nats",
    ]
    return table(head, rows)


def smoothing(measured: MeasuredSets) -> str:
    """Return the averaging time of the attitudes of each trial."""
    rows = []
    for name in TRIALS:
        for cause in read_findings(measured, name).causes:
            if cause.cause == ReferenceSmoothing.cause:
                size = cause.parameters["variance"]
                value, std = size.value or 0.0, size.std or 0.0
                width_ms = 1e3 * np.sqrt(value)
                rows.append(
                    [name, f"{number(width_ms, 2)} ± {number(width_ms * std / value / 2.0, 2)}"]
                )
    return table(["trial", "averaging time of attitudes, ms rms"], rows)


def bias_in_motion(measured: MeasuredSets) -> str:
    """Return the bias in motion minus the bias at rest, per trial."""
    rows = []
    for name in TRIALS:
        value, std = estimate_moving_bias(measured, name)
        cells = [
            f"{number(np.degrees(1e3 * v), 0)} ± {number(np.degrees(1e3 * s), 0)}"
            for v, s in zip(value.tolist(), std.tolist(), strict=True)
        ]
        rows.append([name, *cells])
    return table(["trial", *(f"{axis}, mdeg/s" for axis in "xyz")], rows)


@cache
def estimate_moving_bias(measured: MeasuredSets, name: str) -> tuple[FloatArray, FloatArray]:
    """Return the bias in motion minus the bias at rest, and its standard deviation, rad/s."""
    recording = read_recording(measured.folder / f"{name}.mcap")
    data = load_board([recording], recording.board_ids[0])
    space = fit_attitude_space(load_attitude_recordings(data)).base
    smoothed_space = space.with_terms([free_term(ReferenceSmoothing())])
    term = MovingBias()
    statistics = smoothed_space.score_statistics(
        smoothed_space.evaluate_signals(
            lambda scene: term.tangent_signals(scene, start_values(term))
        )
    )
    covariance = np.linalg.inv(statistics.information)
    return covariance @ statistics.score, np.sqrt(np.diag(covariance))


def not_testable(measured: MeasuredSets) -> str:
    """Return the recordings in which the solver can only check raw samples, with the reason."""
    rows = []
    for name in list_names(measured):
        findings = read_findings(measured, name)
        if findings.minimal_detectable:
            continue
        reasons = {entry.reason for entry in findings.not_testable}
        rows += [[name, reason] for reason in sorted(reasons)]
    return table(["recordings", "reason"], rows)


def _format_cause(cause: CauseEntry) -> str:
    sizes = list(cause.parameters.items())
    text = ", ".join(
        f"{name} {size_text(cause.cause, name, size)}" for name, size in sizes[:MOST_SIZES]
    )
    alternatives = "".join(f" or `{alternative}`" for alternative in cause.one_of)
    more = ", ..." if len(sizes) > MOST_SIZES else ""
    place = f" in {Path(cause.recording).stem}" if cause.recording else ""
    return f"`{cause.cause}`{alternatives} ({text}{more}{place})"


def _format_nats(gain: GainEntry) -> str:
    low, high = gain.interval or (None, None)
    value = gain.held_out_log_likelihood
    if value is None or low is None or high is None:
        return "-"
    return f"{value:+.1f} ({low:+.1f} to {high:+.1f})"


def _format_source(gain: GainEntry) -> str:
    return (gain.how or "").removeprefix("the recording ").partition(",")[0].partition(";")[0]


def _format_mdps(value: float | None) -> str:
    return "-" if value is None else number(float(np.degrees(1e3 * value)), 1)
