"""The job queue: accepted and rejected files, results."""

import json
import os
from pathlib import Path

import pytest

from gyrorig_daemon.service import job_queue
from gyrorig_daemon.service.job_queue import JobQueue, enqueue_job, parse_job
from gyrorig_protocol.errors import MachineError, UsageError

PROGRAM = b"name: short\nsteps:\n  - rest: {seconds: 1.0}\n"


def reasons(folder: Path) -> list[str]:
    return [
        json.loads(path.read_text())["reason"]
        for path in sorted((folder / "failed").glob("*.result.json"))
    ]


def test_in_and_out(tmp_path: Path) -> None:
    queue = JobQueue(tmp_path)
    path = enqueue_job(tmp_path, PROGRAM, "p.yaml", session="mine", home=True)
    assert queue.waiting_jobs() == [path.stem]
    job = queue.take_next()
    assert job is not None
    assert (job.session, job.home, job.program_text) == ("mine", True, PROGRAM)
    assert queue.take_next() is None
    queue.finish(job, True, {"reason": ""})
    assert {p.suffix for p in (tmp_path / "done").iterdir()} == {".yaml", ".json"}


def test_a_bare_program_is_a_job(tmp_path: Path) -> None:
    queue = JobQueue(tmp_path)
    (tmp_path / "dropped.yaml").write_bytes(PROGRAM)
    job = queue.take_next()
    assert job is not None
    assert (job.name, job.program.name, job.home) == ("dropped", "short", False)


def test_a_job_may_wait_again(tmp_path: Path) -> None:
    queue = JobQueue(tmp_path)
    enqueue_job(tmp_path, PROGRAM, "p.yaml")
    job = queue.take_next()
    assert job is not None
    queue.requeue(job)
    assert queue.waiting_jobs() == [job.name]


def test_what_is_no_job_is_put_aside_and_the_next_one_taken(tmp_path: Path) -> None:
    queue = JobQueue(tmp_path)
    (tmp_path / "a.yaml").write_bytes(b"[}")
    (tmp_path / "b.yaml").write_bytes(b"name: p\nsteps: []\n")
    (tmp_path / "c.yaml").write_bytes(b"\xff\xfe")
    (tmp_path / "d.yaml").write_bytes(b"x" * (job_queue.MAX_JOB_BYTES + 1))
    (tmp_path / "e.yaml").symlink_to("/etc/passwd")
    os.mkfifo(tmp_path / "f.yaml")
    (tmp_path / "g.yaml").mkdir()
    (tmp_path / "h.yaml").write_bytes(b"schema: gyrorig/job/1\nprogram: '[}'\n")
    (tmp_path / "i.yaml").write_bytes(b"schema: gyrorig/job/1\nprogram: x\nevil: 1\n")
    (tmp_path / "j.yaml").write_bytes(b"schema: gyrorig/job/1\nsession: ../x\nprogram: ''\n")
    (tmp_path / ".hidden.yaml").write_bytes(b"[}")
    (tmp_path / "z.yaml").write_bytes(PROGRAM)
    job = queue.take_next()
    assert job is not None
    assert job.name == "z"
    assert queue.rejected_count == len(reasons(tmp_path)) == 10
    assert all(reasons(tmp_path))
    assert (tmp_path / ".hidden.yaml").exists()
    assert Path("/etc/passwd").exists()


def test_a_job_that_ran_when_the_daemon_died_is_not_begun_again(tmp_path: Path) -> None:
    enqueue_job(tmp_path, PROGRAM, "p.yaml")
    assert JobQueue(tmp_path).take_next() is not None
    again = JobQueue(tmp_path)
    assert again.take_next() is None
    (reason,) = reasons(tmp_path)
    assert reason.startswith("The daemon ended while the job was running. Check the rig")


def test_old_results_are_thinned_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(job_queue, "MAX_KEPT_RESULTS", 3)
    queue = JobQueue(tmp_path)
    for number in range(6):
        (tmp_path / f"{number}.yaml").write_bytes(PROGRAM)
        job = queue.take_next()
        assert job is not None
        queue.finish(job, True, {})
    assert sorted(path.name for path in (tmp_path / "done").glob("*.yaml")) == [
        "3.yaml",
        "4.yaml",
        "5.yaml",
    ]
    assert len(list((tmp_path / "done").iterdir())) == 6


def test_what_cannot_be_handed_in(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"session name .* is not valid"):
        enqueue_job(tmp_path, PROGRAM, "p.yaml", session="a b")
    with pytest.raises(UsageError, match="not a YAML document"):
        enqueue_job(tmp_path, b"[}", "p.yaml")
    with pytest.raises(MachineError, match="the job cannot be written"):
        enqueue_job(tmp_path / "none", PROGRAM, "p.yaml")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "queue").write_bytes(b"")
    with pytest.raises(MachineError, match="cannot be used"):
        JobQueue(tmp_path / "queue")


def test_the_program_is_kept_verbatim(tmp_path: Path) -> None:
    text = b"# by hand: \xc3\xa4 \ttab\nname: 'x'\nsteps:\n  - rest: {seconds: 1.0}\n\n"
    path = enqueue_job(tmp_path, text, "p.yaml")
    assert parse_job(path.read_bytes(), path.name).program_text == text
