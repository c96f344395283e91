"""Output that cannot be written: closed streams and a full disk."""

import os
import subprocess
from pathlib import Path

import pytest

from gyrorig_protocol.child_process import module_command

FULL = Path("/dev/full")
PROGRAMS = {"gyrorig_solver": ["check", "absent.mcap"], "gyrorig_daemon": ["status"]}


@pytest.mark.skipif(not FULL.exists(), reason="the system has no /dev/full")
@pytest.mark.parametrize("program", PROGRAMS)
def test_json_on_a_full_disk_is_one_line(program: str, tmp_path: Path) -> None:
    """Before, the report of the error raised the next error, with a traceback."""
    with FULL.open("w") as full:
        process = subprocess.run(
            module_command(program, *PROGRAMS[program], "--json"),
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            cwd=tmp_path,
            check=False,
        )
    assert process.stderr.count("\n") == 1
    assert process.stderr.startswith("gyrorig")
    assert process.returncode in (1, 3)


@pytest.mark.parametrize("stream", [1, 2])
def test_a_closed_stream_is_no_fault_of_the_program(stream: int, tmp_path: Path) -> None:
    """Before: "'NoneType' object has no attribute 'isatty'", after the result was written."""
    code = (
        "import os, sys; from gyrorig_protocol.child_process import open_closed_streams; "
        "open_closed_streams(); sys.stdout.isatty(), sys.stderr.isatty(); "
        f"handle = open('data', 'w'); sys.exit(handle.fileno() == {stream})"
    )
    process = subprocess.run(
        [*module_command("x")[:1], "-c", code],
        preexec_fn=lambda: os.close(stream),
        cwd=tmp_path,
        check=False,
    )
    assert process.returncode == 0
