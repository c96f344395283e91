"""The rows of the index: one for each recording's board, and one for what could not be solved.

What to use when: `rows_of` for a calibration that was written; `Row` for what was not. A
row is what is asked about a fleet without opening a million documents; the document is
what counts.
"""

from collections.abc import Iterator, Sequence
from datetime import datetime
from typing import Literal

import msgspec

from gyrorig_solver.calibration.document import Calibration, Parameter

Status = Literal["ok", "rejected", "failed", "quarantined"]

_AXES = ("x", "y", "z")
# the names of an array's entries, as the calibration's covariance has them
ENTRIES: dict[str, tuple[str, ...]] = {
    "bias": _AXES,
    "scale": _AXES,
    "nonorthogonality": ("xy", "zx", "zy"),
    "misalignment": _AXES,
    "time_offset": (),
}
MAX_TEXT = 8_000  # of a trace
# What of a board is newest: what was measured last. Versions count up as they are solved, and
# a backlog is solved after the nights that followed it.
NEWEST_FIRST = "start DESC NULLS LAST, version DESC"


class Row(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One board of one session, or a session without any that could be told.

    `parameters` holds `bias_x`, `bias_x_std`, ... in the calibration's units; what the
    motion could not show is left out.
    """

    key: str  # of the work: digests of the inputs, solver version, settings
    status: Status
    created: str  # UTC, `2026-01-31T02:30:00Z`
    batch: str
    inputs: list[str]  # SHA-256 of the recordings
    names: list[str]  # of the recordings, as they were found
    reason: str = ""
    trace: str = ""  # of a failure
    session: str = ""
    rig: str = ""
    board: str = ""
    uid: str = ""
    sensor: str = ""
    config_hash: str = ""
    start: str | None = None
    duration_s: float | None = None
    temperature_degc: float | None = None  # mean of the thermometer, or middle of the range
    version: int | None = None
    file: str = ""  # below the store
    file_sha256: str = ""
    beside: list[str] = []  # what lies beside it: `<sha256>  <name>`
    solver_version: str = ""
    config_sha256: str = ""
    trust: str = ""
    findings: str = ""
    reduced_chi2: float | None = None
    clock_skew_ppm: float | None = None  # of the board's clock against its host's
    gyro_scale_rad_s: float | None = None  # what a count is worth
    seconds: float = 0.0  # processor time of the whole session's work
    parameters: dict[str, float] = {}


def parameter_columns() -> Iterator[str]:
    """Yield the columns of the parameters: each entry, then its standard deviation."""
    for name, entries in ENTRIES.items():
        for entry in entries or ("",):
            column = f"{name}_{entry}" if entry else name
            yield column
            yield f"{column}_std"


def sql_columns() -> dict[str, str]:
    """Return the index's columns with their SQL types, in order."""
    fixed = {
        "inputs": "VARCHAR[]",
        "names": "VARCHAR[]",
        "beside": "VARCHAR[]",
        "created": "TIMESTAMP",
        "start": "TIMESTAMP",
        "version": "INTEGER",
        "parameters": "",
    }
    types = {
        field.name: fixed.get(field.name, "DOUBLE" if "float" in str(field.type) else "VARCHAR")
        for field in msgspec.structs.fields(Row)
    }
    del types["parameters"]
    return {**types, **dict.fromkeys(parameter_columns(), "DOUBLE")}


def flat(row: Row) -> dict[str, object]:
    """Return a row as the index has it: its parameters as columns of their own."""
    plain: dict[str, object] = msgspec.to_builtins(row)
    plain.pop("parameters", None)
    return {**plain, **row.parameters}


def parameters_of(calibration: Calibration) -> dict[str, float]:
    """Return the values and standard deviations that a calibration gives, by column."""
    found: dict[str, float] = {}
    for name, entries in ENTRIES.items():
        parameter = calibration.parameters.get(name)
        if parameter is None:
            continue
        for column, value, std in _entries(name, entries, parameter):
            if value is not None and std is not None:
                found[column] = value
                found[f"{column}_std"] = std
    return found


def row_of_calibration(
    made: Calibration,
    *,
    key: str,
    batch: str,
    session: str,
    rig: str,
    file: str,
    file_sha256: str,
    beside: Sequence[str] = (),
) -> Row:
    """Return the row of a calibration that is in the store."""
    return Row(
        key=key,
        status="ok",
        created=made.created,
        batch=batch,
        inputs=[one.sha256 for one in made.inputs],
        names=[one.name for one in made.inputs],
        session=session,
        rig=rig,
        board=made.board.id,
        uid=made.board.uid,
        sensor=made.board.sensor,
        config_hash=made.board.config.config_hash or "",
        start=made.inputs[0].start,
        duration_s=sum(one.duration_s for one in made.inputs),
        temperature_degc=(
            middle(made.validity.temperature_degc)
            if made.quality.mean_temperature_degc is None
            else made.quality.mean_temperature_degc
        ),
        version=made.version,
        file=file,
        file_sha256=file_sha256,
        beside=list(beside),
        solver_version=made.solver.version,
        config_sha256=made.solver.config_sha256,
        trust=made.trust.verdict,
        findings="" if made.findings is None else made.findings.verdict,
        reduced_chi2=made.quality.reduced_chi2,
        clock_skew_ppm=made.quality.clock_skew_ppm,
        gyro_scale_rad_s=made.board.config.gyro_scale_rad_s,
        parameters=parameters_of(made),
    )


def _entries(
    name: str, entries: tuple[str, ...], parameter: Parameter
) -> Iterator[tuple[str, float | None, float | None]]:
    value, std = parameter.value, parameter.std
    if isinstance(value, list) and isinstance(std, list):
        columns = [f"{name}_{entry}" for entry in entries]
        yield from zip(columns, value, std, strict=True)
    elif not isinstance(value, list) and not isinstance(std, list):
        yield name, value, std


def middle(span: list[float] | None) -> float | None:
    """Return the middle of a range, None without one."""
    return None if span is None else (span[0] + span[1]) / 2


def utc_now_text(now: datetime) -> str:
    """Return a moment as the index has it."""
    return now.strftime("%Y-%m-%dT%H:%M:%SZ")
