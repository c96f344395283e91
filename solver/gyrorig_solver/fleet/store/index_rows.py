"""Rows of the index: one for each board of a session, or one for a session that was not solved.

What to use when: `calibration_row` for a calibration in the store; `IndexRow` for a job without
one. A row has what queries about the fleet need, so that they need not open a million
documents. The document remains authoritative.
"""

import hashlib
import json
from collections.abc import Iterable, Iterator, Sequence
from typing import Literal

import msgspec

from gyrorig_solver.calibration import CalibrationDocument
from gyrorig_solver.calibration.calibration_wording import value_std_pairs
from gyrorig_solver.calibration.reference_temperature import bias_temperature_degc
from gyrorig_solver.model import PARAMETER_GROUPS

WorkStatus = Literal["ok", "rejected", "failed", "quarantined"]

MAX_TRACE_CHARS = 8_000
# The newest version of a board is that of its last recording. Version numbers follow the order of
# solving, and a backlog can be solved after later nights.
NEWEST_FIRST_SQL = "start DESC NULLS LAST, version DESC"
# Rows of sessions without a calibration. A new version of the solver, or new settings, solve the
# same recordings in a new job: only the newest job of the same recordings counts.
UNSUCCESSFUL_ROWS_SQL = (
    "(SELECT * FROM (SELECT *, first_value(key) OVER (PARTITION BY list_sort(inputs) "
    "ORDER BY created DESC, status = 'ok' DESC) AS newest_key FROM rows) "
    "WHERE key = newest_key AND status <> 'ok')"
)


class IndexRow(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One board of one session, or a session in which no board is known.

    `parameters` has `bias_x`, `bias_x_std`, ... in the calibration's units; unobservable
    parameters are left out.
    """

    key: str  # of the job: hash of input digests, solver version and settings
    status: WorkStatus
    created: str  # UTC, `2026-01-31T02:30:00Z`
    batch: str
    inputs: list[str]  # SHA-256 of the recordings
    names: list[str]  # file names of the recordings
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
    temperature_degc: float | None = None  # of the bias, or middle of the range
    version: int | None = None
    file: str = ""  # below the store
    file_sha256: str = ""
    beside: list[str] = []  # files next to it: `<sha256>  <name>`
    solver_version: str = ""
    config_sha256: str = ""
    trust: str = ""
    findings: str = ""
    reduced_chi2: float | None = None
    clock_skew_ppm: float | None = None  # of the board's clock against its host's
    gyro_scale_rad_s: float | None = None  # the rate of one count
    seconds: float = 0.0  # processor time of the whole session
    parameters: dict[str, float] = {}


def job_key(digests: Sequence[str], solver_version: str, config_sha256: str) -> str:
    """Return the key of a job: a hash of its recordings, the solver version and its settings."""
    text = json.dumps([sorted(digests), solver_version, config_sha256])
    return hashlib.sha256(text.encode()).hexdigest()


def parameter_columns() -> Iterator[str]:
    """Yield the columns of the parameters: each entry, then its standard deviation."""
    for group in PARAMETER_GROUPS:
        for label in group.labels:
            yield _column(group.name, label)
            yield f"{_column(group.name, label)}_std"


def sql_columns() -> dict[str, str]:
    """Return the columns of the index with their SQL types, in order."""
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
        for field in msgspec.structs.fields(IndexRow)
    }
    del types["parameters"]
    return {**types, **dict.fromkeys(parameter_columns(), "DOUBLE")}


def row_columns(row: IndexRow) -> dict[str, object]:
    """Return a row as columns of the index: each parameter is a column."""
    columns: dict[str, object] = msgspec.to_builtins(row)
    columns.pop("parameters", None)
    return {**columns, **row.parameters}


def json_lines(rows: Iterable[IndexRow]) -> bytes:
    """Return rows as JSON, one per line, as in a journal."""
    return b"".join(msgspec.json.encode(row_columns(row)) + b"\n" for row in rows)


def parameter_values(calibration: CalibrationDocument) -> dict[str, float]:
    """Return the values and standard deviations of a calibration by column."""
    values: dict[str, float] = {}
    for group in PARAMETER_GROUPS:
        parameter = calibration.parameters.get(group.name)
        pairs = value_std_pairs(parameter) if parameter else []
        for label, (value, std) in zip(group.labels, pairs, strict=bool(pairs)):
            if value is not None and std is not None:
                values[_column(group.name, label)] = value
                values[f"{_column(group.name, label)}_std"] = std
    return values


def _column(name: str, label: str) -> str:
    return f"{name}_{label}" if label else name


def calibration_row(
    calibration: CalibrationDocument,
    *,
    key: str,
    batch: str,
    session: str,
    rig: str,
    file: str,
    file_sha256: str,
    companions: Sequence[str] = (),
) -> IndexRow:
    """Return the row of a calibration that is in the store."""
    bias_degc = bias_temperature_degc(calibration)
    return IndexRow(
        key=key,
        status="ok",
        created=calibration.created,
        batch=batch,
        inputs=[recording.sha256 for recording in calibration.inputs],
        names=[recording.name for recording in calibration.inputs],
        session=session,
        rig=rig,
        board=calibration.board.id,
        uid=calibration.board.uid,
        sensor=calibration.board.sensor,
        config_hash=calibration.board.config.config_hash or "",
        start=calibration.inputs[0].start if calibration.inputs else None,
        duration_s=sum(recording.duration_s for recording in calibration.inputs),
        temperature_degc=(
            midpoint(calibration.validity.temperature_degc) if bias_degc is None else bias_degc
        ),
        version=calibration.version,
        file=file,
        file_sha256=file_sha256,
        beside=list(companions),
        solver_version=calibration.solver.version,
        config_sha256=calibration.solver.config_sha256,
        trust=calibration.trust.verdict,
        findings="" if calibration.findings is None else calibration.findings.verdict,
        reduced_chi2=calibration.quality.reduced_chi2,
        clock_skew_ppm=calibration.quality.clock_skew_ppm,
        gyro_scale_rad_s=calibration.board.config.gyro_scale_rad_s,
        parameters=parameter_values(calibration),
    )


def midpoint(limits: list[float] | None) -> float | None:
    """Return the middle of a range, None without one."""
    return None if limits is None else (limits[0] + limits[1]) / 2
