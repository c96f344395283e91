"""What people and programs say to a running daemon: requests, jobs, schedules."""

from tests.fuzz.target import Target, promise, refused

from gyrorig_daemon.service.jobs import read_job
from gyrorig_daemon.service.wire import COMMANDING, HALTING, READING, decode_request
from gyrorig_protocol.errors import UsageError

PROGRAM = b"name: p\nsteps:\n  - rest: {seconds: 1.0}\n"


def request(data: bytes) -> None:
    """A line is a known command, or none."""
    found = decode_request(data)
    promise(found is None or found in READING | HALTING | COMMANDING, "an unknown command")


def _job(data: bytes) -> None:
    refused(lambda text: read_job(text, "x"), UsageError, data)


TARGETS = (
    Target(
        "request", request, lambda: [b'{"command": "status"}', b'{"command":"halt"}', b"[" * 99]
    ),
    Target(
        "job",
        _job,
        lambda: [
            PROGRAM,
            b'schema: gyrorig/job/1\nsession: s-1\nhome: true\nprogram: "name: p\\nsteps: []\\n"\n',
        ],
        4096,
    ),
)
