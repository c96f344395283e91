"""Write a store and a spool of any number of boards, and measure a night without new recordings.

What to use when: `write_fleet_files` writes both, and `measure_growth` measures them.
`bench_fleet.py` uses both functions for its table of growth.
"""

import hashlib
import os
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
from tests.bench.fleet.parts import ERROR, SPREAD
from tests.bench.fleet_machine import measure_cpu_s
from tests.unit.fleet.conftest import row

from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.messages import SESSION_EVENT_TOPIC, EventKind, SessionEvent
from gyrorig_protocol.recording.writer import RecordingWriter
from gyrorig_solver.calibration import create_store
from gyrorig_solver.fleet.drift import PARAMETER_COLUMNS
from gyrorig_solver.fleet.jobs import SolveSettings
from gyrorig_solver.fleet.jobs.batch_run import RECORDING_CACHE_FILE
from gyrorig_solver.fleet.jobs.recording_cache import RecordingCache
from gyrorig_solver.fleet.jobs.spool_scanner import group_into_sessions, read_recordings, scan_spool
from gyrorig_solver.fleet.store import IndexRow, StoreIndex, job_key, verify
from gyrorig_solver.fleet.store.coordination import RowJournal
from gyrorig_solver.fleet.store.manifest import write_manifests
from gyrorig_solver.fleet.store.store_queries import VersionFilter, newest_versions
from gyrorig_solver.storage import Folder


def write_fleet_files(folder: Path, boards: int, document: str, report: bytes) -> tuple[Path, Path]:
    """Write a spool and a store of several boards, each with one solved recording."""
    spool, store = folder / "spool", folder / "store"
    spool.mkdir(parents=True)
    calibrations = create_store(store)
    recording = make_recording_head(folder)
    page = folder / "report.html"
    page.write_bytes(report)
    settings, rng = SolveSettings(solver_version="0.1.0"), np.random.default_rng(1)
    with RowJournal(Folder(store), "night") as journal:
        rows: list[IndexRow] = []
        for number in range(boards):
            data = recording.replace(b"n000000", b"n%06d" % number)
            path = spool / f"{number:06d}.mcap"
            path.write_bytes(data)
            digest = hashlib.sha256(data).hexdigest()
            board = BoardId(f"B{number:06d}")
            text = document.replace("B000000", board).encode()
            home = calibrations.folder_of(board)
            home.mkdir(parents=True)
            (home / "v0001.yaml").write_bytes(text)
            os.link(page, home / "v0001.report.html")  # hard links need no space
            rows.append(
                row(
                    job_key([digest], settings.solver_version, settings.config_sha256),
                    board=str(board),
                    inputs=[digest],
                    file=str((home / "v0001.yaml").relative_to(store)),
                    file_sha256=hashlib.sha256(text).hexdigest(),
                    beside=[f"{hashlib.sha256(report).hexdigest()}  v0001.report.html"],
                    **draw_row_values(number, rng),
                )
            )
        journal.add(rows)
    StoreIndex(store).merge_ended_batches()
    write_manifests(Folder(store), None)
    return spool, store


def draw_row_values(number: int, rng: np.random.Generator) -> dict[str, object]:
    """Return random values for a row of the index, different for each board."""
    families = [(name, name.split("_", maxsplit=1)[0]) for name in PARAMETER_COLUMNS]
    values = {
        name: float(rng.normal(1.0 if family == "scale" else 0.0, SPREAD[family]))
        for name, family in families
    }
    values |= {
        f"{name}_std": ERROR[family] * float(rng.uniform(0.7, 1.5)) for name, family in families
    }
    start = datetime(2026, 1, 1, 2, tzinfo=UTC) + timedelta(seconds=200.0 * number)
    return {
        "parameters": values,
        "session": f"n{number:06d}",
        "rig": f"rig-{number % 64}",
        "uid": f"{rng.integers(1 << 62):024x}",
        "sensor": "L3G4200D",
        "start": f"{start:%Y-%m-%dT%H:%M:%SZ}",
        "clock_skew_ppm": float(rng.normal(0.0, 20.0)),
        "gyro_scale_rad_s": 1.2217e-3,
        "duration_s": 75.0 + float(rng.normal(0.0, 0.01)),
        "temperature_degc": float(rng.normal(25.0, 2.0)),
        "solver_version": "0.1.0",
        "config_sha256": SolveSettings(solver_version="0.1.0").config_sha256,
        "trust": "good",
        "reduced_chi2": float(rng.normal(1.0, 0.02)),
        "seconds": float(rng.normal(0.43, 0.02)),
    }


def make_recording_head(folder: Path) -> bytes:
    """Return the bytes of a recording that contains only a head and a note."""
    path = folder / "head.mcap"
    metadata = {"session": "n000000", "rig": "r", "part": "0"}
    metadata |= {"anchor_utc_ns": "1", "anchor_monotonic_raw_ns": "1"}
    with RecordingWriter(path, {"gyrorig": metadata}) as writer:
        writer.write(SESSION_EVENT_TOPIC, SessionEvent(1, int(EventKind.NOTE), "", "note"))
    return path.read_bytes()


def measure_growth(spool: Path, store: Path, boards: int) -> str:
    """Return the measured cells of one row of the table of growth."""
    scan = scan_spool(spool)
    list_s = measure_cpu_s(lambda: scan_spool(spool))
    start_s = time.process_time()
    with RecordingCache(store / RECORDING_CACHE_FILE, scan.storage.location) as heads:
        list(heads.remember(read_recordings(scan.storage, scan.recordings)))
    heads_s = time.process_time() - start_s
    resume_s = measure_cpu_s(lambda: resume_batch(spool, store))
    ls_s = measure_cpu_s(lambda: newest_versions(store, VersionFilter(), 1000))
    start_s = time.process_time()
    faults = verify(store).faults
    verify_s = time.process_time() - start_s
    if faults:
        raise SystemExit(str(faults[:3]))
    size = sum(path.stat().st_size for path in (store / "index").glob("*.parquet"))
    return (
        f"{list_s:.3f} | {heads_s:.2f} | {resume_s:.2f} | {ls_s:.3f} | {verify_s:.2f} "
        f"| {size / boards:.0f}"
    )


def resume_batch(spool: Path, store: Path) -> None:
    """Do the work of a batch before its first job, and check that no job is new."""
    scan = scan_spool(spool)
    with RecordingCache(store / RECORDING_CACHE_FILE, scan.storage.location) as heads:
        known, unread = heads.split_known(scan)
    finished = StoreIndex(store).finished_keys()
    settings = SolveSettings(solver_version="0.1.0")
    keys = {
        job_key(session.digests, settings.solver_version, settings.config_sha256)
        for session in group_into_sessions(known)
    }
    if unread or keys - finished:
        raise SystemExit("a job is new")
