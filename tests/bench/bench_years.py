"""Measure memory, open files and data loss of a rig over 90 days of simulated time.

Twice a day the emulated rig has power. The real main loop of the service holds the sessions
of its schedule and queue, and every night a batch solves the recordings and writes the page of the
fleet. Each day something else goes wrong: restarts, kills, steps of the clock, suspends, a full
disk, lost boards, a lost unit, halts. Judged is that

- every session of the schedule was held, except where a fault of the day forbids it,
- no sample that a board sent in a recording is missing, across all parts, except of lost boards,
- each recording has a calibration, and the store verifies and has lost nothing since yesterday,
- retention deletes, and keeps what a calibration cites,
- memory, threads, open files, and the sizes of all folders are bounded.

Run: python tests/bench/bench_years.py [--days 90] [--json FILE]
"""

import argparse
import gc
import json
import os
import signal
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.bench.years.life import POWER_UP_S, Life, SimulatedTime, Window

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.fleet.drift import build_overview
from gyrorig_solver.fleet.drift.shrinkage_files import write_shrinkage_estimates
from gyrorig_solver.fleet.jobs import BatchSummary, SolveSettings, run_batch
from gyrorig_solver.fleet.jobs.workers import WorkerPool
from gyrorig_solver.fleet.page import write_fleet_page
from gyrorig_solver.fleet.store import StoreIndex, verify
from gyrorig_solver.fleet.store.store_heads import heads_text
from gyrorig_solver.storage import Folder

NIGHTLY = b"""
name: nightly
steps:
  - rest: {seconds: 2.0, phase: static}
  - move: {tilt_deg: 29.0}
  - move: {pan_deg: 120.0}
  - move: {pan_deg: -120.0}
  - move: {tilt_deg: -40.0}
  - move: {pan_deg: 120.0}
  - move: {pan_deg: 0.0}
  - move: {tilt_deg: 0.0}
  - rest: {seconds: 2.0, phase: static}
settings: {default_speed_deg_s: 120.0, acceleration_deg_s2: 200.0, base_speed_deg_s: 3.0}
"""
DAY_S = 86_400.0
WINDOWS_UTC_H = (1.998, 14.1)  # of each day; the first one for the nightly session
WINDOW_S = 10.0
SPOOL_DAYS = 5  # the operator removes older recordings from the spool
SETTINGS = SolveSettings(solver_version="0.1.0", extend=())
WARM_UP_DAYS = 10
RSS_GROWTH_LIMIT_MB = 20.0  # after the warm-up; libraries are loaded and caches filled in it


@dataclass(slots=True)
class DayRecord:
    """What the process and its folders hold at the end of a day."""

    day: int
    events: list[str]
    rss_mb: float
    blocks: int  # of Python's allocator
    garbage: int  # objects in reference cycles of this day
    threads: int
    open_files: int
    files: dict[str, int]
    kilobytes: dict[str, int]


@dataclass(slots=True)
class Soak:
    """The state of the soak between the days."""

    folder: Path
    time: SimulatedTime = field(default_factory=SimulatedTime)
    life: Life | None = None
    log: list[str] = field(default_factory=list)
    sessions: Counter[str] = field(default_factory=Counter)  # by result
    started: Counter[str] = field(default_factory=Counter)  # by entry of the schedule
    seen: set[str] = field(default_factory=set)  # recordings that were checked
    samples: int = 0
    missing: int = 0  # with all boards present
    faults: list[str] = field(default_factory=list)
    batch: Counter[str] = field(default_factory=Counter)  # sessions by status
    heads: Path | None = None
    cited: str = ""  # a recording that a calibration on the rig cites
    has_lost_boards: bool = False  # in the present window
    days: list[DayRecord] = field(default_factory=list)

    def note(self, line: str) -> None:
        """Take a line of the log of the service."""
        words = line.split()
        if words[:1] == ["Session"] and words[2] == "starts":
            entry = words[1].partition("-")[0]
            self.started[entry if entry in ("nightly", "often") else "queue"] += 1
        elif words[:1] == ["Session"]:
            self.sessions[words[2].rstrip(":.")] += 1
        self.log.append(line)

    def expect(self, condition: bool, text: str) -> None:
        """Record a fault if something is not as it must be."""
        if not condition:
            self.faults.append(f"day {len(self.days)}: {text}")

    def alive(self) -> Life:
        """Return the service, which is started if it does not run."""
        if self.life is None:
            self.life = Life(self.folder / "state", self.time, NIGHTLY, self.note)
            self.life.recover()
        return self.life

    def restart(self) -> None:
        """End the process of the service; the next window starts it again."""
        if self.life is not None:
            self.life.end()
        self.life = None


Event = Callable[[Soak, Window], None]


def restart_in_session(soak: Soak, window: Window) -> None:
    window.in_session(5.0, lambda: window.life.requests.request_termination("SIGTERM"))


def kill_in_session(soak: Soak, window: Window) -> None:
    """Only in a fork of the process, see `serve_until_killed`."""
    window.in_session(9.0, lambda: os.kill(os.getpid(), signal.SIGKILL))


def set_clock_back(soak: Soak, window: Window) -> None:
    window.in_session(5.0, lambda: step_clock(soak, -1.5 * DAY_S))


def set_clock_ahead(soak: Soak, window: Window) -> None:
    window.at(2.0, lambda: step_clock(soak, 2.6 * 3600.0))


def lose_clock(soak: Soak, window: Window) -> None:
    """The clock is at 1969, as without a battery, until it is set 60 s later."""
    step_clock(soak, -POWER_UP_S - 2.0 * DAY_S - soak.time.monotonic_s)
    window.at(60.0, lambda: step_clock(soak, 0.0))


def step_clock(soak: Soak, error_s: float) -> None:
    """Set the clock to so much more than the true time."""
    soak.time.offset_s = soak.time.true_offset_s + error_s


def suspend(soak: Soak, window: Window) -> None:
    window.at(3.0, lambda: soak.time.suspend(5.0 * 3600.0))


def fill_disk(soak: Soak, window: Window) -> None:
    disk = window.life.disk
    window.in_session(3.0, lambda: setattr(disk, "is_full", True))
    window.in_session(8.0, lambda: setattr(disk, "is_full", False))


def lack_room(soak: Soak, window: Window) -> None:
    state = window.life.state
    state.free_bytes = lambda: 5_000_000  # type: ignore[method-assign]
    window.at(30.0, lambda: delattr(state, "free_bytes"))


def lose_board(soak: Soak, window: Window) -> None:
    soak.has_lost_boards = True
    window.in_session(5.0, lambda: window.unplug("board:B-2", 12.0))


def miss_board(soak: Soak, window: Window) -> None:
    soak.has_lost_boards = True
    window.unplug("board:B-2", 3600.0)


def lose_unit(soak: Soak, window: Window) -> None:
    """In motion, so that motion is locked; an operator clears it, and homes the unit."""
    window.in_session(4.0, lambda: window.unplug("ptu", 5.0))
    window.at(60.0, window.life.requests.clear.set)
    window.at(61.0, lambda: window.life.put_job(home=True))


def halt(soak: Soak, window: Window) -> None:
    window.in_session(6.0, lambda: window.life.requests.request_halt("user 1, process 2"))
    window.at(50.0, window.life.requests.clear.set)


def reload(soak: Soak, window: Window) -> None:
    window.at(1.0, window.life.requests.reload.set)


def put_nonsense(soak: Soak, window: Window) -> None:
    path = window.life.state.queue / f"nonsense{len(soak.days)}.yaml"
    window.at(1.0, lambda: path.write_bytes(b"steps: [fly]\n"))


def do_nothing(soak: Soak, window: Window) -> None:
    pass


# One of them at each nightly window, in turn, and one at the second window.
NIGHT_EVENTS: list[Event] = [
    do_nothing, fill_disk, set_clock_back, lose_board, restart_in_session, lack_room,
    kill_in_session, miss_board, lose_clock, halt, suspend, lose_unit,
]  # fmt: skip
DAY_EVENTS: list[Event] = [put_nonsense, suspend, reload, set_clock_ahead, lose_board]
# A nightly session may be missing, late or cut short after these.
EXCUSED = {restart_in_session, kill_in_session, halt, lose_unit, lose_clock, suspend, lack_room}


def serve_until_killed(soak: Soak, seed: int) -> None:
    """Let the service die by SIGKILL in its session: in a fork of this process."""
    soak.restart()
    pid = os.fork()
    if pid == 0:
        try:
            Life(soak.folder / "state", soak.time, NIGHTLY, lambda _line: None).serve(
                WINDOW_S, seed, lambda window: kill_in_session(soak, window), "nightly"
            )
        finally:
            os._exit(0)
    _, status = os.waitpid(pid, 0)
    soak.expect(os.WIFSIGNALED(status), "the service was not killed in its session")
    soak.time.monotonic_s += 60.0  # about what it ran
    parts = list((soak.folder / "state" / "recordings").glob("*.part"))
    soak.expect(bool(parts), "a killed service left no unfinished part")
    life = soak.alive()  # recovers
    soak.expect(not list(life.state.recordings.glob("*.part")), "a part was not recovered")
    soak.expect(life.housekeeping.counts.recovered == len(parts), "a part was lost")


def run_window(soak: Soak, number: int, true_utc_s: float, event: Event, is_night: bool) -> None:
    """Let one window of a day pass, with its event."""
    soak.time.pass_to(true_utc_s)
    soak.has_lost_boards = False
    if event is kill_in_session:
        serve_until_killed(soak, number)
    else:
        life = soak.alive()
        awaited_job = "nightly" if is_night else ""
        life.serve(WINDOW_S, number, lambda window: event(soak, window), awaited_job)
        if life.requests.terminate.is_set():
            soak.restart()
    check_recordings(soak, event)
    step_clock(soak, 0.0)  # NTP


def check_recordings(soak: Soak, event: Event) -> None:
    """Check the samples of new recordings, give them their time, and copy them to the spool."""
    recordings, spool = soak.folder / "state" / "recordings", soak.folder / "spool"
    sessions: dict[str, list[Path]] = {}
    for path in sorted(recordings.glob("*.mcap")):
        if path.name not in soak.seen:
            soak.seen.add(path.name)
            sessions.setdefault(path.name.removesuffix(".mcap").partition("_p")[0], []).append(path)
    for paths in sessions.values():
        read = [read_recording(path) for path in paths]
        for board in {board for recording in read for board in recording.board_ids}:
            numbers = np.concatenate(
                [r.imu_field(board, "sequence") for r in read if board in r.board_ids]
            ).astype(np.int64)
            gaps = int((np.diff(numbers) - 1).sum())
            soak.samples += numbers.size
            soak.missing += 0 if soak.has_lost_boards else gaps
            is_whole = soak.has_lost_boards or event is kill_in_session or not gaps
            soak.expect(is_whole, f"{gaps} samples of {board} are missing in {paths[0].name}")
        for path in paths:
            os.utime(path, (max(0.0, soak.time.monotonic_s + soak.time.offset_s),) * 2)
            if "nightly" in path.name:
                os.link(path, spool / path.name)


def run_night_batch(soak: Soak) -> None:
    """Solve the recordings of the spool, write the page, and verify the store."""
    spool, store = soak.folder / "spool", soak.folder / "store"
    pools = [WorkerPool(lambda: ThreadPoolExecutor(1))]
    summary: BatchSummary = run_batch(spool, store, SETTINGS, pools)
    soak.batch.update(summary.sessions_by_status)
    soak.expect(not summary.deferred + len(summary.unmerged_reason), "the batch deferred jobs")
    for row in summary.unsuccessful_rows:
        soak.expect(row.status == "rejected", f"{row.names}: {row.status}, {row.reason}")
    if StoreIndex(store).query("SELECT count(*) FROM rows WHERE status = 'ok'") != [(0,)]:
        overview = build_overview(store)
        write_shrinkage_estimates(store, overview)
        write_fleet_page(Folder(store), overview, None)
    for fault in verify(store, heads=soak.heads).faults:
        soak.expect(False, f"{fault.file}: {fault.text}")
    soak.heads = soak.folder / "heads.sha256"
    soak.heads.write_text(heads_text(Folder(store)))
    oldest_s = soak.time.true_utc_s - SPOOL_DAYS * DAY_S
    for path in spool.glob("*.mcap"):
        if path.stat().st_mtime < oldest_s:
            path.unlink()


def cite_a_recording(soak: Soak) -> None:
    """Let a calibration on the rig cite one recording, which is kept from then on."""
    recordings = sorted((soak.folder / "state" / "recordings").glob("*nightly*.mcap"))
    if soak.cited or not recordings:
        return
    soak.cited = recordings[0].name
    calibrations = soak.folder / "state" / "calibrations"
    calibrations.mkdir()
    (calibrations / "v0001.yaml").write_text(f'inputs:\n- name: "{soak.cited}"\n')


def run_day(soak: Soak, day: int, events: list[Event]) -> None:
    """Let one day pass."""
    midnight_s = (POWER_UP_S // DAY_S + 1 + day) * DAY_S
    before = soak.started["nightly"]
    soak.alive().put_job()
    for number, hour in enumerate(WINDOWS_UTC_H):
        at_s = midnight_s + hour * 3600.0
        run_window(soak, day * 10 + number, at_s, events[number], is_night=number == 0)
        if number == 0:
            count = soak.started["nightly"] - before
            is_excused = events[0] in EXCUSED
            soak.expect(count == 1 or is_excused, f"{count} sessions `nightly` were started")
    run_night_batch(soak)
    cite_a_recording(soak)
    soak.alive().housekeeping.free_space()  # hourly in real time
    names = [event.__name__ for event in events]
    soak.days.append(measure(soak, day, names))


def measure(soak: Soak, day: int, events: list[str]) -> DayRecord:
    """Return what the process and its folders hold now."""
    garbage = gc.collect()
    status = Path("/proc/self/status").read_text()
    rss_kb = int(status.split("VmRSS:")[1].split()[0])
    folders = [
        "state/recordings", "state/queue", "state/metrics", "spool", "store/index",
        "store/journal", "store/claims", "store/alive", "store/fleet",
    ]  # fmt: skip
    listed = {
        name: [path for path in (soak.folder / name).rglob("*") if path.is_file()]
        for name in folders
    }
    return DayRecord(
        day=day,
        events=events,
        rss_mb=rss_kb / 1024,
        blocks=sys.getallocatedblocks(),
        garbage=garbage,
        threads=threading.active_count(),
        open_files=len(list(Path("/proc/self/fd").iterdir())),
        files={name: len(paths) for name, paths in listed.items()},
        kilobytes={
            name: sum(path.stat().st_size for path in paths) // 1000
            for name, paths in listed.items()
        },
    )


def judge(soak: Soak) -> None:
    """Record what is not bounded."""
    warm = soak.days[WARM_UP_DAYS:]
    recordings = soak.folder / "state" / "recordings"
    soak.expect((recordings / soak.cited).is_file(), "a cited recording was deleted")
    if len(warm) < WARM_UP_DAYS:
        return
    first, last = warm[0], warm[-1]
    growth_mb = last.rss_mb - first.rss_mb
    soak.expect(growth_mb < RSS_GROWTH_LIMIT_MB, f"memory grew by {growth_mb:.1f} MB")
    soak.expect(last.threads <= first.threads, "threads were left")
    soak.expect(last.open_files <= first.open_files + 2, "files were left open")
    largest_kb = max(day.kilobytes["state/recordings"] for day in warm)
    soak.expect(largest_kb < 16_000, f"recordings grew to {largest_kb} kB")
    for name in ("store/journal", "store/claims", "store/alive"):
        soak.expect(last.files[name] <= first.files[name] + 5, f"{name} grew")


def run(folder: Path, plans: list[list[Event]], say: Callable[[str], None]) -> Soak:
    """Let the days pass, one per plan of events, and judge them."""
    (folder / "spool").mkdir(parents=True)
    soak, reported = Soak(folder), 0
    for day, events in enumerate(plans):
        run_day(soak, day, events)
        record = soak.days[-1]
        for fault in soak.faults[reported:]:
            say(f"FAULT on {fault}")
        reported = len(soak.faults)
        say(
            f"day {day}: {record.rss_mb:.1f} MB, {record.blocks} blocks, {record.garbage} in "
            f"cycles, {record.threads} threads, {record.open_files} files, "
            f"{record.kilobytes['state/recordings']} kB, {', '.join(record.events)}"
        )
    judge(soak)
    soak.restart()
    return soak


def say(line: str) -> None:
    """Print what is known so far."""
    print(line, flush=True)  # noqa: T201


def plans_of(days: int) -> list[list[Event]]:
    """Return the events of each day, so that all occur in turn."""
    return [
        [NIGHT_EVENTS[day % len(NIGHT_EVENTS)], DAY_EVENTS[day % len(DAY_EVENTS)]]
        for day in range(days)
    ]


def main() -> int:
    """Run, print what was found, and leave with 1 if anything is not as it must be."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--days", type=int, default=90)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    begun_s = time.process_time()
    with tempfile.TemporaryDirectory(prefix="bench-years-") as folder:
        soak = run(Path(folder) / "rig", plans_of(options.days), say)
    result = {
        "sessions": dict(soak.sessions),
        "started": dict(soak.started),
        "samples": soak.samples,
        "missing": soak.missing,
        "batch": dict(soak.batch),
        "faults": soak.faults,
        "processor_s": time.process_time() - begun_s,
    }
    say(json.dumps(result, indent=1))
    if options.json:
        days = [asdict(day) for day in soak.days]
        options.json.write_text(json.dumps({**result, "days": days, "log": soak.log}, indent=1))
    return 1 if soak.faults else 0


if __name__ == "__main__":
    sys.exit(main())
